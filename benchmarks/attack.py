"""Attack the command line: each attempt is answered or refused in one line, and the rest of the disk stays.

    python benchmarks/attack.py                           # every family, an hour or two
    python benchmarks/attack.py pictures names --share 0.1  # a tenth of two of them

An attempt is wrong where it ends in a traceback, takes more than a minute or 6 GB, ends well with other
numbers than an undisturbed run, leaves temporary files, or touches a file outside ``runs/``. The counts go
to ``docs/results/attack.csv``, those of whole families.
"""

import argparse
import csv
import io
import itertools
import os
import pickle
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from vocc_torch.__main__ import main as main_of_command
from vocc_torch.app.config import TASKS, AppConfig, keys_of

ROOT = Path(__file__).resolve().parents[1]
PHOTO = ROOT / "tests" / "data" / "led-panel-8x8-photo.png"
LIMIT_S, MOST_BYTES = 60, 6 << 30
TINY = (
    "budget.frames=128",
    "budget.training_frames=64",
    "tensorboard=false",
    "device=cpu",
)
QUICK_MLP = ("classifiers.mlp.training.frames=128", "classifiers.mlp.training.epochs=2")
RUN = (*TINY, "experiment.values=[1000,4000]", "receiver.names=[flda_3]", "name=x")
LEARNED = (
    *TINY,
    "experiment.values=[1000]",
    "classifier=mlp",
    "receiver.names=[]",
    *QUICK_MLP,
    "name=x",
)
DECODE = ("task=decode", "model=receiver.pt", "device=cpu", "name=x")


@dataclass(frozen=True)
class Ran:
    """How a command ended, and what it printed."""

    status: int
    said: str

    @property
    def refused(self) -> bool:
        """Whether it was refused in one line of ours."""
        lines = [
            line
            for line in self.said.splitlines()
            if not line.startswith("vocc-torch: warning:")
        ]
        return (
            self.status == 2
            and len(lines) == 1
            and lines[0].startswith("vocc-torch: error:")
        )


@dataclass
class Attempt:
    """One attack: a command in a folder of its own that ``prepare`` has filled."""

    name: str
    arguments: tuple[str, ...]
    prepare: Callable[[Path], object] = lambda folder: None
    wrong: Callable[[Path, Ran], str] = lambda folder, ran: ""
    act: Callable[[Path, int], object] = lambda folder, process: None
    most_file_bytes: int | None = None
    afterwards: tuple[str, ...] | None = None
    ended_by: tuple[int, ...] = ()


def start(
    arguments: tuple[str, ...], folder: Path, most_file_bytes: int | None = None
) -> int:
    """Start a command in a child of this process, which has imported all that it needs."""
    process = os.fork()
    if process:
        return process
    os.setsid()
    os.chdir(folder)
    for stream, name in ((1, ".out"), (2, ".err")):
        os.dup2(
            os.open(f"{folder}{name}", os.O_CREAT | os.O_WRONLY | os.O_TRUNC), stream
        )
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    if most_file_bytes is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_file_bytes, most_file_bytes))
    sys.argv = ["vocc-torch", *arguments]
    status = 1
    try:
        main_of_command()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    os._exit(status)


