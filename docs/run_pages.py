"""Run the code of documentation pages and write its output below each block.

    python docs/run_pages.py docs/tutorials/*.md

Python blocks of a page share their names. A block of kind ``text`` that follows a Python or Bash block
holds its output. Bash blocks after the last one with an output are not run.
Pictures that a page saves are copied to ``docs/images`` as ``PAGE-NAME.png``.
"""

import argparse
import contextlib
import io
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parent

BLOCK = re.compile(
    r"^```(?P<kind>python|bash)\n(?P<code>.*?)^```\n(?:\n```text\n(?P<output>.*?)^```\n)?",
    re.DOTALL | re.MULTILINE,
)


def python_output(code: str, names: dict[str, object]) -> str:
    """Run a Python block and return what it prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "page", "exec"), names)
    return printed.getvalue()


def bash_output(code: str) -> str:
    """Run a Bash block and return what it prints, without machine paths."""
    done = subprocess.run(
        ["bash", "-ec", code], capture_output=True, text=True, check=True
    )
    shown = done.stdout + done.stderr
    return shown.replace(f"{Path.cwd()}/", "")


def run_page(page: Path, *, bash: bool) -> str:
    """Run a page in the current folder and return it with fresh outputs."""
    names: dict[str, object] = {"__name__": "page"}
    text = page.read_text(encoding="utf-8")
    shown = [
        found.start()
        for found in BLOCK.finditer(text)
        if found["kind"] == "bash" and found["output"] is not None
    ]

    def fresh(found: re.Match[str]) -> str:
        kind, code, output = found["kind"], found["code"], found["output"]
        if kind == "bash" and not (bash and shown and found.start() <= shown[-1]):
            return found[0]
        printed = python_output(code, names) if kind == "python" else bash_output(code)
        if kind == "bash" and output is None:
            return found[0]
        block = f"```{kind}\n{code}```\n"
        lines = [line.rstrip() for line in printed.splitlines()]
        written = "\n".join(lines).strip("\n")
        return f"{block}\n```text\n{written}\n```\n" if written else block

    return BLOCK.sub(fresh, text)


def main() -> None:
    """Run pages and write them back."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="+", type=Path)
    for page in (path.resolve() for path in parser.parse_args().pages):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            for name in ("tests", "examples"):
                Path(name).symlink_to(ROOT / name)
            page.write_text(run_page(page, bash=True), encoding="utf-8")
            for picture in Path().glob("*.png"):
                shutil.copy(picture, FOLDER / "images" / f"{page.stem}-{picture.name}")
        print(page.name)


if __name__ == "__main__":
    main()
