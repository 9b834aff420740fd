"""A Python file outside the package, from which a classifier comes."""

from __future__ import annotations

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
        """What tells this text from another: the start of its SHA-256.

        Raises:
            VoccError: the file cannot be read.
        """
        try:
            return hashlib.sha256(Path(self.path).read_bytes()).hexdigest()[:16]
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
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise VoccError(f"file {self.path} cannot be run ({reason})") from error
        return made

    def named(self, name: str) -> object:
        """Give what the file calls ``name``.

        Raises:
            VoccError: it has nothing of that name.
        """
        found: object = getattr(self.module(), name, None)
        if found is None:
            raise VoccError(f"file {self.path} has no {name}")
        return found