def finish(process: int, folder: Path) -> Ran:
    """Wait for a command, at most a minute."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            said = Path(f"{folder}.err").read_bytes().decode(errors="replace")
            return Ran(os.waitstatus_to_exitcode(status), said)
        time.sleep(0.01)
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return Ran(-99, f"no end after {LIMIT_S} s")


def run(arguments: tuple[str, ...], folder: Path) -> Ran:
    """Run a command to its end."""
    folder.mkdir(exist_ok=True)
    return finish(start(arguments, folder), folder)


def outside(folder: Path) -> dict[str, bytes]:
    """Every file around ``runs/`` with its bytes."""
    return {
        os.fsdecode(path): path.read_bytes()
        for path in [*folder.glob("*"), *(folder.parent / "victim").rglob("*")]
        if path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 24
    }


def judged(attempt: Attempt, place: Path) -> tuple[str, str]:
    """Make one attempt: ``answered``, ``refused`` or ``wrong``, and why."""
    folder = place / "work"
    for path in place.iterdir():
        shutil.rmtree(
            path
        ) if path.is_dir() and not path.is_symlink() else path.unlink()
    (place / "victim" / "0").mkdir(parents=True)
    (place / "victim" / "failed.txt").write_text("mine\n")
    (place / "victim" / "0" / "failed.txt").write_text("mine\n")
    folder.mkdir()
    attempt.prepare(folder)
    before = outside(folder)
    process = start(attempt.arguments, folder, attempt.most_file_bytes)
    attempt.act(folder, process)
    ran = finish(process, folder)
    if outside(folder) != before:
        return "wrong", "files outside runs/ changed"
    if attempt.afterwards is not None:
        interrupted = ran.status in (0, 2, *attempt.ended_by)
        if not interrupted or "Traceback" in ran.said:
            return "wrong", f"status {ran.status}: {ran.said[-300:]}"
        ran = run(attempt.afterwards, folder)
    left = [path for path in folder.rglob("*") if ".tmp" in path.name]
    if left and ran.status == 0:
        return "wrong", f"{left[0].name} was left"
    if ran.refused:
        return "refused", ran.said.strip()
    if ran.status == 0 and "Traceback" not in ran.said:
        why = attempt.wrong(folder, ran)
        return ("wrong", why) if why else ("answered", "")
    return "wrong", f"status {ran.status}: {ran.said[-300:]}"


class Attacks:
    """All attempts, family by family.

    Args:
        seed: of what is damaged where.
        place: a folder for what undisturbed runs leave.
    """

    def __init__(self, seed: int, place: Path) -> None:
        """Run what is attacked once without a disturbance."""
        self.random = random.Random(seed)
        self.kept = place / "kept"
        for name, arguments in {
            "run": RUN,
            "learned": LEARNED,
            "model": ("task=train", TINY[1], "device=cpu", "name=x"),
        }.items():
            place.mkdir(exist_ok=True)
            if (ran := run(arguments, place / name)).status:
                raise SystemExit(f"the undisturbed {name} failed: {ran.said}")
        self.run, self.learned = (
            place / name / "runs" / "x" for name in ("run", "learned")
        )
        self.model = place / "model" / "runs" / "x" / "receiver.pt"
        shutil.copy(self.model, place / "receiver.pt")
        run((*DECODE, f"input={PHOTO}"), place)
        self.bits = (place / "runs" / "x" / "bits.csv").read_bytes()

    def damaged(
        self, whole: bytes, cuts: int, flips: int
    ) -> Iterator[tuple[str, bytes]]:
        """Cut a file short, and flip bits of it."""
        for _ in range(cuts):
            at = self.random.randrange(len(whole))
            yield f"cut at {at}", whole[:at]
        for _ in range(flips):
            part, at = bytearray(whole), self.random.randrange(len(whole))
            part[at] ^= 1 << self.random.randrange(8)
            yield f"bit flipped in byte {at}", bytes(part)

    def pictures(self) -> Iterator[Attempt]:
        """Pictures and recordings that are damaged, odd, misnamed or no pictures."""
        photo = Image.open(PHOTO).convert("RGB")
        grey = photo.convert("L")

        def encoded(image: Image.Image, kind: str, **options: object) -> bytes:
            buffer = io.BytesIO()
            image.save(buffer, kind, **options)  # type: ignore[arg-type]
            return buffer.getvalue()

        files = {
            "empty.png": b"",
            "text.png": b"hello\n" * 100,
            "page.png": b"<svg xmlns='http://www.w3.org/2000/svg'/>",
            "evil.png": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(../victim/owned) (w) file\n",
            "huge.png": encoded(Image.new("L", (8, 8)), "PNG").replace(
                b"\0\0\0\x08\0\0\0\x08", b"\x7f\xff\xff\xff" * 2
            ),
            "one.png": encoded(Image.new("L", (1, 1)), "PNG"),
            "long.png": encoded(Image.new("L", (1, 40000)), "PNG"),
            "black.png": encoded(Image.new("L", (640, 480)), "PNG"),
            "film.gif": encoded(photo, "GIF", save_all=True, append_images=[photo] * 3),
            "film.webp": encoded(
                photo, "WEBP", save_all=True, append_images=[photo] * 3, lossless=True
            ),
            "pages.tiff": encoded(
                photo, "TIFF", save_all=True, append_images=[photo] * 3
            ),
            "cmyk.jpg": encoded(photo.convert("CMYK"), "JPEG"),
            "palette.png": encoded(photo.convert("P"), "PNG"),
            "clear.png": encoded(photo.convert("RGBA"), "PNG"),
            "float.tiff": encoded(grey.convert("F"), "TIFF"),
            "deep.png": encoded(
                Image.fromarray(np.asarray(grey).astype(np.uint16) * 257), "PNG"
            ),
            "no-picture.mp4": b"\0" * 4000,
        }
        for name, content in itertools.chain(
            files.items(),
            (
                (f"{name}.png", content)
                for name, content in self.damaged(PHOTO.read_bytes(), 20, 60)
            ),
            (
                (f"{name}.jpg", content)
                for name, content in self.damaged(encoded(photo, "JPEG"), 20, 60)
            ),
        ):
            yield Attempt(
                name,
                (*DECODE, "input=pictures"),
                lambda folder, n=name, c=content: self.given(
                    folder, {f"pictures/{n}": c}
                ),
                self.whole_bits,
            )
        odd = (
            b"\xff\xfe.png",
            b"\x1b[31mred\x1b[0m.png",
            b"a\nb.png",
            b"-x.png",
            b"`<b>.png",
            "\u202egnp.png".encode(),
        )
        for name in odd:
            yield Attempt(
                repr(name),
                (*DECODE, "input=pictures"),
                lambda folder, n=name: self.given(
                    folder, {"pictures/" + os.fsdecode(n): PHOTO.read_bytes()}
                ),
                lambda folder, ran: (
                    "an escape code was printed"
                    if "\x1b" in ran.said
                    else self.whole_bits(folder, ran)
                ),
            )
        for kind in ("fifo", "device", "folder", "nothing"):
            yield Attempt(
                kind,
                (*DECODE, "input=it.png"),
                lambda folder, k=kind: self.odd_file(folder, "it.png", k),
            )
        frames = self.film(photo)
        for name, content in self.damaged(frames, 20, 20):
            yield Attempt(
                f"{name} of a film",
                (*DECODE, "input=film.mkv"),
                lambda folder, c=content: self.given(folder, {"film.mkv": c}),
                lambda folder, ran: self.all_frames(folder, ran, 12),
            )

    @staticmethod
    def film(photo: Image.Image) -> bytes:
        """A film of twelve frames; none where PyAV is missing."""
        import av

        buffer = io.BytesIO()
        small = photo.resize((photo.width // 2 * 2, photo.height // 2 * 2))
        with av.open(buffer, "w", format="matroska") as container:
            stream = container.add_stream(
                "mpeg4", rate=25, width=small.width, height=small.height
            )
            stream.pix_fmt = "yuv420p"
            for _ in range(12):
                container.mux(stream.encode(av.VideoFrame.from_image(small)))
            container.mux(stream.encode(None))
        return buffer.getvalue()

    def given(self, folder: Path, files: dict[str, bytes]) -> None:
        """Write the files of an attempt beside the model."""
        for name, content in {"receiver.pt": self.model.read_bytes(), **files}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

    def odd_file(self, folder: Path, name: str, kind: str) -> None:
        """Put what is no file where one is expected."""
        if name != "receiver.pt":
            self.given(folder, {})
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if kind == "fifo":
            os.mkfifo(path)
        elif kind == "device":
            path.symlink_to("/dev/zero")
        elif kind == "folder":
            path.mkdir()
        elif kind == "dangling":
            path.symlink_to(folder.parent / "victim" / "new")
        elif kind == "heavy":
            with path.open("wb") as file:
                file.truncate(5 << 30)

    @staticmethod
    def rows(folder: Path) -> list[dict[str, str]]:
        """The rows of ``bits.csv``."""
        with (folder / "runs" / "x" / "bits.csv").open(
            newline="", errors="surrogateescape"
        ) as file:
            return list(csv.DictReader(file))

    def whole_bits(self, folder: Path, ran: Ran) -> str:
        """Say what is wrong with bits of a folder of pictures."""
        rows = self.rows(folder)
        broken = [
            row
            for row in rows
            if row["found"] == "1"
            and (len(row["bits"]) != 64 or set(row["bits"]) - {*"01"})
        ]
        return "bits are not bits" if broken or not rows else ""

    def all_frames(self, folder: Path, ran: Ran, frames: int) -> str:
        """Say where a film was cut short without a word."""
        fewer = len(self.rows(folder)) < frames and "warning" not in ran.said
        return "frames are missing without a word" if fewer else ""

    def models(self) -> Iterator[Attempt]:
        """Model files that are damaged, forged, foreign or no files."""

        def same(folder: Path, ran: Ran) -> str:
            return (
                ""
                if (folder / "runs" / "x" / "bits.csv").read_bytes() == self.bits
                else "other bits"
            )

        class Evil:
            def __reduce__(self) -> tuple[object, ...]:
                return os.system, ("touch ../victim/owned",)

        pickled, saved, zipped = pickle.dumps(Evil()), io.BytesIO(), io.BytesIO()
        torch.save({"evil": Evil()}, saved)
        with zipfile.ZipFile(zipped, "w") as archive:
            archive.writestr("../../victim/owned", "x")
        content = {
            "a pickle": pickled,
            "torch.save of code": saved.getvalue(),
            "a path outside": zipped.getvalue(),
        }
        content |= {
            "a picture": PHOTO.read_bytes(),
            "empty": b"",
            "braces": b"{" * 100_000,
            "brackets": b"[" * 100_000,
        }
        for name, whole in itertools.chain(
            content.items(), self.damaged(self.model.read_bytes(), 25, 125)
        ):
            given = {"receiver.pt": whole}
            yield Attempt(
                name,
                (*DECODE, f"input={PHOTO}"),
                lambda folder, g=given: self.given(folder, g),
                same,
            )
        for kind in ("fifo", "device", "folder", "dangling", "heavy"):
            yield Attempt(
                kind,
                (*DECODE, f"input={PHOTO}"),
                lambda folder, k=kind: self.odd_file(folder, "receiver.pt", k),
            )

    def resumed(
        self, reference: Path, damage: Callable[[Path], object]
    ) -> Callable[[Path], object]:
        """Put a finished run without its results there, and damage it."""

        def prepare(folder: Path) -> None:
            shutil.copytree(reference, folder / "runs" / "x")
            (folder / "runs" / "x" / "ber.csv").unlink()
            damage(folder / "runs" / "x")

        return prepare

    def same_counts(self, reference: Path) -> Callable[[Path, Ran], str]:
        """Compare ``ber.csv`` with that of the undisturbed run."""

        def wrong(folder: Path, ran: Ran) -> str:
            same = (folder / "runs" / "x" / "ber.csv").read_bytes() == (
                reference / "ber.csv"
            ).read_bytes()
            return "" if same else "other counts"

        return wrong

    def ledgers(self) -> Iterator[Attempt]:
        """Ledgers that are damaged, those of others, and what is no ledger."""
        whole = (self.run / "ledger.sqlite").read_bytes()
        for name, content in self.damaged(whole, 25, 125):
            prepare = self.resumed(
                self.run, lambda run, c=content: (run / "ledger.sqlite").write_bytes(c)
            )
            yield Attempt(name, RUN, prepare, self.same_counts(self.run))
        for kind in ("fifo", "device", "folder", "dangling"):

            def put(folder: Path, k: str = kind) -> None:
                self.odd_file(folder, "runs/x/ledger.sqlite", k)

            yield Attempt(kind, RUN, put)
        for other in (
            "seed=1",
            "budget.training_frames=65",
            "camera.gamma=2",
            "panel.rows=4",
            "scene=night",
        ):
            yield Attempt(
                other,
                (*RUN, other),
                self.resumed(self.run, lambda run: None),
                lambda *_: "taken for its own",
            )

    def checkpoints(self) -> Iterator[Attempt]:
        """Checkpoints of a training that are damaged."""
        files = [
            p
            for p in self.learned.rglob("*")
            if p.is_file() and p.suffix in (".pt", ".ckpt", ".sqlite")
        ]
        for file in files:
            for name, content in self.damaged(file.read_bytes(), 10, 40):
                place = file.relative_to(self.learned)
                prepare = self.resumed(
                    self.learned,
                    lambda run, c=content, p=place: (run / p).write_bytes(c),
                )
                yield Attempt(
                    f"{place}: {name}", LEARNED, prepare, self.same_counts(self.learned)
                )

    def names(self) -> Iterator[Attempt]:
        """Names of runs that lead out, hide, shout or do not fit."""
        bad = [
            "",
            ".",
            "..",
            "/",
            "../victim",
            "../../victim",
            "a/../../../victim",
            "/victim/owned",
            "x[/b]",
            "[red]x",
            "`<b>`",
        ]
        bad += [
            "'\x1b[31mx'",
            "'a\nb'",
            "a" * 300,
            "/".join("a" * 40),
            "-m",
            "${seed}",
            "${oc.env:HOME}",
            "~",
            "x\\y",
            "é",
            "'x y'",
        ]
        bad += [
            "null",
            "true",
            "1e5",
            "a,b",
            "[a,b]",
            "{a:b}",
            "CON",
            "x.",
            " x",
            "'#'",
            "'$HOME'",
            "'`id`'",
            "$(id)",
            "*",
        ]
        for name in bad:
            for many in ((), ("-m", "seed=0,1")):
                arguments = (*many, *RUN[:-1], "budget.frames=2", f"name={name}")
                yield Attempt(f"{name!r} {' '.join(many)}", arguments)

    def signals(self) -> Iterator[Attempt]:
        """A run that is ended from outside at any moment goes on to the same counts."""
        for sent, _ in itertools.product(
            (signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGHUP), range(10)
        ):
            wait_s = self.random.uniform(0, 3)

            def send(
                folder: Path, process: int, s: signal.Signals = sent, w: float = wait_s
            ) -> None:
                time.sleep(w)
                os.kill(process, s)

            ended = (130, -sent, 128 + sent)
            yield Attempt(
                f"{sent.name} after {wait_s:.2f} s",
                RUN,
                wrong=self.same_counts(self.run),
                act=send,
                afterwards=RUN,
                ended_by=ended,
            )

    def two_at_once(self) -> Iterator[Attempt]:
        """Two runs of one name at once: one counts, the other is refused, and the numbers are right."""
        for arguments, reference in ((RUN, self.run), (LEARNED, self.learned)):
            for _ in range(5):
                wait_s = self.random.uniform(0, 2)

                def second(
                    folder: Path,
                    process: int,
                    a: tuple[str, ...] = arguments,
                    w: float = wait_s,
                ) -> None:
                    time.sleep(w)
                    (folder.parent / "second").mkdir()
                    (folder.parent / "second" / "runs").symlink_to(folder / "runs")
                    ran = run(a, folder.parent / "second")
                    (folder.parent / "second.err").write_text(ran.said)

                yield Attempt(
                    f"after {wait_s:.2f} s",
                    arguments,
                    wrong=self.same_counts(reference),
                    act=second,
                    afterwards=arguments,
                )

    def disk_full(self) -> Iterator[Attempt]:
        """A disk full at any size of a file, also of that of the refusal; afterwards there is room."""
        for size in (
            0,
            1000,
            4000,
            8192,
            10_000,
            12_288,
            16_384,
            20_000,
            30_000,
            50_000,
            100_000,
        ):
            for arguments, reference in ((RUN, self.run), (LEARNED, self.learned)):
                yield Attempt(
                    f"files of at most {size} bytes",
                    arguments,
                    wrong=self.same_counts(reference),
                    most_file_bytes=size,
                    afterwards=arguments,
                )

    def configuration(self) -> Iterator[Attempt]:
        """Any key with any odd value, as a user or a script might write it."""
        odd = [
            "null",
            "-1",
            "0",
            "1e400",
            "nan",
            "[]",
            "{}",
            "''",
            "x",
            "true",
            "${seed}",
            "${panel}",
            "${oc.env:HOME}",
            "[1,[2]]",
        ]
        odd += [
            "9" * 5000,
            "[" * 300 + "]" * 300,
            "é\u202e",
            "os.system",
            "{_target_:os.system}",
            "1e-320",
            "-0.0",
        ]
        for key, value in itertools.product(keys_of(AppConfig), odd):
            yield Attempt(
                f"{key}={value[:30]}",
                (*RUN[:-1], "budget.frames=2", "name=x", f"{key}={value}"),
            )
        for task in TASKS:
            yield Attempt(
                f"task={task} of nothing",
                (f"task={task}", "input=nothing", "model=nothing", "name=x"),
            )

    def collections(self) -> Iterator[Attempt]:
        """Multiruns that somebody else has made."""
        aliases = "a: &a [x]\n" + "".join(
            f"{n}: &{n} [{', '.join(['*' + p] * 9)}]\n"
            for p, n in itertools.pairwise("abcdefghi")
        )
        bad = {
            "secret": "name: ${oc.env:SECRET}\n",
            "aliases": aliases,
            "nested": "a: " + "[" * 5000 + "]" * 5000,
            "digits": "seed: " + "9" * 5000 + "\n",
            "tag": "!!python/object/apply:os.system ['touch ../victim/owned']\n",
            "binary": "\x00\x01\x02",
            "empty": "",
        }
        os.environ["SECRET"] = "very-secret"

        def told(folder: Path, ran: Ran) -> str:
            text = b"".join(path.read_bytes() for path in folder.rglob("*.csv"))
            return "a secret was told" if b"very-secret" in text else ""

        for name, config in bad.items():

            def prepare(folder: Path, c: str = config) -> None:
                for job, text in (
                    ("0", (self.run / "config.yaml").read_text()),
                    ("1", c),
                ):
                    shutil.copytree(self.run, folder / "runs" / "m" / job)
                    (folder / "runs" / "m" / job / "config.yaml").write_text(text)
                (folder / "runs" / "m" / "multirun.yaml").write_text("hydra: {}\n")

            yield Attempt(
                f"config.yaml: {name}",
                ("task=collect", "input=runs/m", "name=c"),
                prepare,
                told,
            )
        for row in ("frames,-512", "ber,nan", "frames," + "9" * 5000):
            column, value = row.split(",")

            def forge(folder: Path, c: str = column, v: str = value) -> None:
                for job in ("0", "1"):
                    shutil.copytree(self.run, folder / "runs" / "m" / job)
                path = folder / "runs" / "m" / "1" / "ber.csv"
                with path.open(newline="") as file:
                    rows = list(csv.DictReader(file))
                rows[0][c] = v
                with path.open("w", newline="") as file:
                    writer = csv.DictWriter(file, rows[0].keys())
                    writer.writeheader()
                    writer.writerows(rows)

            yield Attempt(
                f"ber.csv: {row[:20]}",
                ("task=collect", "input=runs/m", "name=c"),
                forge,
            )


FAMILIES = (
    "pictures",
    "models",
    "ledgers",
    "checkpoints",
    "names",
    "signals",
    "two_at_once",
    "disk_full",
    "configuration",
    "collections",
)


def keep(counts: dict[str, Counter[str]]) -> None:
    """Write the counts of whole families in their places among those of earlier runs."""
    path, ends = (
        ROOT / "docs" / "results" / "attack.csv",
        ("answered", "refused", "wrong"),
    )
    rows = {}
    if path.exists():
        with path.open(newline="") as file:
            rows = {row[0]: row for row in csv.reader(file)}
    for family, count in counts.items():
        rows[family] = [
            family,
            str(sum(count.values())),
            *(str(count[end]) for end in ends),
        ]
    with path.open("w", newline="") as file:
        lines = [
            ["family", "tried", *ends],
            *(rows[family] for family in FAMILIES if family in rows),
        ]
        csv.writer(file, lineterminator="\n").writerows(lines)


def main() -> int:
    """Attack, print what is wrong and write the counts; status 1 where anything is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "families", nargs="*", help=f"of {', '.join(FAMILIES)}; all by default"
    )
    parser.add_argument(
        "--share", type=float, default=1.0, help="of the attempts of each family"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if stray := set(options.families) - set(FAMILIES):
        parser.error(f"no such family: {', '.join(stray)}")
    families = options.families or FAMILIES
    torch.set_num_threads(1)
    counts: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "attempt"
        place.mkdir()
        attacks = Attacks(options.seed, Path(folder) / "undisturbed")
        draw = random.Random(options.seed)
        for family in families:
            counts[family] = Counter()
            for attempt in getattr(attacks, family)():
                if draw.random() >= options.share:
                    continue
                end, why = judged(attempt, place)
                counts[family][end] += 1
                if end == "wrong":
                    print(f"wrong: {family}, {attempt.name}: {why}", flush=True)
            print(family, dict(counts[family]), flush=True)
    if options.share == 1:
        keep(counts)
    return int(any(count["wrong"] for count in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
