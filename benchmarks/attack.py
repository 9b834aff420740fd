"""Attack the command line: each attempt is answered or refused in one line, and the rest of the disk stays.

    python benchmarks/attack.py                           # every family, an hour or two
    python benchmarks/attack.py pictures=0.1 names  # a tenth of one family, and another whole

An attempt is wrong where it ends in a traceback, takes more than a minute or 6 GB, ends well with other
numbers than an undisturbed run, leaves temporary files, or touches a file outside ``runs/``. The counts go
to ``docs/results/attack.csv``, each with the share of the family that was drawn.
"""

import argparse
import copy
import csv
import io
import itertools
import json
import os
import pickle
import random
import resource
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

import vocc_torch as vt
from vocc_torch.__main__ import main as main_of_command
from vocc_torch.app.config import AppConfig
from vocc_torch.app.tasks import TASKS
from vocc_torch.errors import VoccError
from vocc_torch.measure.schema import keys_of
from vocc_torch.receiver.model_file import read_model, write_model

ROOT = Path(__file__).resolve().parents[1]
PHOTO = ROOT / "tests" / "data" / "led-panel-8x8-photo.png"
LIMIT_S = 60
MOST_BYTES = 6 << 30
TINY = "budget.frames=128 budget.training_frames=64 tensorboard=false device=cpu name=x"
RUN = f"{TINY} experiment.values=[1000,4000] receiver.names=[flda_3]"
LEARNED = f"{TINY} experiment.values=[1000] classifier=mlp receiver.names=[]"
LEARNED += " classifiers.mlp.training.frames=128 classifiers.mlp.training.epochs=2"
TRAIN = "task=train budget.training_frames=64 device=cpu name=x"
DECODE = "task=decode model=receiver.pt device=cpu name=x"
RECORD = "task=record input=sent name=x device=cpu record.fps=60"
OPEN = {"_target_": "builtins.open", "file": "../victim/owned", "mode": "w"}
ORDER = "${oc.create:{_target_:builtins.open,file:../victim/owned,mode:w}}"
DIGITS = "9" * 5000
BRACKETS = "[" * 500 + "]" * 500
ALIASES = "a: &a [x]\n" + "".join(
    f"{n}: &{n} [{', '.join(['*' + p] * 9)}]\n"
    for p, n in itertools.pairwise("abcdefghi")
)
YAML = {
    "secret": "seed: ${oc.env:SECRET}\n",
    "order": f"seed: {ORDER}\n",
    "aliases": ALIASES,
    "nested": f"a: {BRACKETS}\n",
    "digits": f"seed: {DIGITS}\n",
    "tag": "a: !!python/object/apply:os.system ['touch ../victim/owned']\n",
    "binary": "\x00\x01\x02",
    "empty": "",
    "list": "- 1\n",
    "twice": "seed: 1\nseed: 2\n",
    "octal": "distance_m: 030\n",
    "sexagesimal": "distance_m: 1:30\n",
    "large": "#" * (1 << 20),
}
"""Texts that no reader of YAML may resolve, expand or execute."""
ODD_NAMES = r""". .. / ../victim ../../victim a/../../../victim /victim/owned x[/b] [red]x
`<b>` -m ${seed} ${oc.env:HOME} ~ x\y é null true 1e5 a,b [a,b] {a:b} CON x.
'#' '$HOME' '`id`' $(id) *"""
ODD_VALUES = (
    "null -1 0 1e400 nan [] {} '' x true ${seed} ${panel} ${oc.env:HOME} [1,[2]]"
)
ODD_FILES = ("fifo", "device", "folder", "dangling", "heavy")
Act = Callable[[Path], object]


@dataclass(frozen=True)
class Ran:
    """How a command ended, and what it printed."""

    status: int
    said: str

    @property
    def refused(self) -> bool:
        """Whether it was refused in one line of ours."""
        lines = self.said.splitlines()
        lines = [text for text in lines if not text.startswith("vocc-torch: warning:")]
        start = "vocc-torch: error:"
        return self.status == 2 and len(lines) == 1 and lines[0].startswith(start)


