"""Parts from outside the package: found by name, built from settings, identified by their code."""

import atexit
import functools
import importlib
import importlib.util
import inspect
import pkgutil
import shutil
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any, Self

from vocc_torch.errors import VoccError, shown
from vocc_torch.files import file_digest, read_file
from vocc_torch.sources import digest_of, package_digest
from vocc_torch.yaml_text import MOST_LEVELS

TARGET = "_target_"
"""The key that names a class or function."""

DIRECTIVES = (TARGET, "_args_", "_partial_", "_recursive_", "_convert_")
"""Keys that ask for a call, which no file may do."""

RELEASED = ("sklearn",)
"""Packages that are known by their release: their files differ between platforms."""

PREFIX = "vocc_torch_file_"
"""What the names of modules begin with that are files of the user's."""

EXPECTED: dict[str, str] = {}
"""In a worker: what :func:`files_read` gave in the process that began it."""

LONGEST_NAME = 100
"""Most letters of a part's name, which is in the names of files."""

READ: dict[str, tuple[str, str]] = {}
"""Absolute path and digest of each file that this process has run, by the path as it is named."""

COPIES: dict[str, Path] = {}
"""In a worker on another machine: where the files lie that came with a run, by their paths in its process."""


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
        """Digest of this text and of the texts that it imports from its folder.

        It is the start of their SHA-256, in hexadecimal.

        Raises:
            VoccError: the file cannot be read.
        """
        return digest_of(self.texts)

    @property
    def place(self) -> Path:
        """Where it lies: in a worker on another machine a copy of it."""
        return COPIES.get(self.path, Path(self.path))

    @property
    def texts(self) -> dict[str, bytes]:
        """Its text and the texts of modules that it imports from its folder, by path.

        Raises:
            VoccError: the file cannot be read.
        """
        place = self.place.absolute()
        # The package may lie in the same folder: its own version is recorded elsewhere.
        finder = ModuleFinder([str(place.parent)], excludes=["vocc_torch"])
        texts = {place.name: read_file(self.place)}
        with suppress(SyntaxError, ValueError):  # told of when the file is run
            finder.run_script(str(place))
        for module in finder.modules.values():
            path = Path(getattr(module, "__file__", None) or "")
            if path != place and path.is_file():
                texts[path.relative_to(place.parent).as_posix()] = read_file(path)
        return texts

    @property
    def module_name(self) -> str:
        """The name of the module that it is read as."""
        return f"{PREFIX}{Path(self.path).stem}_{self.digest}"

    def module(self) -> object:
        """Run the file as a module; an exception becomes one line.

        Raises:
            VoccError: the file cannot be read or run, or a worker meets another text than its run began with.
        """
        name, said = self.module_name, f"file {self.path}"
        absolute = str(Path(self.path).absolute())
        READ[self.path] = absolute, name.rpartition("_")[2]
        if not name.endswith(EXPECTED.get(absolute, "")):
            raise VoccError(f"{said} has changed since this run began: begin it again")
        if name in sys.modules:
            return sys.modules[name]
        spec = importlib.util.spec_from_file_location(name, self.place)
        if spec is None or spec.loader is None:
            raise VoccError(f"{said} is no Python file: its name must end in .py")
        # Before it runs, because dataclasses and pickles look their module up.
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        # A file that would end the program is no exception.
        except (Exception, SystemExit) as error:
            del sys.modules[name]
            raise VoccError(f"{said} cannot be run ({one_line(error)})") from error
        return module

    def named(self, name: str) -> object:
        """Return what the file calls ``name``.

        Raises:
            VoccError: it has nothing of that name.
        """
        found: object = getattr(self.module(), name, None)
        if found is None:
            raise VoccError(f"file {self.path} has no {name}")
        return found


def files_read() -> dict[str, str]:
    """Give the digest of each file that this process has run, by its absolute path."""
    return dict(READ.values())


def carried() -> dict[str, dict[str, bytes]]:
    """Give the files that this process has run to workers on other machines.

    Returns:
        By the path as it was named: the file, and what it imports from its own folder, by name.

    Raises:
        VoccError: a file has changed meanwhile.
    """
    given = {}
    for path, (_, digest) in sorted(READ.items()):
        file = ModuleFile(path)
        if not file.place.is_file():
            continue
        if file.digest != digest:
            raise VoccError(
                f"file {path} has changed since this run began: begin it again"
            )
        given[path] = file.texts
    return given


