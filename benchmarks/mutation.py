"""Mutation run: every small change of the numerical core that the tests must notice, made one at a time.

mutmut changes an operator, a constant, an argument or a name in a copy of the checkout and runs, for
each, the tests that reach the function. A mutant is killed if a test fails, an exception is raised or
time runs out. Each survivor is either listed in ``benchmarks/equivalent_mutants.toml`` with the reason why it
changes nothing that the code promises, or is open: a test is missing.

    pip install mutmut
    python benchmarks/mutation.py              # all modules; writes docs/results/mutation.json and the page
    python benchmarks/mutation.py intervals    # one of them; the others keep their results
    python benchmarks/mutation.py --page       # nothing is run: the page alone, from what was measured

mutmut changes function bodies alone: constants of a module, decorated functions and default arguments of
dataclasses stay. Doctests are left out, since every mutated copy of a function carries its docstring.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = ROOT / "docs" / "mutation.md", ROOT / "docs" / "results" / "mutation.json"
EQUIVALENT = ROOT / "benchmarks" / "equivalent_mutants.toml"
COPIED = ("vocc_torch", "benchmarks", "conf", "tests", "README.md", "LICENSE")
FLDA_TESTS = (
    "tests/receiver/test_flda.py",
    "tests/numerics/test_flda_hard_cases.py",
)
TESTS = {
    "vocc_torch/simulation/photometry.py": (
        "tests/simulation/test_photometry.py",
        "tests/simulation/test_light_and_background.py",
        "tests/simulation/test_optics_effects.py",
        "tests/simulation/test_simulator.py",
        "tests/simulation/test_surroundings.py",
        "tests/numerics/test_simulation_hard_cases.py",
    ),
    "vocc_torch/receiver/features.py": (
        "tests/receiver/test_features.py",
        "tests/numerics/test_features_hard_cases.py",
    ),
    "vocc_torch/measure/intervals.py": (
        "tests/measure/test_intervals.py",
        "tests/measure/test_weighted.py",
        "tests/numerics/test_evaluation_hard_cases.py",
    ),
    "vocc_torch/receiver/flda.py": FLDA_TESTS,
    "vocc_torch/receiver/discriminant.py": FLDA_TESTS,
}
"""The modules, and the quick tests that cover each."""

SURVIVED = (0, 5, 33, None)
"""What mutmut notes of a change that no test noticed, or that no test reached."""

OUT_OF_TIME = (-24, 24, 36, 152, 255)

LEFT_OUT = '"-k", "not points_at_its_caller"'
"""A test that needs to be called by nobody in between."""

SETTINGS = """\
[tool.pytest.ini_options]
filterwarnings = ["error"]
markers = ["cuda: needs a CUDA device", "slow: a minute or more"]