@dataclass
class Attempt:
    """One attack: words or a call, in a folder of its own that ``prepare`` has filled."""

    name: str
    words: str | tuple[str, ...] | Callable[[], object]
    prepare: Act = lambda folder: None
    wrong: Callable[[Path, Ran], str] = lambda folder, ran: ""
    act: Callable[[Path, int], object] = lambda folder, process: None
    most_file_bytes: int | None = None
    again: bool = False
    ended_by: tuple[int, ...] = ()


def called(words: str | tuple[str, ...] | Callable[[], object]) -> int:
    """Run a command, or a call as the command line would, and give its exit status."""
    if callable(words):
        try:
            words()
        except VoccError as error:
            print(f"vocc-torch: error: {error}", file=sys.stderr)
            return 2
        return 0
    words = words.split() if isinstance(words, str) else words
    sys.argv = ["vocc-torch", *words]
    try:
        main_of_command()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 1
    return 0


def start(attempt: Attempt, folder: Path) -> int:
    """Start an attempt in a child of this process, which has imported all that it needs."""
    process = os.fork()
    if process:
        return process
    os.setpgid(0, 0)
    os.chdir(folder)
    for stream in (1, 2):
        flags = os.O_CREAT | os.O_WRONLY | os.O_TRUNC
        os.dup2(os.open(f"{folder}.{stream}", flags), stream)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    if (most := attempt.most_file_bytes) is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    status = 1
    try:
        status = called(attempt.words)
    except BaseException:
        traceback.print_exc()
    sys.stderr.flush()
    os._exit(status)


def finish(process: int, folder: Path) -> Ran:
    """Wait for an attempt, at most a minute, and longer beside other work."""
    until = time.monotonic() + LIMIT_S * max(1.0, os.getloadavg()[0])
    while time.monotonic() < until:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            path = Path(f"{folder}.2")  # a child that was killed at once has none
            said = path.read_bytes() if path.exists() else b""
            return Ran(os.waitstatus_to_exitcode(status), said.decode(errors="replace"))
        time.sleep(0.01)
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return Ran(-99, f"no end after {LIMIT_S} s")


def run(words: str, folder: Path) -> Ran:
    """Run a command to its end."""
    folder.mkdir(exist_ok=True)
    return finish(start(Attempt("", words), folder), folder)


def outside(folder: Path) -> dict[str, bytes]:
    """Give every file around ``runs/`` with its bytes."""
    found = [*folder.glob("*"), *(folder.parent / "victim").rglob("*")]
    small = [path for path in found if path.is_file() and not path.is_symlink()]
    small = [path for path in small if path.stat().st_size < 1 << 24]
    return {os.fsdecode(path): path.read_bytes() for path in small}


def judged(attempt: Attempt, place: Path) -> tuple[str, str]:
    """Make one attempt: ``answered``, ``refused`` or ``wrong``, and why."""
    folder, victim = place / "work", place / "victim"
    shutil.rmtree(place)
    (victim / "0").mkdir(parents=True)
    for mine in (victim / "failed.txt", victim / "0" / "failed.txt"):
        mine.write_text("mine\n")
    folder.mkdir()
    attempt.prepare(folder)
    before = outside(folder)
    process = start(attempt, folder)
    attempt.act(folder, process)
    ran = first = finish(process, folder)
    if outside(folder) != before:
        return "wrong", "files outside runs/ changed"
    if attempt.again and first.status in (0, 2, *attempt.ended_by):
        ran = run(str(attempt.words), folder)
        # What had ended well is not done once more.
        ran = first if ran.refused and first.status == 0 else ran
    left = [path for path in folder.rglob("*") if ".tmp" in path.name]
    if left and ran.status == 0:
        return "wrong", f"{left[0].name} was left"
    if ran.refused:
        return "refused", ran.said.strip()
    if ran.status == 0 and "Traceback" not in ran.said:
        why = attempt.wrong(folder, ran)
        return ("wrong", why) if why else ("answered", "")
    return "wrong", f"status {ran.status}: {ran.said[-300:]}"


