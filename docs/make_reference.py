"""Write the reference pages from the code: API, keys, columns and effects.

    python docs/make_reference.py

Run it after a change of a public docstring, a key, a column or an effect.
"""

import importlib
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from pathlib import Path

import yaml
from hydra import compose, initialize_config_module

import vocc_torch as vt
from vocc_torch.app.config import AppConfig, descriptions, register
from vocc_torch.app.resolve import task_plain
from vocc_torch.app.tasks import TASKS
from vocc_torch.distributions import Distribution
from vocc_torch.measure.curve import Row
from vocc_torch.simulation.effects import PHYSICAL_ORDER

MOST_SIGNATURE = 88
"""Characters of a signature in one line."""

FOLDER = Path(__file__).resolve().parent / "reference"
NOTE = "<!-- Written by docs/make_reference.py: edit the code, not this page. -->"
WHOLE = (
    "scene.effects",
    "experiment.scene",
    "effects.parts",
    "effects.severity",
    "figures.experiments",
    "comparison.experiments",
    "comparison.points",
    "comparison.scenes",
)
"""Keys of mappings with free names, which are listed as one key."""
COLUMN_TEXTS = Path(__file__).with_name("columns.yaml")
SECTION = re.compile(r"^(Args|Returns|Raises|Yields|Example|Note):$", re.MULTILINE)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    cells = (
        [cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in lines
    )
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


def marked(text: str) -> str:
    """Turn the roles and double backticks of a docstring into Markdown."""
    text = re.sub(
        r":\w+:`~?([\w.]+)`", lambda found: f"`{found[1].split('.')[-1]}`", text
    )
    return text.replace("``", "`").strip()


def sections(docstring: str) -> dict[str, str]:
    """Split a Google docstring into its summary and sections."""
    parts = SECTION.split(inspect.cleandoc(docstring))
    named = dict(zip(parts[1::2], parts[2::2], strict=True))
    return {
        "": parts[0].strip(),
        **{name: inspect.cleandoc(text) for name, text in named.items()},
    }


def entries(text: str) -> list[tuple[str, str]]:
    """Read ``name: words`` entries, whose further lines are indented."""
    found = re.findall(r"^(\*{0,2}[\w., ]+): (.*(?:\n[ \t]+.*)*)", text, re.MULTILINE)
    return [(name, marked(" ".join(words.split()))) for name, words in found]


def signature(name: str, thing: Callable[..., object]) -> str:
    """Write a signature with types."""
    try:
        text = str(inspect.signature(thing))
    except ValueError:
        text = "(...)"
    text = re.sub(
        r"\b(?:vocc_torch|pathlib|collections|typing|torch|numpy)\.(?:[a-z_]+\.)*",
        "",
        text,
    )
    text = re.sub(r"<function .*? at 0x[0-9a-f]+>", "...", text)
    # The quotes of values stay, those of types go.
    text = re.sub(r"(= '[^']*'|Literal\[[^]]*\])|'", r"\1", f"{name}{text}")
    if len(text) > MOST_SIGNATURE:
        text = re.sub(r", (?=\*|\w+: )", ",\n    ", text).replace("(", "(\n    ", 1)
        text = re.sub(r"\)(?= -> \S+$|$)", "\n)", text)
    return text


def documented(name: str, thing: Callable[..., object], level: str) -> str:
    """Document a function or class."""
    said = sections(thing.__doc__ or "")
    blocks = [
        f"{level} {name}",
        f"```text\n{signature(name, thing)}\n```",
        marked(said[""]),
    ]
    if rows := entries(said.get("Args", "")):
        blocks.append(
            table(["argument", "meaning"], [(f"`{key}`", words) for key, words in rows])
        )
    for part in ("Returns", "Yields", "Raises"):
        if part in said:
            blocks.append(f"**{part}**: {marked(' '.join(said[part].split()))}")
    if "Example" in said:
        code = re.sub(r"^(>>>|\.\.\.) ?", "", said["Example"], flags=re.MULTILINE)
        blocks.append(
            f"```python\n{code}\n```"
            if ">>>" not in said["Example"]
            else f"```pycon\n{said['Example']}\n```"
        )
    return "\n\n".join(blocks)


def methods(kind: type) -> str:
    """List the public methods of a class, its own alone."""
    rows = []
    for name, member in vars(kind).items():
        plain = (
            member.__func__
            if isinstance(member, classmethod | staticmethod)
            else member
        )
        text = getattr(plain, "__doc__", None)
        if (
            name.startswith("_")
            or not text
            or not (callable(plain) or isinstance(plain, property))
        ):
            continue
        shown = (
            name
            if isinstance(plain, property)
            else re.sub(
                r"(?<=\() | (?=\))", "", " ".join(signature(name, plain).split())
            )
        )
        rows.append((f"`{shown}`", marked(text.strip().splitlines()[0])))
    return table(["method or property", "what it does"], rows) if rows else ""


def api_page() -> str:
    """Document every public name, functions first."""
    public = {name: getattr(vt, name) for name in sorted(vt.__all__, key=str.lower)}
    functions = [
        documented(name, thing, "##")
        for name, thing in public.items()
        if not inspect.isclass(thing)
    ]
    classes = [
        "\n\n".join(filter(None, [documented(name, thing, "##"), methods(thing)]))
        for name, thing in public.items()
        if inspect.isclass(thing)
    ]
    head = (
        "# API\n\nEverything here is imported as `import vocc_torch as vt`. "
        "Shapes: B frames, R x C LEDs, H x W pixels."
    )
    return "\n\n".join([NOTE, head, *functions, *classes])


def leaves(
    node: Mapping[str, object], prefix: str = ""
) -> Iterable[tuple[str, object]]:
    """List dotted keys with their values."""
    for name, value in node.items():
        key = f"{prefix}{name}"
        if isinstance(value, dict) and value and key not in WHOLE:
            yield from leaves(value, f"{key}.")
        else:
            yield key, value


def keys_page() -> str:
    """List every key with its default and meaning, by section."""
    said = descriptions(AppConfig)
    texts: dict[str, list[tuple[str, str, str]]] = {}
    register()
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        for task in TASKS:
            root = compose("config", [f"task={task}"])
            for key, value in leaves(task_plain(root)):
                section = key.partition(".")[0] if "." in key else "general"
                rows = texts.setdefault(section, [])
                if key in said and all(f"`{key}=`" != row[0] for row in rows):
                    first = {"name": "", "task": "`test`"}
                    shown = first.get(key, f"`{short(value)}`")
                    words = marked(said[key]).replace("_target_", "`_target_`")
                    rows.append((f"`{key}=`", shown, words))
    blocks = [
        f"## {name}\n\n{table(['key', 'default', 'meaning'], rows)}"
        for name, rows in texts.items()
        if rows
    ]
    head = (
        "# Keys of the command line\n\nWrite `key=value`. "
        "A default is that of `task=train` or `task=test`, or else of a task that uses the key. "
        "`vocc-torch --help` prints the values of one command. Groups such as `scene=night` "
        "set several keys at once; their files are in `conf/`."
    )
    return "\n\n".join([NOTE, head, *blocks])


def short(value: object) -> str:
    """Write a default in at most 40 characters."""
    text = (
        yaml.safe_dump(value, default_flow_style=True, width=1000)
        .removesuffix("...\n")
        .strip()
    )
    return text if len(text) <= 40 else f"{text[:37]}..."


def columns_page() -> str:
    """List the columns of every CSV file."""
    blocks = []
    for name, told in yaml.safe_load(COLUMN_TEXTS.read_text(encoding="utf-8")).items():
        known = dict(told.get("columns", {}))
        if name == "ber.csv":
            known |= {
                key: words
                for base in reversed(Row.__mro__)
                for key, words in entries(sections(base.__doc__ or "").get("Args", ""))
            }
        found = list(known)
        if "code" in told:
            module, attribute = told["code"].split(":")
            found = getattr(importlib.import_module(f"vocc_torch.{module}"), attribute)
        rows = [(f"`{column}`", known[column]) for column in found]
        blocks.append(
            f"## {name}\n\n{told['what']}\n\n{table(['column', 'meaning'], rows)}"
        )
    head = (
        "# Columns of result files\n\nNew columns are added at the end. "
        "Empty cells mean that the value does not exist."
    )
    return "\n\n".join([NOTE, head, *blocks])


def effects_page() -> str:
    """List every effect in physical order."""
    rows, parameters = [], []
    for kind in PHYSICAL_ORDER:
        said = sections(kind.__doc__ or "")
        meanings = dict(entries(said.get("Args", "")))
        parameters += [
            (f"`{kind.name}`", f"`{part.name}{default_of(part)}`", meanings[part.name])
            for part in fields(kind)
            if not part.name.startswith("_")
        ]
        whole = "yes" if kind.fills_sensor else ""
        draws = "yes" if kind.sampled else ""
        rows.append(
            (
                f"`{kind.name}`",
                marked(said[""].splitlines()[0]),
                kind.takes.value,
                whole,
                draws,
            )
        )
    head = (
        "# Effects\n\nIn physical order. *Whole sensor*: pixels far from the panel change, "
        "so locators need whole frames. "
        "*Random*: draws from its own random stream. [How to use them](../scenes.md)."
    )
    columns = [
        "effect",
        "what it is",
        "acts on",
        "whole sensor",
        "random",
    ]
    listed = table(["effect", "parameter and default", "meaning"], parameters)
    section = "## Parameters\n\nParameters without a default must be given."
    return "\n\n".join([NOTE, head, table(columns, rows), section, listed])


def default_of(part: Field[object]) -> str:
    """Write a parameter's default."""
    if part.default is MISSING:
        return ""
    if part.default is None:
        return "=null"
    if isinstance(part.default, Distribution):
        return f"=[{', '.join(map(str, (part.default.kind, *part.default.values)))}]"
    return f"={part.default}"


PAGES = {
    "api": api_page,
    "keys": keys_page,
    "columns": columns_page,
    "effects": effects_page,
}
"""The pages by name."""


def main() -> None:
    """Write every page."""
    FOLDER.mkdir(exist_ok=True)
    for name, written in PAGES.items():
        (FOLDER / f"{name}.md").write_text(written().strip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
