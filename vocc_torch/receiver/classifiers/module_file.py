"""A Python file outside the package, from which a classifier comes."""

import ast
import hashlib
import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from vocc_torch.errors import VoccError


@dataclass(frozen=True, slots=True)
class ModuleFile:
    """A file of Python, read once in each process.

    Args:
        path: where it is.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "mine.py"
        ...     _ = path.write_text("ANSWER = 42")
        ...     ModuleFile(str(path)).named("ANSWER")
        42
    """

    path: str

    @property
    def digest(self) -> str:
        """What tells this text, and those that it imports from its own folder, from others.

        It is the start of their SHA-256, in hexadecimal.

        Raises:
            VoccError: the file cannot be read.
        """
        try:
            told = hashlib.sha256()
            for path in _with_imports(Path(self.path)):
                told.update(path.read_bytes())
            return told.hexdigest()[:16]
        except OSError as error:
            raise VoccError(f"file {self.path} cannot be read: {error.strerror or error}") from None

    def module(self) -> ModuleType:
        """Run the file as a module; what it raises is told in one line.

        Raises:
            VoccError: the file cannot be read or run.
        """
        name = f"vocc_torch_file_{Path(self.path).stem}_{self.digest}"
        if name in sys.modules:
            return sys.modules[name]
        spec = importlib.util.spec_from_file_location(name, self.path)
        if spec is None or spec.loader is None:
            raise VoccError(f"file {self.path} is no Python file: its name must end in .py")
        made = importlib.util.module_from_spec(spec)
        # Before it runs, because dataclasses and pickles look their module up.
        sys.modules[name] = made
        try:
            spec.loader.exec_module(made)
        # A file that would end the program is no exception.
        except (Exception, SystemExit) as error:
            del sys.modules[name]
            raise VoccError(f"file {self.path} cannot be run ({one_line(error)})") from error
        return made

    def named(self, name: str) -> object:
        """Return what the file calls ``name``.

        Raises:
            VoccError: it has nothing of that name.
        """
        found: object = getattr(self.module(), name, None)
        if found is None:
            raise VoccError(f"file {self.path} has no {name}")
        return found


def one_line(error: BaseException) -> str:
    """Return the kind and the words of an error of someone else's code, in one line.

    Example:
        >>> one_line(KeyError("a"))
        "KeyError: 'a'"
    """
    return " ".join(f"{type(error).__name__}: {error}".split())


def _with_imports(path: Path) -> list[Path]:
    """Return a file and, in the order in which they are met, the files beside it that it imports."""
    files = [path]
    for file in files:
        try:
            nodes = list(ast.walk(ast.parse(file.read_bytes())))
        except (SyntaxError, ValueError):
            continue  # told of when the file is run
        names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        names += [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
        beside = [path.parent / f"{name.split('.')[0]}.py" for name in names]
        files += [one for one in dict.fromkeys(beside) if one.is_file() and one not in files]
    return files