def encoded(image: Image.Image, kind: str, **options: Any) -> bytes:
    """Give a picture as the bytes of a file."""
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def film(photo: Image.Image) -> bytes:
    """Give a film of twelve frames."""
    import av

    buffer = io.BytesIO()
    small = photo.resize((photo.width // 2 * 2, photo.height // 2 * 2))
    with av.open(buffer, "w", format="matroska") as container:
        stream = container.add_stream(
            "mpeg4", 25, width=small.width, height=small.height
        )
        stream.pix_fmt = "yuv420p"
        for _ in range(12):
            container.mux(stream.encode(av.VideoFrame.from_image(small)))
        container.mux(stream.encode(None))
    return buffer.getvalue()


def odd_file(path: Path, kind: str) -> None:
    """Make a pipe, a device, a folder, a broken link or a huge file where an ordinary file is expected."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "dangling":
        path.symlink_to(Path("../victim/new"))
    elif kind == "heavy":
        with path.open("wb") as file:
            file.truncate(5 << 30)


def written(folder: Path, place: Path, content: bytes) -> None:
    """Replace the content of a file in a folder."""
    (folder / place).write_bytes(content)


def in_runs(call: Callable[[], object]) -> None:
    """Make a call in the folder ``runs``."""
    os.chdir("runs")
    call()


def json_bytes(value: object) -> bytes:
    """Write a value as JSON."""
    return json.dumps(value).encode()


def changed(value: Any, odd: Any) -> Iterator[tuple[str, Any]]:
    """Replace each value of nested settings by an odd one, one at a time."""
    places = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in list(places):
        other = copy.copy(value)
        other[key] = odd
        yield str(key), other
        if isinstance(inner, dict | list) and inner:
            for name, inside in changed(inner, odd):
                other = copy.copy(value)
                other[key] = inside
                yield f"{key}.{name}", other


class Attacks:
    """All attempts, family by family.

    Args:
        seed: of what is damaged where.
        place: a folder for what undisturbed runs leave.
    """

    def __init__(self, seed: int, place: Path) -> None:
        """Run what is attacked once without a disturbance."""
        self.random, self.place = random.Random(seed), place
        place.mkdir()
        shutil.copytree(PHOTO.parent, place / "sent" / "pictures")
        commands = {"run": RUN, "learned": LEARNED, "train": TRAIN}
        commands["transmit"] = "task=transmit input=text.txt name=x"
        for name, words in commands.items():
            (place / name).mkdir()
            (place / name / "text.txt").write_text("a message")
            self.undisturbed(words, place / name)
        self.sent = place / "transmit" / "runs" / "x"
        self.model = place / "train" / "runs" / "x" / "receiver.pt"
        for name, words in {
            "decode": f"{DECODE} input=pictures",
            "record": RECORD,
        }.items():
            self.given(place / name, {})
            self.undisturbed(words, place / name)
        self.bits = (place / "decode" / "runs" / "x" / "bits.csv").read_bytes()

    @staticmethod
    def undisturbed(words: str, folder: Path) -> None:
        """Run a command that must end well."""
        if (ran := run(words, folder)).status:
            raise SystemExit(f"{words} failed: {ran.said}")

    def given(self, folder: Path, files: dict[str, bytes]) -> None:
        """Write the files of an attempt beside a model, a picture and a message that was sent."""
        if not files:
            files = {f"pictures/{n}.png": PHOTO.read_bytes() for n in range(3)}
            if hasattr(self, "sent"):
                shutil.copytree(self.sent, folder / "sent")
        for name, content in {"receiver.pt": self.model.read_bytes(), **files}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

    def damaged(
        self, content: bytes, cuts: int, flips: int
    ) -> Iterator[tuple[str, bytes]]:
        """Cut a file short, and flip bits of it."""
        for _ in range(cuts):
            at = self.random.randrange(len(content))
            yield f"cut at {at}", content[:at]
        for _ in range(flips):
            part, at = bytearray(content), self.random.randrange(len(content))
            part[at] ^= 1 << self.random.randrange(8)
            yield f"bit flipped in byte {at}", bytes(part)

    @staticmethod
    def rows(folder: Path) -> list[dict[str, str]]:
        """Read the rows of ``bits.csv``."""
        path = folder / "runs" / "x" / "bits.csv"
        with path.open(newline="", errors="surrogateescape") as file:
            return list(csv.DictReader(file))

    def odd_bits(self, folder: Path, ran: Ran) -> str:
        """Say what is wrong with bits of a folder of pictures."""
        rows = self.rows(folder)
        found = [row["bits"] for row in rows if row["found"] == "1"]
        if not rows or any(len(bits) != 64 or {*bits} - {*"01"} for bits in found):
            return "bits are not bits"
        return "an escape code was printed" if "\x1b" in ran.said else ""

    def all_frames(self, folder: Path, ran: Ran) -> str:
        """Say where a film of twelve frames was cut short without a word."""
        fewer = len(self.rows(folder)) < 12 and "warning" not in ran.said
        return "frames are missing without a word" if fewer else ""

    def same(self, name: str, file: str) -> Callable[[Path, Ran], str]:
        """Compare a file of results with that of the undisturbed run."""
        wanted = (self.place / name / "runs" / "x" / file).read_bytes()
        return lambda folder, ran: (
            ""
            if (folder / "runs" / "x" / file).read_bytes() == wanted
            else f"other {file}"
        )

    def pictures(self) -> Iterator[Attempt]:
        """Pictures and films that are damaged, odd, misnamed or no pictures."""
        photo = Image.open(PHOTO).convert("RGB")
        grey = photo.convert("L")
        several = {"save_all": True, "append_images": [photo] * 3}
        deep = Image.fromarray(np.asarray(grey).astype(np.uint16) * 257)
        size = b"\0\0\0\x08\0\0\0\x08"
        huge = encoded(Image.new("L", (8, 8)), "PNG").replace(
            size, b"\x7f\xff\xff\xff" * 2
        )
        files = {
            "empty.png": b"",
            "text.png": b"hello\n" * 100,
            "page.png": b"<svg xmlns='http://www.w3.org/2000/svg'/>",
            "evil.png": b"%!PS-Adobe-3.0 EPSF-3.0\n(../victim/owned) (w) file\n",
            "huge.png": huge,
            "dot.png": encoded(Image.new("L", (1, 1)), "PNG"),
            "long.png": encoded(Image.new("L", (1, 40000)), "PNG"),
            "black.png": encoded(Image.new("L", (640, 480)), "PNG"),
            "film.gif": encoded(photo, "GIF", **several),
            "film.webp": encoded(photo, "WEBP", lossless=True, **several),
            "pages.tiff": encoded(photo, "TIFF", **several),
            "cmyk.jpg": encoded(photo.convert("CMYK"), "JPEG"),
            "palette.png": encoded(photo.convert("P"), "PNG"),
            "clear.png": encoded(photo.convert("RGBA"), "PNG"),
            "float.tiff": encoded(grey.convert("F"), "TIFF"),
            "deep.png": encoded(deep, "PNG"),
            "no-picture.mp4": b"\0" * 4000,
        }
        odd = (
            b"\xff\xfe",
            b"\x1b[31mred\x1b[0m",
            b"a\nb",
            b"-x",
            b"`<b>`",
            b"\xe2\x80\xaegnp",
        )
        files |= {f"{os.fsdecode(name)}.png": PHOTO.read_bytes() for name in odd}
        for kind, content in (
            ("png", PHOTO.read_bytes()),
            ("jpg", encoded(photo, "JPEG")),
        ):
            files |= {f"{n}.{kind}": part for n, part in self.damaged(content, 20, 60)}
        for name, content in files.items():
            prepare = partial(self.given, files={f"pictures/{name}": content})
            yield Attempt(name, f"{DECODE} input=pictures", prepare, self.odd_bits)
        for name, content in self.damaged(film(photo), 20, 20):
            prepare = partial(self.given, files={"film.mkv": content})
            yield Attempt(name, f"{DECODE} input=film.mkv", prepare, self.all_frames)

    def devices(self) -> Iterator[Attempt]:
        """Pipes, devices, folders and files of gigabytes wherever a file is named."""
        tasks = ("decode", "transmit", "receive", "record", "collect", "calibrate")
        for kind, task in itertools.product(ODD_FILES, tasks):

            def prepare(folder: Path, k: str = kind) -> None:
                self.given(folder, {})
                odd_file(folder / "odd.png", k)

            yield Attempt(f"input {kind}", f"task={task} input=odd.png name=x", prepare)
        places = {
            "receiver.pt": f"{DECODE} input=pictures",
            "runs/x/ledger.sqlite": RUN,
            "sent/plan.yaml": RECORD,
            "sent/frames.npy": RECORD,
            "runs/x/config.yaml": "task=collect input=runs name=c",
            "runs/x/ber.csv": "task=collect input=runs name=c",
            "mine/scene/odd.yaml": f"--config-dir mine scene=odd {RUN}",
        }
        for kind, (place, words) in itertools.product(ODD_FILES, places.items()):

            def put(folder: Path, k: str = kind, p: str = place) -> None:
                self.given(folder, {})
                (folder / p).unlink(missing_ok=True)
                odd_file(folder / p, k)

            yield Attempt(f"{place} {kind}", words, put)

    def models(self) -> Iterator[Attempt]:
        """Model files that are damaged, forged or foreign."""

        class Evil:
            def __reduce__(self) -> tuple[object, ...]:
                return os.system, ("touch ../victim/owned",)

        saved = io.BytesIO()
        torch.save({"evil": Evil()}, saved)
        content = {
            "pickle": pickle.dumps(Evil()),
            "torch.save of code": saved.getvalue(),
            "picture": PHOTO.read_bytes(),
            "empty": b"",
            "braces": b"{" * 100_000,
            "brackets": b"[" * 100_000,
        }
        content |= dict(self.damaged(self.model.read_bytes(), 25, 125))
        settings, state = read_model(self.model)
        for odd in (
            ORDER,
            "${oc.env:HOME}",
            OPEN,
            [OPEN],
            {"a": [{"b": ORDER}]},
            {"_partial_": True, **OPEN},
            {"_args_": ["x"]},
            None,
            -1,
            DIGITS,
            [],
            {},
            10**6,
            2**70,
        ):
            for place, other in changed(settings, odd):
                path = self.place / "forged.pt"
                write_model(path, other, state)
                content[f"{place} is {str(odd)[:20]}"] = path.read_bytes()
        for name, one in content.items():
            files = {"receiver.pt": one, "pictures/0.png": PHOTO.read_bytes()}
            prepare = partial(self.given, files=files)
            yield Attempt(name, f"{DECODE} input=pictures", prepare, self.odd_bits)

    def resumed(self, name: str, damage: Act) -> Act:
        """Copy a finished run without its results, and damage it."""

        def prepare(folder: Path) -> None:
            shutil.copytree(self.place / name / "runs" / "x", folder / "runs" / "x")
            (folder / "runs" / "x" / "ber.csv").unlink()
            damage(folder / "runs" / "x")

        return prepare

    def damaged_files(
        self, name: str, words: str, files: list[Path], many: int
    ) -> Iterator[Attempt]:
        """Resume a run that has a damaged file."""
        for file in files:
            place = file.relative_to(self.place / name / "runs" / "x")
            for what, content in self.damaged(file.read_bytes(), many, 5 * many):
                prepare = self.resumed(
                    name, partial(written, place=place, content=content)
                )
                yield Attempt(
                    f"{place}: {what}", words, prepare, self.same(name, "ber.csv")
                )

    def ledgers(self) -> Iterator[Attempt]:
        """Ledgers that are damaged, and those of other settings."""
        ledger = self.place / "run" / "runs" / "x" / "ledger.sqlite"
        yield from self.damaged_files("run", RUN, [ledger], 25)
        others = (
            "seed=1 budget.training_frames=65 camera.gamma=2 panel.rows=4 scene=night"
        )
        for other in others.split():
            whole = self.resumed("run", lambda run: None)
            yield Attempt(
                other, f"{RUN} {other}", whole, lambda *_: "taken for its own"
            )

    def sealed(self) -> Iterator[Attempt]:
        """Ledgers whose rows are changed and whose checksums are right."""
        ledger = self.place / "run" / "runs" / "x" / "ledger.sqlite"
        with closing(sqlite3.connect(ledger)) as file:
            packed = file.execute("SELECT content FROM blocks WHERE frames").fetchone()[
                0
            ]
            trained = json.loads(
                file.execute("SELECT content FROM blocks WHERE frames=0").fetchone()[0]
            )
        table = np.frombuffer(zlib.decompress(packed), "<i4").reshape(4, -1)
        blocks = {"nothing": b"", "text": b"text", "short": zlib.compress(b"1234")}
        blocks["bomb"] = zlib.compress(b"\0" * (1 << 28))
        for row, value in itertools.product(range(4), (-1, 2, 7, 10**9, -(2**31))):
            numbers = table.copy()
            numbers[row] = value
            blocks[f"row {row} of {value}"] = zlib.compress(numbers.tobytes())
        for name, content in blocks.items():
            yield self.forged(f"blocks: {name}", "frames > 0", content)
        for odd in ("a", None, -1, [], {}, {"a": 1}, 10**30, ORDER):
            yield self.forged(f"trained is {odd}", "frames = 0", json_bytes(odd))
            for place, other in changed(trained, odd):
                content = json_bytes(other)
                yield self.forged(f"{place} is {odd}", "frames = 0", content)

    def forged(self, name: str, where: str, content: bytes) -> Attempt:
        """Resume from a ledger in which some rows have other content."""

        def forge(run: Path) -> None:
            with closing(sqlite3.connect(run / "ledger.sqlite")) as file, file:
                settings = file.execute("SELECT settings FROM identity").fetchone()[0]
                rows = file.execute(f"SELECT * FROM blocks WHERE {where}").fetchall()
                for *row, _, _ in rows:
                    told = json.dumps([settings, *row, content.hex()])
                    digest = sha256(told.encode()).hexdigest()
                    change = "UPDATE blocks SET content=?, digest=? WHERE "
                    keys = "point=? AND block=? AND frames=?"
                    file.execute(change + keys, (content, digest, *row))

        return Attempt(name, RUN, self.resumed("run", forge))

    def checkpoints(self) -> Iterator[Attempt]:
        """Checkpoints of a training that are damaged."""
        files = (self.place / "learned" / "runs" / "x").rglob("*")
        kept = [path for path in files if path.suffix in (".pt", ".ckpt", ".sqlite")]
        yield from self.damaged_files("learned", LEARNED, kept, 10)

    def names(self) -> Iterator[Attempt]:
        """Names of runs: outside the folder, hidden, with control characters, too long."""
        bad = [
            "",
            " x",
            "'x y'",
            "'\x1b[31mx'",
            "'a\nb'",
            "a" * 300,
            "/".join("a" * 40),
        ]
        bad += ODD_NAMES.split()
        for name, many in itertools.product(bad, ((), ("-m", "seed=0,1"))):
            words = [word for word in RUN.split() if word != "name=x"]
            words = [*many, *words, "budget.frames=2", f"name={name}"]
            yield Attempt(f"{name!r} {' '.join(many)}", tuple(words))

    def kills(self) -> Iterator[Attempt]:
        """Commands that are killed at any moment: repeated, they give the same results."""
        commands = {
            "run": (RUN, "ber.csv"),
            "learned": (LEARNED, "ber.csv"),
            "train": (TRAIN, "config.yaml"),
            "decode": (f"{DECODE} input=pictures", "bits.csv"),
            "record": (RECORD, "truth.csv"),
        }
        signals = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGHUP)
        for (name, (words, file)), sent in itertools.product(commands.items(), signals):
            for _ in range(10):
                wait_s = self.random.uniform(0, 3)

                def send(
                    _: Path, process: int, s: signal.Signals = sent, w: float = wait_s
                ) -> None:
                    time.sleep(w)
                    os.kill(process, s)

                yield Attempt(
                    f"{name}: {sent.name} after {wait_s:.2f} s",
                    words,
                    lambda folder: self.given(folder, {}),
                    self.same(name, file),
                    send,
                    again=True,
                    ended_by=(130, -sent, 128 + sent),
                )

    def two_at_once(self) -> Iterator[Attempt]:
        """Two runs of one name at once: one counts, the other is refused, and the numbers are right."""
        for name, words in (("run", RUN), ("learned", LEARNED)):
            for _ in range(5):
                wait_s = self.random.uniform(0, 2)

                def second(
                    folder: Path, _: int, w: str = words, s: float = wait_s
                ) -> None:
                    time.sleep(s)
                    (folder.parent / "second").mkdir()
                    (folder.parent / "second" / "runs").symlink_to(folder / "runs")
                    run(w, folder.parent / "second")

                told = f"{name} after {wait_s:.2f} s"
                same = self.same(name, "ber.csv")
                yield Attempt(told, words, wrong=same, act=second, again=True)

    def disk_full(self) -> Iterator[Attempt]:
        """A disk that is full at any size of a file, also of the file with the error; later there is room."""
        sizes = (
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
        )
        for size, (name, words) in itertools.product(
            sizes, (("run", RUN), ("learned", LEARNED))
        ):
            yield Attempt(
                f"{name}: files of at most {size} bytes",
                words,
                wrong=self.same(name, "ber.csv"),
                most_file_bytes=size,
                again=True,
            )

    def configuration(self) -> Iterator[Attempt]:
        """Any key with any odd value, as a user or a script might write it."""
        odd = ODD_VALUES.split()
        odd += [
            "é\u202e",
            "os.system",
            "{_target_:os.system}",
            "1e-320",
            "-0.0",
            DIGITS,
            BRACKETS,
        ]
        for key, value in itertools.product(keys_of(AppConfig), odd):
            words = (*RUN.split(), "budget.frames=2", f"{key}={value}")
            yield Attempt(f"{key}={value[:30]}", words)
        for task in TASKS:
            yield Attempt(
                f"{task} of nothing", f"task={task} input=nothing model=nothing name=x"
            )

    def yaml(self) -> Iterator[Attempt]:
        """Scenes, plans, saved configurations and multiruns of another person."""
        os.environ["SECRET"] = "very-secret"

        def told(folder: Path, ran: Ran) -> str:
            text = b"".join(path.read_bytes() for path in folder.rglob("*.csv"))
            return "a secret was told" if b"very-secret" in text else ""

        places = {
            "mine/scene/odd.yaml": f"--config-dir mine scene=odd {RUN}",
            "mine/odd.yaml": f"--config-path ../work/mine --config-name odd {RUN}",
            "runs/odd/scene/odd.yaml": f"scene=odd {RUN}",
            "sent/plan.yaml": RECORD,
            "runs/m/1/config.yaml": "task=collect input=runs/m name=c",
        }
        for (name, text), (place, words) in itertools.product(
            YAML.items(), places.items()
        ):

            def prepare(folder: Path, t: str = text, p: str = place) -> None:
                self.given(folder, {})
                for job in ("0", "1"):
                    run = self.place / "run" / "runs" / "x"
                    shutil.copytree(run, folder / "runs" / "m" / job)
                (folder / "runs" / "m" / "multirun.yaml").write_text("hydra: {}\n")
                (folder / p).parent.mkdir(parents=True, exist_ok=True)
                (folder / p).write_text(t)

            yield Attempt(f"{place}: {name}", words, prepare, told)
        for column, value in (("frames", "-512"), ("ber", "nan"), ("frames", DIGITS)):

            def forge(folder: Path, c: str = column, v: str = value) -> None:
                shutil.copytree(
                    self.place / "run" / "runs" / "x", folder / "runs" / "m" / "0"
                )
                path = folder / "runs" / "m" / "0" / "ber.csv"
                head, first, *others = path.read_text().splitlines()
                cells = dict(zip(head.split(","), first.split(","), strict=True)) | {
                    c: v
                }
                path.write_text("\n".join([head, ",".join(cells.values()), *others]))

            yield Attempt(
                f"{column} {value[:9]}", "task=collect input=runs/m name=c", forge
            )

    def python(self) -> Iterator[Attempt]:
        """Arguments of the public functions that are of another kind."""
        odd = [
            "a",
            1.5,
            -1,
            0,
            None,
            True,
            [],
            {},
            [None],
            10**400,
            float("nan"),
            b"a",
            object(),
        ]
        odd += [
            np.ones((2, 2)),
            torch.ones(2).to_sparse(),
            torch.ones(2, device="meta"),
            "\0",
            "/dev/null",
        ]
        receiver = vt.Receiver.load(self.model)
        usual = {"scene": "paper", "frames": 64}
        axis = {"receivers": receiver, "axis": "distance_m", "values": [30]}
        calls: list[tuple[Callable[..., object], dict[str, object]]] = [
            (vt.load_scene, {"scene": "paper"}),
            (
                vt.train,
                {
                    **usual,
                    "locator": "paper",
                    "classifier": "flda_3",
                    "features": None,
                    "seed": 0,
                },
            ),
            (
                lambda **known: next(vt.simulate(**known)),
                {**usual, "seed": 0, "batch": 64, "point": "a"},
            ),
            (
                vt.measure,
                {
                    **usual,
                    **axis,
                    "seed": 0,
                    "experiment": "e",
                    "progress": id,
                    "store": None,
                },
            ),
            (receiver.decode, {"images": None}),
            (receiver.save, {"path": None}),
            (vt.Receiver.load, {"path": self.model, "plug_ins": ()}),
        ]
        for function, known in calls:
            for key, value in itertools.product(known, odd):
                call = partial(function, **known | {key: value})
                inside = partial(in_runs, call)
                name = f"{getattr(function, '__name__', '')} {key}={str(value)[:30]}"
                yield Attempt(name, inside, lambda folder: (folder / "runs").mkdir())


FAMILIES = "pictures devices models ledgers sealed checkpoints names kills two_at_once"
FAMILIES += " disk_full configuration yaml python"
ENDS = ("answered", "refused", "wrong")
HEAD = ("family", "share", "tried", *ENDS)


def keep(counts: dict[str, Counter[str]], shares: dict[str, float]) -> None:
    """Write the counts of families in their places among those of earlier runs."""
    path, rows = ROOT / "docs" / "results" / "attack.csv", {}
    if path.exists():
        with path.open(newline="") as file:
            rows = {row[0]: row for row in csv.reader(file) if len(row) == len(HEAD)}
    for family, count in counts.items():
        numbers = (shares[family], count.total(), *(count[end] for end in ENDS))
        rows[family] = [family, *map(str, numbers)]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEAD)
        writer.writerows(rows[name] for name in FAMILIES.split() if name in rows)


def main() -> int:
    """Attack, print what is wrong and write the counts; status 1 where anything is wrong."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument(
        "families", nargs="*", help=f"FAMILY or FAMILY=SHARE, of {FAMILIES}"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    drawn = [word.partition("=") for word in options.families or FAMILIES.split()]
    shares = {family: float(share or 1) for family, _, share in drawn}
    if stray := {*shares} - {*FAMILIES.split()}:
        parser.error(f"no such family: {', '.join(stray)}")
    torch.set_num_threads(1)
    counts: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "attempt"
        place.mkdir()
        attacks = Attacks(options.seed, Path(folder) / "undisturbed")
        draw = random.Random(options.seed)
        for family, share in shares.items():
            count = Counter[str]()
            for attempt in getattr(attacks, family)():
                if draw.random() >= share:
                    continue
                end, why = judged(attempt, place)
                count[end] += 1
                if end == "wrong":
                    print(f"wrong: {family}, {attempt.name}: {why}", flush=True)
            print(family, dict(count), flush=True)
            counts[family] = count
            keep({family: count}, shares)
    return int(any(count["wrong"] for count in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
