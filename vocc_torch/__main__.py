"""``vocc-torch`` and ``python -m vocc_torch``: the command line."""

import gc
import os
import signal
import sys

from vocc_torch import __version__
from vocc_torch.errors import stdout_refusal


def stop(*_: object) -> None:
    """End at once with status 130, where no work is under way that could end in order."""
    os.write(2, b"vocc-torch: interrupted\n")
    if "multiprocessing" in sys.modules:  # else nothing was started
        for worker in sys.modules["multiprocessing"].active_children():
            worker.terminate()
    os._exit(130)


def open_streams() -> None:
    """Put the null device where a stream was closed: files that are opened later would get its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            if (handle := os.open(os.devnull, os.O_RDWR)) != number:
                os.dup2(handle, number)
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))


def main() -> None:
    """Run the command line; Ctrl-C ends it in one line, also while it loads and while it ends."""
    open_streams()
    try:
        if (status := answer()) == 0:
            sys.stdout.flush()
    except BrokenPipeError:
        status = 1
    except OSError as error:
        if not (refused := stdout_refusal(error)):
            raise
        os.write(2, f"vocc-torch: error: {refused}\n".encode())
        status = 2
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            # A full disk, or a reader that has gone: Python would try once more and say so loudly.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            status = status or 2
    sys.exit(status)


def answer() -> int:
    """Answer the process's arguments and give the exit status."""
    if "--version" in sys.argv[1:]:
        from importlib.metadata import version

        print(f"vocc-torch {__version__}, hydra-core {version('hydra-core')}")
        return 0
    if sys.argv[1:] == ["doctor"]:
        from vocc_torch.app.doctor import run_doctor

        return run_doctor()
    # Threads that wait for each other sleep, where they would spin beside other work; torch reads it once.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("KMP_BLOCKTIME", "0")
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # a shell's background job hears nothing
        signal.signal(signal.SIGINT, stop)
    gc.disable()  # until all is loaded, for a quicker start
    from vocc_torch.app.cli import run  # which takes a second

    loading = signal.signal(signal.SIGINT, usual)
    try:
        status = run()
    except KeyboardInterrupt:
        stop()
    signal.signal(signal.SIGINT, loading)
    return status


if __name__ == "__main__":
    main()