def receive(files: Mapping[str, Mapping[str, bytes]]) -> None:
    """Lay out what :func:`carried` gave elsewhere, in a folder that is gone when this process ends."""
    for path, texts in files.items():
        folder = Path(tempfile.mkdtemp(prefix="vocc-torch-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(text)
        COPIES[path] = folder / Path(path).name
        sys.path.append(str(folder))  # for what it imports from beside it


def one_line(error: BaseException) -> str:
    """Return the kind and the words of an error of someone else's code, in one line.

    Example:
        >>> one_line(KeyError("a"))
        "KeyError: 'a'"
    """
    return " ".join(f"{type(error).__name__}: {error}".split())


@contextmanager
def blamed(name: str) -> Iterator[None]:
    """Name a part whose code fails, in one line; the package's own refusals pass.

    Raises:
        VoccError: the code failed.

    Example:
        >>> with blamed("feature half"):
        ...     1 / 0
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: feature half failed (ZeroDivisionError: division by zero)
    """
    try:
        yield
    except VoccError:
        raise
    # Code that would end the program is no exception.
    except (Exception, SystemExit) as error:
        raise VoccError(f"{name} failed ({one_line(error)})") from error


@dataclass(frozen=True)
class PlugIn:
    """A part from outside as a configuration describes it: found and built where it is used.

    Args:
        key: where the configuration names it, which refusals begin with.
        name: its name in results, a word.
        target: ``PACKAGE.MODULE.NAME``, or ``FILE.py:NAME``.
        arguments: what a class is built with, or what a function is given beside its own arguments.

    Raises:
        VoccError: a name that is no word, or a target in Python's own library or of another form.

    Example:
        >>> PlugIn("receiver.locator", "half", "fractions.Fraction", {"numerator": 1, "denominator": 2})
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: receiver.locator._target_ is 'fractions.Fraction': it must be ...
    """

    key: str
    name: str
    target: str
    arguments: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the name and the form of the target."""
        if not self.name.isidentifier() or len(self.name) > LONGEST_NAME:
            rule = f"a word of at most {LONGEST_NAME} letters"
            raise VoccError.of(f"{self.key}: the name", shown(self.name), rule)
        for target in self.targets:
            package = target.partition(".")[0]
            if not is_target(target) or package in sys.stdlib_module_names:
                rule = "PACKAGE.MODULE.NAME or FILE.py:NAME, and nothing of Python's own library"
                raise VoccError.of(f"{self.key}.{TARGET}", shown(target), rule)

    @classmethod
    def of(cls, key: str, given: object, name: str = "") -> Self:
        """Read a part as a configuration writes it.

        Args:
            key: its place in the configuration.
            given: a target, or a mapping of ``_target_`` and arguments.
            name: what it is called; the target's last word by default.

        Raises:
            VoccError: a mapping without target, or what the class itself refuses.

        Example:
            >>> PlugIn.of("receiver.locator", "mine.py:Brightest").name
            'Brightest'
        """
        rest = dict(given) if isinstance(given, Mapping) else {TARGET: given}
        target = rest.pop(TARGET, None)
        if not isinstance(target, str):
            raise VoccError(f"{key} has no {TARGET}: it must name a class or function")
        return cls(
            key, name or target.replace(":", ".").rpartition(".")[2], target, rest
        )

    @property
    def settings(self) -> dict[str, object]:
        """What a model file keeps of it; :meth:`admitted` reads it back."""
        made_of = {TARGET: self.target, "arguments": dict(self.arguments)}
        return {"name": self.name, **made_of, "maker": self.maker}

    @classmethod
    def admitted(
        cls,
        key: str,
        settings: Mapping[str, Any],
        admitted: Sequence[str],
        shipped: Collection[str] = (),
    ) -> Self:
        """Read back what a model file keeps, if the user names where its code comes from.

        Args:
            key: for refusals.
            settings: as the file has them.
            admitted: Python files and packages that the user names.
            shipped: targets that need no permission.

        Raises:
            VoccError: code that nobody named, that has changed or that only imports the target, or arguments
                that are no plain values.
        """
        target, arguments = str(settings[TARGET]), dict(settings["arguments"])
        demand_plain(f"{key}.arguments", arguments)
        path, colon, word = target.rpartition(":")
        needed = Path(path).name if colon else target.partition(".")[0]
        if target not in shipped:
            origin = f"{key} comes from {shown(target)}"
            if needed == __package__:
                raise VoccError(f"{origin}, which is no part of a receiver")
            paths = {
                Path(name).name if colon else name: name for name in admitted[::-1]
            }
            if needed not in paths:
                raise VoccError(f"{origin}: add plug_ins=[{needed}] to run its code")
            target = f"{paths[needed]}:{word}" if colon else target
        plug_in = cls(key, settings["name"], target, arguments)
        if plug_in.maker != settings["maker"]:
            raise VoccError(
                f"{key}: {target} has other source than the model was made with: train it again"
            )
        if not plug_in.defined_there:
            raise VoccError(
                f"{key}: {target} is imported there and not defined: name the file that defines it"
            )
        return plug_in

    @property
    def defined_there(self) -> bool:
        """Whether its file, a file beside it, or its package defines the target instead of importing it."""
        home = getattr(self.found(), "__module__", None) or ""
        if self.file is None:
            return bool(home.partition(".")[0] == self.target.partition(".")[0])
        place = Path(getattr(sys.modules.get(home), "__file__", None) or "")
        text = self.file.texts.get(place.name)
        return text is not None and text == place.read_bytes()

    @property
    def file(self) -> ModuleFile | None:
        """The Python file outside the package that it comes from, if any."""
        path, colon, _ = self.target.rpartition(":")
        return ModuleFile(path) if colon else None

    def found(self) -> Any:
        """Import the class or function.

        Raises:
            VoccError: there is none of that name, or its module cannot be imported.
        """
        with self._refusing("imported"):
            return named(self.target)

    @contextmanager
    def _refusing(self, how: str) -> Iterator[None]:
        """Say in one line what cannot be done with the target, and why in the error's own words."""
        try:
            yield
        except VoccError as error:
            raise VoccError(f"{self.key}: {error}") from error
        except (Exception, SystemExit) as error:
            why = " ".join(str(error.__cause__ or error).split())
            raise VoccError(
                f"{self.key}: {self.target} cannot be {how} ({why})"
            ) from error

    @functools.cached_property
    def made(self) -> Any:
        """The object of its class, or the function, built once in each process.

        Raises:
            VoccError: it cannot be imported or built.
        """
        kind = self.found()
        if inspect.isclass(kind) or not callable(kind):
            return self.build(kind, self.arguments)
        return functools.partial(kind, **self.arguments) if self.arguments else kind

    def build(self, kind: object, arguments: Mapping[str, object]) -> Any:
        """Build an object of a class that was found.

        Raises:
            VoccError: it cannot be built.
        """
        if not callable(kind):
            raise VoccError(
                f"{self.key}: {self.target} is neither a class nor a function"
            )
        with self._refusing("built"):
            demand_taken(kind, arguments)
            return kind(**assembled(arguments))

    @property
    def targets(self) -> tuple[str, ...]:
        """Its target, and those within its arguments."""
        return self.target, *targets(self.arguments)

    @property
    def maker(self) -> str:
        """Identity of its code: a digest of its file or package; empty for this package."""
        if self.file:
            return self.file.digest
        try:
            found = pkgutil.resolve_name(self.target)
            homes = self.target, getattr(found, "__module__", None) or self.target
            names = {name.partition(".")[0] for name in homes} - {__package__}
            return " ".join(map(package_maker, sorted(names)))
        except Exception:
            return ""  # it cannot be built, which is told when it is

    def __hash__(self) -> int:
        """Hash by name and target; arguments may be lists."""
        return hash((self.name, self.target))

    @property
    def files(self) -> dict[str, str]:
        """Digests of the files that its arguments name, by argument."""
        return {
            key: file_digest(value)
            for key, value in self.arguments.items()
            if isinstance(value, str) and Path(value).is_file()
        }

    def __reduce__(self) -> tuple[type[Self], tuple[object, ...]]:
        """Pickle the settings alone: another process builds its own."""
        return type(self), (self.key, self.name, self.target, dict(self.arguments))


def demand_taken(kind: Callable[..., object], arguments: Mapping[str, object]) -> None:
    """Refuse an argument that a class does not take.

    Raises:
        TypeError: with what it takes.
    """
    try:
        taken = inspect.signature(kind).parameters
    except (TypeError, ValueError):  # of classes that cannot be looked into
        return
    strays = [name for name in arguments if name not in taken]
    if strays and not any(one.kind == one.VAR_KEYWORD for one in taken.values()):
        raise TypeError(f"it takes no {strays[0]}, but {', '.join(taken)}")


def package_maker(name: str) -> str:
    """Identify the code of a package: a digest of its files, or scikit-learn's release."""
    package = importlib.import_module(name)
    if name in RELEASED:
        return str(package.__version__)
    if hasattr(package, "__path__"):
        return package_digest(name)
    return ModuleFile(str(package.__file__)).digest


def is_target(text: str) -> bool:
    """Whether a word of a configuration names a class or function from outside, and no part by its name.

    Example:
        >>> is_target("mine.py:Brightest"), is_target("package.Locator"), is_target("refined")
        (True, True, False)
    """
    path, colon, name = text.rpartition(":")
    words = [name] if colon else name.split(".")
    is_place = path.endswith(".py") if colon else len(words) > 1
    return is_place and all(map(str.isidentifier, words))


def targets(build: object) -> Iterator[str]:
    """Yield the targets that build a value and the values within it.

    Example:
        >>> list(targets({"_target_": "a.B", "inner": [{"_target_": "c.d"}]}))
        ['a.B', 'c.d']
    """
    for key, value in build.items() if isinstance(build, Mapping) else enumerate(build):  # type: ignore[arg-type]
        if key == TARGET:
            yield str(value)
        elif isinstance(value, Mapping | list | tuple):
            yield from targets(value)


def demand_plain(key: str, value: object, allowed: Collection[str] = ()) -> None:
    """Refuse in a value from a file what could ask for a call: interpolations, and keys as ``_target_``.

    Args:
        key: its place, for refusals.
        value: numbers, texts, lists and mappings.
        allowed: such keys that are read otherwise.

    Raises:
        VoccError: there is one.

    Example:
        >>> demand_plain("locator", {"min_share": "${oc.env:HOME}"})
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: locator.min_share is '${oc.env:HOME}': it must be a value without ${
    """
    if isinstance(value, str) and "${" in value:
        raise VoccError.of(key, shown(value), "a value without ${")
    if key.count(".") > MOST_LEVELS:
        rule = f"a value of at most {MOST_LEVELS} levels"
        raise VoccError.of(f"{key[:40]}...", shown(type(value).__name__), rule)
    if isinstance(value, Mapping):
        for name, item in value.items():
            if name in DIRECTIVES and name not in allowed:
                raise VoccError.of(
                    f"{key}.{name}",
                    shown(item),
                    "left out: a file holds values and calls nothing",
                )
            demand_plain(key, name)
            demand_plain(f"{key}.{name}", item, allowed)
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            demand_plain(f"{key}.{place}", item, allowed)


def assembled(value: object) -> Any:
    """Build the parts that a configuration describes within a value, the inner ones first.

    Args:
        value: plain values; a mapping with ``_target_`` is a call.

    Raises:
        VoccError: a directive that there is not.

    Example:
        >>> assembled({"size": {"_target_": "vocc_torch.types.PanelShape", "rows": 2, "columns": 3}})
        {'size': PanelShape(rows=2, columns=3)}
    """
    if isinstance(value, list | tuple):
        return [assembled(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    parts = {name: assembled(item) for name, item in value.items()}
    target = parts.pop(TARGET, None)
    if target is None:
        return parts
    if unknown := [key for key in DIRECTIVES if key in parts]:
        raise VoccError(f"{target}: {unknown[0]} is no key of a part")
    return named(target)(**parts)


def named(target: str) -> Any:
    """Import what a target names.

    Raises:
        VoccError: its file cannot be run, or has nothing of that name.
    """
    path, colon, name = target.rpartition(":")
    return ModuleFile(path).named(name) if colon else pkgutil.resolve_name(target)
