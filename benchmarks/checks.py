"""What the checks cost: the whole link with every check, and with none, in one process.

The package is imported a second time under another name, its source changed on the way in: every
``if ...: raise VoccError(...)`` is left out, with what was worked out for it alone. A third copy keeps
its checks and shows what of the difference is chance. All three simulate, locate, read and decide the same
batch in turns and must decide the same bits. The checks that a batch meets are listed too. What is compared
is the thread's own time, which does not count waiting for a busy core.

    python benchmarks/checks.py --rounds 200
"""

from __future__ import annotations

import argparse
import ast
import csv
import importlib
import importlib.abc
import importlib.machinery
import io
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

import torch

from vocc_torch.files import write_atomically
from vocc_torch.measure.timing import describe_machine, interleaved, median_of

PACKAGE = Path(__file__).resolve().parents[1] / "vocc_torch"
WITHOUT, AGAIN = "vocc_torch_without", "vocc_torch_again"
FLOORS = ("types", "simulation", "receiver")
"""What the link runs through; a copy imports the rest of the package as it is."""
LIMIT = 0.02


def sources() -> list[Path]:
    """List the files that the link runs through."""
    return [
        file for file in PACKAGE.rglob("*.py") if file.relative_to(PACKAGE).parts[0].split(".")[0] in FLOORS
    ]


def refuses(node: ast.stmt) -> bool:
    """Say whether a statement does nothing but refuse: an ``if`` that ends in ``raise VoccError``.

    A call of ``_refuse``, which does nothing else, stands for the ``raise`` too.
    """
    if not isinstance(node, ast.If) or node.orelse:
        return False
    last = node.body[-1]
    if len(node.body) == 1 and isinstance(last, ast.Expr) and isinstance(last.value, ast.Call):
        return isinstance(last.value.func, ast.Name) and last.value.func.id == "_refuse"
    if not isinstance(last, ast.Raise):
        return False
    raised = node.body[-1].exc
    named = (
        isinstance(raised, ast.Call) and isinstance(raised.func, ast.Name) and raised.func.id == "VoccError"
    )
    return named and all(isinstance(one, ast.Assign | ast.Raise) for one in node.body)


def called(node: ast.stmt) -> str:
    """Name the function that a statement calls without keeping what it gives; empty for any other."""
    if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        return ""
    function = node.value.func
    return function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")


def is_empty(function: ast.FunctionDef) -> bool:
    """Say whether a function does nothing."""
    return all(
        isinstance(one, ast.Pass) or (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))
        for one in function.body
    )


def functions(checkers: frozenset[str] | None = None) -> dict[str, list[bool]]:
    """Say of the package's functions, by name, whether they do nothing, once stripped."""
    found: dict[str, list[bool]] = {}
    for source in sources():
        tree = ast.parse(source.read_text(encoding="utf-8"))
        if checkers is not None:
            tree = _Strip(checkers).visit(tree)
        for one in ast.walk(tree):
            if isinstance(one, ast.FunctionDef):
                found.setdefault(one.name, []).append(is_empty(one))
    return found


def only_check() -> frozenset[str]:
    """Name the functions that do nothing but check, those that only call such among them."""
    whole = functions()
    known: frozenset[str] = frozenset()
    while True:
        stripped = functions(known)
        empty = frozenset(name for name, each in stripped.items() if all(each) and not any(whole[name]))
        if empty == known:
            return known
        known = empty


class _Strip(ast.NodeTransformer):
    """Leave out checks, calls of functions that only check, and what was worked out for these alone."""

    def __init__(self, checkers: frozenset[str]) -> None:
        self.checkers = checkers

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """Strip one function until nothing more falls away."""
        before = ""
        while (text := ast.dump(node)) != before:
            before = text
            self.read = {
                one.id
                for one in ast.walk(node)
                if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load)
            }
            node.body = self._kept(node.body) or [ast.Pass()]
        return node

    def _kept(self, body: Sequence[ast.stmt]) -> list[ast.stmt]:
        """Give the statements that are left."""
        kept: list[ast.stmt] = []
        for one in body:
            if refuses(one) or self._is_unread(one) or called(one) in self.checkers:
                continue
            for part in ("body", "orelse"):
                if isinstance(inner := getattr(one, part, None), list) and not isinstance(
                    one, ast.FunctionDef
                ):
                    setattr(one, part, self._kept(inner))
            if isinstance(one, ast.For | ast.If) and not one.body and not one.orelse:
                continue
            if isinstance(one, ast.FunctionDef):
                one = _Strip(self.checkers).visit(one)
            if hasattr(one, "body") and not one.body:
                one.body = [ast.Pass()]
            kept.append(one)
        return kept

    def _is_unread(self, node: ast.stmt) -> bool:
        """Say whether a statement only gives names that nothing reads."""
        if not isinstance(node, ast.Assign):
            return False
        names = [one for target in node.targets for one in ast.walk(target)]
        plain = all(isinstance(one, ast.Name | ast.Tuple | ast.Store) for one in names)
        return plain and not any(isinstance(one, ast.Name) and one.id in self.read for one in names)