[tool.mutmut]
source_paths = ["vocc_torch"]
only_mutate = {module}
timeout_multiplier = 4.0
timeout_constant = 10.0
also_copy = {copied}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow and not cuda", {left_out}]
pytest_add_cli_args_test_selection = {tests}
"""


@dataclass(frozen=True)
class Mutant:
    """A change that no test noticed: the lines that went, and those that came."""

    function: str
    old: str
    new: str


@dataclass(frozen=True)
class Module:
    """What a run found in one module."""

    path: str
    mutants: int
    survivors: tuple[Mutant, ...]
    wall_s: float
    out_of_time: int = 0
    equivalents: dict[Mutant, str] = field(default_factory=dict, compare=False)

    @property
    def explained(self) -> int:
        """Survivors that change nothing."""
        return sum(mutant in self.equivalents for mutant in self.survivors)


def run(path: str) -> Module:
    """Mutate one module in a copy of the checkout."""
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mutation-") as name:
        folder = Path(name)
        for part in COPIED:
            if (ROOT / part).is_dir():
                shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(ROOT / part, folder / part)
        tests = [test for test in TESTS[path] if (ROOT / test).exists()]
        settings = SETTINGS.format(module=[path], copied=list(COPIED[1:]), tests=tests, left_out=LEFT_OUT)
        (folder / "pyproject.toml").write_text(settings.replace("'", '"'))
        done = _mutmut(folder, "run", "--max-children", "1")
        meta = folder / "mutants" / f"{path}.meta"
        if done.returncode or not meta.exists():
            raise SystemExit(done.stdout[-4000:] + done.stderr[-4000:])
        codes: dict[str, int | None] = json.loads(meta.read_text())["exit_code_by_key"]
        survivors = tuple(_shown(folder, name) for name, code in codes.items() if code in SURVIVED)
    out_of_time = sum(code in OUT_OF_TIME for code in codes.values())
    return Module(path, len(codes), survivors, time.perf_counter() - begun, out_of_time)


def _mutmut(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run mutmut, on one thread."""
    return subprocess.run(
        [sys.executable, "-m", "mutmut", *arguments],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


def _shown(folder: Path, name: str) -> Mutant:
    """Give a mutant's change, from the diff that mutmut shows."""
    lines = _mutmut(folder, "show", name).stdout.splitlines()
    old, new = (
        "\n".join(line[1:].strip() for line in lines if line.startswith(sign) and line[:3] != sign * 3)
        for sign in "-+"
    )
    function = name.rsplit(".", 1)[1].rsplit("__mutmut_", 1)[0]
    # mutmut writes x_name for a function and xǁClassǁname for a method.
    return Mutant(".".join(function.removeprefix("x").strip("ǁ").split("ǁ")).removeprefix("_"), old, new)


def equivalents() -> dict[str, dict[Mutant, str]]:
    """Read which changes change nothing, and why, by module."""
    known: dict[str, dict[Mutant, str]] = {path: {} for path in TESTS}
    for entry in tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("mutant", []):
        mutant = Mutant(entry["function"], entry["old"], entry["new"])
        known[entry["module"]][mutant] = entry["reason"]
    return known


def load() -> dict[str, Module]:
    """Read what was measured."""
    if not RESULTS.exists():
        return {}
    known = equivalents()
    return {
        row["path"]: Module(
            **{**row, "survivors": tuple(Mutant(**one) for one in row["survivors"])},
            equivalents=known[row["path"]],
        )
        for row in json.loads(RESULTS.read_text())
    }


def save(modules: dict[str, Module]) -> None:
    """Write what was measured."""
    rows = [asdict(replace(modules[path], equivalents={})) for path in TESTS if path in modules]
    for row in rows:
        del row["equivalents"]
        row["wall_s"] = round(row["wall_s"])
    RESULTS.write_text(json.dumps(rows, indent=1) + "\n")


def table(modules: Iterable[Module]) -> str:
    """Write a row a module, and their sum."""
    lines = [
        "| module | mutants | killed | of these out of time | survived | share | of these explained | open "
        "| minutes |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    listed = list(modules)
    rows = [(m.mutants, m.out_of_time, len(m.survivors), m.explained, m.wall_s) for m in listed]
    sums = [sum(row[i] for row in rows) for i in range(5)]
    for name, row in zip([*(f"`{m.path}`" for m in listed), "**all**"], [*rows, sums], strict=True):
        mutants, late, survived, same, wall_s = row
        share = f"{100 * survived / max(1, mutants):.1f} %"
        numbers = (mutants, mutants - survived, late, survived, share, same, survived - same)
        lines.append(f"| {name} | " + " | ".join(map(str, (*numbers, round(wall_s / 60)))) + " |")
    return "\n".join(lines)


def listing(modules: Iterable[Module]) -> str:
    """Write each survivor: what was changed, and why it changes nothing."""
    lines = ["| where | was | became | why no test here can notice |", "|---|---|---|---|"]
    for module in modules:
        for mutant in module.survivors:
            where = f"`{Path(module.path).stem}.{mutant.function}`"
            cells = (_code(mutant.old), _code(mutant.new), module.equivalents.get(mutant, "**open**"))
            lines.append(" | ".join((f"| {where}", *cells)) + " |")
    return "\n".join(lines)


def _code(text: str) -> str:
    return "`" + " ".join(text.split()).replace("|", "\\|") + "`" if text else "(nothing)"


def written(page: str, modules: dict[str, Module]) -> str:
    """Give the page with its generated parts as they have to be."""
    for name, text in (("table", table(modules.values())), ("survivors", listing(modules.values()))):
        begin, end = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}"
    return page


def main() -> None:
    """Run what is asked for, and write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "modules", nargs="*", help="words of which a module's path must hold one; all if none"
    )
    parser.add_argument("--page", action="store_true", help="write the page from what was measured")
    asked = parser.parse_args()
    chosen = [path for path in TESTS if not asked.modules or any(word in path for word in asked.modules)]
    modules, known = load(), equivalents()
    for path in () if asked.page else chosen:
        found = run(path)
        modules = {**load(), path: replace(found, equivalents=known[path])}  # another run may have written
        modules = {path: modules[path] for path in TESTS if path in modules}
        save(modules)
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), modules), encoding="utf-8")
        print(table([modules[path]]).splitlines()[2], flush=True)
        for mutant in modules[path].survivors:
            if mutant not in known[path]:
                print(f"  {mutant.function}:\n    - {mutant.old}\n    + {mutant.new}")
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), modules), encoding="utf-8")


if __name__ == "__main__":
    main()