class Copy(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Import the package under another name, with or without its checks."""

    def __init__(self, name: str, strip: _Strip | None) -> None:
        self.name, self.strip = name, strip

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Find a module of the copy."""
        if fullname.split(".")[0] != self.name:
            return None
        file = PACKAGE.joinpath(*fullname.split(".")[1:])
        folder = file.is_dir()
        source = file / "__init__.py" if folder else file.with_suffix(".py")
        return importlib.machinery.ModuleSpec(fullname, self, origin=str(source), is_package=folder)

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed source."""
        assert module.__spec__ is not None
        source = Path(str(module.__spec__.origin))
        tree = ast.parse(source.read_text(encoding="utf-8"))
        if self.strip is not None and source in sources():
            tree = self.strip.visit(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "vocc_torch":
                node.module = self.name + node.module.removeprefix("vocc_torch")
        exec(compile(ast.fix_missing_locations(tree), f"{self.name}/{source.name}", "exec"), module.__dict__)


def link(package: str) -> tuple[Callable[[], torch.Tensor], Callable[[], torch.Tensor]]:
    """Build the link from a package of that name: a batch of 64 crops to bits, by each kind of corners."""

    def of(module: str) -> Any:  # the copies' types are not known
        return importlib.import_module(f"{package}.{module}")

    shape, model = of("types").PanelShape(8, 8), of("simulation").SceneModel()
    simulator, reader = of("simulation").Simulator(), of("receiver.reader").Reader(shape)
    locator, key = of("receiver.location").PaperLocator(), of("rng").BlockKey
    scene, bits = model.draw(key(0, "taught", 0), shape)
    taught = reader.read(simulator.render(scene, bits), simulator.true_panels(scene)).features
    flda = of("receiver.flda").FLDA(3).fit(taught, bits)
    scene, bits = model.draw(key(0, "timed", 0), shape)

    def located() -> torch.Tensor:
        frames = simulator.render(scene, bits, nearest_m=model.nearest_m)
        decided: torch.Tensor = flda.predict(reader.read(frames, locator(frames, shape)).features)
        return decided

    def known() -> torch.Tensor:
        frames = simulator.render(scene, bits, nearest_m=model.nearest_m)
        panels = simulator.true_panels(scene, rendered=True)
        decided: torch.Tensor = flda.predict(reader.read(frames, panels).features)
        return decided

    return located, known


def checks_met(call: Callable[[], object]) -> dict[str, int]:
    """Count how often a call evaluates each check, by file and function."""
    lines: dict[str, dict[int, str]] = {}
    for source in sources():
        for function in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef):
                where = f"{source.relative_to(PACKAGE)}: {function.name}"
                at = {
                    one.lineno: where
                    for one in ast.walk(function)
                    if isinstance(one, ast.If) and refuses(one)
                }
                lines.setdefault(str(source), {}).update(at)
    met: dict[str, int] = {}

    def watch(frame: FrameType, event: str, _argument: object) -> Any:  # what settrace asks for
        known = lines.get(frame.f_code.co_filename)
        if known and event == "line" and frame.f_lineno in known:
            name = known[frame.f_lineno]
            met[name] = met.get(name, 0) + 1
        return watch if known else None

    sys.settrace(watch)
    try:
        call()
    finally:
        sys.settrace(None)
    return dict(sorted(met.items()))


def compared(rounds: int) -> list[dict[str, object]]:
    """Time the link with and without checks, for each kind of corners."""
    found: list[dict[str, object]] = []
    built = {package: link(package) for package in ("vocc_torch", WITHOUT, AGAIN)}
    for index, locator in enumerate(("paper", "truth")):
        calls = {package: both[index] for package, both in built.items()}
        assert all(torch.equal(call(), calls["vocc_torch"]()) for call in calls.values()), "other bits"
        spent = interleaved(calls, rounds, torch.device("cpu"), warm_up=5, clock=time.thread_time)
        base = spent[WITHOUT].seconds
        for what, package in (("checks", "vocc_torch"), ("checks, again", AGAIN)):
            pairs = zip(spent[package].seconds, base, strict=True)
            share = median_of([a / b - 1 for a, b in pairs])
            # The median's own 95 % interval, from the order statistics of the rounds.
            ratios = sorted(a / b - 1 for a, b in zip(spent[package].seconds, base, strict=True))
            reach = round(0.98 * rounds**0.5)
            sure = ratios[max(0, rounds // 2 - reach)], ratios[min(rounds - 1, rounds // 2 + reach)]
            found.append(
                {
                    "locator": locator,
                    "what": what,
                    "share": share.value,
                    "quartile_low": share.low,
                    "quartile_high": share.high,
                    "median_low": sure[0],
                    "median_high": sure[1],
                    "with_ms": 1e3 * median_of(spent[package].seconds).value,
                    "without_ms": 1e3 * median_of(base).value,
                    "rounds": rounds,
                    "checks_met": sum(checks_met(calls["vocc_torch"]).values()),
                    "machine": describe_machine(torch.device("cpu")),
                }
            )
    return found


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path("docs/results/checks.csv"))
    parser.add_argument("--rounds", type=int, default=200)
    args = parser.parse_args()
    torch.set_num_threads(1)
    checkers = only_check()
    print("only check:", ", ".join(sorted(checkers)))
    sys.meta_path[:0] = [Copy(WITHOUT, _Strip(checkers)), Copy(AGAIN, None)]
    with torch.no_grad():
        for where, times in checks_met(link("vocc_torch")[0]).items():
            print(f"{times:4d}  {where}")
        found = compared(args.rounds)
    for one in found:
        print(" ".join(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in one.items()))
    text = io.StringIO()
    table = csv.DictWriter(text, list(found[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(found)
    write_atomically(args.out, text.getvalue().encode())
    worst = max(float(str(one["share"])) for one in found)
    print(f"{args.out}: the checks take {worst:.2%} of the link; {LIMIT:.0%} is allowed")


if __name__ == "__main__":
    main()
