"""The configuration's schema, and how it is written and read.

The classes of the domain are the schema: OmegaConf builds them, and they check themselves. No torch is
imported here, so that the command line answers ``--help`` and misspelled keys at once.
"""

import math
import re
from dataclasses import asdict, dataclass, field, fields, make_dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import MISSING, OmegaConf

from vocc_torch.distributions import SCENE_FIELDS, parsed_scene
from vocc_torch.errors import VoccError, demand_least, demand_word, section
from vocc_torch.hardware import Camera, LedPanel, PanelShape
from vocc_torch.plugins import DIRECTIVES, demand_plain
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.yaml_text import leaves, read_yaml

if TYPE_CHECKING:
    from vocc_torch.measure.plan import World
    from vocc_torch.simulation import SceneModel

MOST_TRAININGS = 1000
"""Most trainings of one receiver: each keeps counts of its own in the ledger."""

ARGUMENT = r"^ {4}\w+: .+(?:\n {8}.+)*"
"""An argument in a docstring, which the help shows."""


def demand_file_word(key: str, name: str) -> None:
    """Refuse a name that could not be part of a file's name.

    Raises:
        VoccError: one with a slash, a blank or the like.

    Example:
        >>> demand_file_word("experiment.name", "ambient")
    """
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise VoccError.of(key, repr(name), "a word of letters, digits, _, - and .")


@dataclass
class Budget:
    """Numbers of frames and trainings.

    Args:
        frames: most test frames per point, at least 1.
        training_frames: training frames per receiver, at least 2.
        trainings: independent trainings of each receiver, 1 to 1000. All are tested on the same frames; the
            first is saved. With 1 the scatter between trainings stays unknown.
        target_frame_errors: stop a point when every receiver has this many wrong frames; null counts all
            frames.
        precision: stop a point when every receiver's 95 % interval is within this share of its BER, above 0
            and below 1; null counts all frames.
        least_ber: with ``precision``: stop also when the interval lies below this rate, 0 to below 1.
        sampling: importance sampler, as PACKAGE.MODULE.NAME; null draws frames from the scene itself. For
            task=test with one curve and one training.

    Raises:
        VoccError: a number outside its range, or two stop rules that contradict each other.
    """

    frames: int = 1024
    training_frames: int = 1000
    target_frame_errors: int | None = None
    precision: float | None = None
    least_ber: float = 0.0
    trainings: int = 1
    sampling: str | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        demand_least(
            "budget.", self, frames=1, training_frames=2, target_frame_errors=1
        )
        share, target = self.precision, self.target_frame_errors
        trainings, least_ber = self.trainings, self.least_ber
        demands = (
            ("trainings", 1 <= trainings <= MOST_TRAININGS, f"1 to {MOST_TRAININGS}"),
            (
                "precision",
                share is None or 0 < share < 1,
                "above 0 and below 1, or null",
            ),
            ("least_ber", 0 <= least_ber < 1, "at least 0 and below 1"),
            (
                "least_ber",
                share is not None or not least_ber,
                "0 unless budget.precision is given",
            ),
            (
                "trainings",
                trainings == 1 or not self.sampling,
                "1 where budget.sampling is given",
            ),
            (
                "target_frame_errors",
                target is None or not self.sampling,
                "null where budget.sampling is given",
            ),
        )
        for name, is_kept, rule in demands:
            if not is_kept:
                raise VoccError.of(f"budget.{name}", getattr(self, name), rule)
        if share is not None and target is not None:
            raise VoccError(
                f"budget.precision is {share} and budget.target_frame_errors is {target}: "
                "give one of them, null for the other"
            )

    def demand_no_stop_rule(self, why: str) -> None:
        """Refuse a rule that stops before all frames are counted; ``why`` names the task and its reason."""
        for name in ("target_frame_errors", "precision"):
            if (value := getattr(self, name)) is not None:
                raise VoccError.of(f"budget.{name}", value, f"null for {why}")


@dataclass
class Experiment:
    """One BER curve, or a grid of curves: an axis, its values and how the test differs from the training.

    Args:
        name: name of the experiment in the results.
        axis: the quantity that varies: a value of the scene, or ``contrast``, by which drawn frames are
            sorted into bins.
        values: values of the axis, ascending; for ``contrast`` the edges of the bins.
        scene: ranges of the test scenes; they replace those of ``scene``.
        training: ranges of the training scenes; they replace those of ``scene``.
        row_axis: a second quantity, for a grid; null for one curve.
        rows: values of ``row_axis``, ascending.

    Raises:
        VoccError: an unknown axis, values that are not finite or not ascending, or rows without axis.
    """

    name: str = "own"
    axis: str = "distance_m"
    values: tuple[float, ...] = (50.0,)
    scene: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    row_axis: str | None = None
    rows: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check the distributions, the axes and their values."""
        self.values, self.rows = tuple(self.values), tuple(self.rows)
        for part in ("scene", "training"):
            parsed_scene(getattr(self, part), f"experiment.{part}")
        axes = (*SCENE_FIELDS, "contrast")
        demand_word("experiment.axis", self.axis, axes)
        if self.name.partition("/")[0] in ("", "train"):
            raise VoccError.of(
                "experiment.name",
                repr(self.name),
                "a name, and train is training's own",
            )
        binned = self.axis == "contrast"
        is_grid = self.row_axis is not None or bool(self.rows)
        if is_grid:
            known = [name for name in SCENE_FIELDS if name != self.axis]
            demand_word("experiment.row_axis", self.row_axis, known)  # type: ignore[arg-type]  # None is refused
        for name, least in (("values", 1 + binned), ("rows", int(is_grid))):
            numbers = getattr(self, name)
            apart = 1 + 1e-5 * is_grid  # rows are named by six digits
            ascending = all(a < b and a * apart <= b for a, b in pairwise(numbers))
            if len(numbers) < least or not (
                ascending and all(map(math.isfinite, numbers))
            ):
                rule = f"finite numbers in ascending order, at least {least} of them"
                rule += ", each a hundred-thousandth above the one before" * is_grid
                raise VoccError.of(f"experiment.{name}", list(numbers), rule)
            if is_grid and numbers[0] <= 0:
                raise VoccError.of(
                    f"experiment.{name}",
                    f"{numbers[0]:g}",
                    "above 0: a grid takes logarithms",
                    "has",
                )
        if binned and self.values[0] < 0:
            raise VoccError.of(
                "experiment.values",
                f"{self.values[0]:g}",
                "at least 0, as contrast, (G_on - G_off) / 255, is",
                "has",
            )

    @property
    def bins(self) -> int:
        """How many points share the frames of one run: the bins of contrast, otherwise 1."""
        return len(self.values) - 1 if self.axis == "contrast" else 1

    @property
    def simulated_values(self) -> tuple[float, ...]:
        """The values that are simulated one by one; a single stand-in where frames are sorted afterwards."""
        return self.values[:1] if self.axis == "contrast" else self.values

    @property
    def result_values(self) -> tuple[float, ...]:
        """The values of the results: those of the axis, or the middles of the contrast bins.

        Example:
            >>> Experiment("c", "contrast", (0.0, 0.06, 0.12)).result_values
            (0.03, 0.09)
        """
        ends = pairwise(self.values)
        middles = tuple(round((low + high) / 2, 12) for low, high in ends)
        return middles if self.axis == "contrast" else self.values

    def point_name(self, value: float) -> str:
        """Name a point; the name keys its random draws.

        Example:
            >>> Experiment("near", "distance_m", (5.0,)).point_name(5.0)
            'near/distance_m=5'
        """
        if self.axis == "contrast":
            return self.name
        # Six digits may stand for two values, which would then share their draws.
        digits = f"{value:g}" if float(f"{value:g}") == value else repr(value)
        return f"{self.name}/{self.axis}={digits}"

    def model_at(self, world: "World", value: float) -> "SceneModel":
        """The scenes of one point of the axis."""
        from vocc_torch.simulation.scene import narrowed

        model = narrowed(world.scene, self.scene)
        if self.axis == "contrast":
            return model
        with section("experiment.values has", before=f"scene.{self.axis} is"):
            return narrowed(model, {self.axis: value}, "scene")

    def training_model(self, world: "World") -> "SceneModel":
        """The scenes that a receiver trains on."""
        from vocc_torch.simulation.scene import narrowed

        return narrowed(world.scene, self.training, "experiment.training")


def _schema(name: str, entries: list[Any], *domains: type) -> type:
    """Make a section of the schema with the descriptions of domain classes."""
    description = "\n    ".join(str(domain.__doc__) for domain in domains)
    # The module is where the class is found when settings are pickled.
    return make_dataclass(
        name, entries, namespace={"__doc__": description, "__module__": __name__}
    )


if TYPE_CHECKING:
    # OmegaConf reads the types of the schema at run time; mypy takes them for what they are made of.
    CameraChanges = Camera
    PanelSettings = LedPanel
else:
    # The light meter's constant is no matter of the scene.
    changes = [
        (entry.name, entry.type | None, None)
        for entry in fields(Camera)
        if entry.name != "calibration_constant"
    ]
    CameraChanges = _schema("CameraChanges", changes, Camera)
    # A number of rows or columns, or auto where task=decode looks for it.
    sides = [(side.name, side.type | str, side.default) for side in fields(PanelShape)]
    others = [
        (entry.name, entry.type, entry.default)
        for entry in fields(LedPanel)
        if entry.name != "shape"
    ]
    PanelSettings = _schema("PanelSettings", [*sides, *others], PanelShape, LedPanel)


@dataclass
class SceneSettings:
    """The simulated scenes: ranges and effects.

    Args:
        name: name of the scene in the results.
        ambient_lx: illuminance by ambient light, lx.
        led_luminance_cd_m2: luminance of an On LED, cd/m2.
        distance_m: distance from the lens to the panel, m.
        background_grey: grey value that auto-ISO gives to the background, 1 to 255.
        offset_x_m: panel's centre right of the optical axis, m.
        offset_y_m: panel's centre below the optical axis, m.
        camera: camera values that the scene sets; null keeps those of ``camera``.
        effects: effects by name, each with its parameters; other effects are not run.
    """

    name: str = ""
    # A distribution is a number or a list such as [uniform, 40, 60]; OmegaConf has no type for that union.
    ambient_lx: Any = MISSING
    led_luminance_cd_m2: Any = MISSING
    distance_m: Any = MISSING
    background_grey: Any = MISSING
    offset_x_m: Any = MISSING
    offset_y_m: Any = MISSING
    camera: CameraChanges = field(default_factory=CameraChanges)
    effects: dict[str, Any] = field(default_factory=dict)


@dataclass
class ReceiverSettings:
    """The receivers of a run and their common parts.

    Args:
        names: receivers in the order of the results.
        locator: what finds the panel: ``paper``, ``refined``, ``detector``, a name in ``locators``, or
            FILE.py:NAME. ``truth`` takes the true corners.
        features: features of classifiers without ``inputs``. Another list than the default adds the receiver
            ``flda``, Fisher's discriminant on it. Your own are named in ``features`` or as FILE.py:NAME.
        samples_per_led: samples along the side of an LED cell, 2 to 64.
        gradient: ``sobel`` (Kornia's) or ``central`` (Eq. 6).
        cells: ``resampled``: bilinear samples; ``pixels``: whole pixels of the box around the discs of the
            LEDs.
        preambles: ``frame``: preambles are read at the corners of the test frame; ``located``: the panel is
            located in each of them too.
        save: the receiver that is saved as receiver.pt. Null saves the classifier if there is one, ``flda``
            if there are features of your own, else ``flda_3``.
        location: limits of the locator ``paper``.
        false_alarms: for ``detector``: accept a panel if at most this many false alarms are expected in a
            frame without one, above 0. Null takes 0.01, or the value in the model.
    """

    names: list[str] = field(default_factory=lambda: ["flda_3"])
    locator: str = "paper"
    features: list[str] = field(default_factory=lambda: ["agr", "gri", "ngr"])
    samples_per_led: int = 8
    gradient: str = "sobel"
    cells: str = "resampled"
    preambles: str = "frame"
    save: str | None = None
    location: LocatorLimits = field(default_factory=LocatorLimits)
    false_alarms: float | None = None


@dataclass
class ClassifierSettings:
    """A classifier that plugs in; see :class:`vocc_torch.measure.plan.ClassifierPlan`.

    Args:
        build: ``_target_`` names the class; the other keys are its arguments.
        inputs: what the classifier sees of each LED.
        file: a Python file that defines the class, or null.
        training: how a torch module is trained.
        frames: training frames; null takes budget.training_frames.
        scene: ranges of its training scenes; they replace those of ``scene``.
    """

    build: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Any] = field(default_factory=dict)
    file: str | None = None
    training: dict[str, Any] = field(default_factory=dict)
    frames: int | None = None
    scene: dict[str, Any] = field(default_factory=dict)


@dataclass
class ExecutorSettings:
    """Where frames are counted; see :class:`vocc_torch.measure.executors.Workers`.

    Args:
        kind: where frames are counted: ``here`` (this process), ``processes`` (of this machine), ``ray`` or
            ``dask`` (clusters), ``auto`` (here or processes, by ``workers``). Results are equal.
        address: the cluster, HOST:PORT; ``auto`` is the Ray cluster on this machine, ``local`` starts one.
    """

    kind: str = MISSING
    address: str = MISSING


@dataclass
class RunSettings:
    """What every run has.

    Args:
        task: what the command does.
        name: folder below runs/. The same name resumes an interrupted run.
        seed: seed of all random draws, at least 0.
    """

    task: str = MISSING
    name: str = MISSING
    seed: int = MISSING


@dataclass
class WorldSettings:
    """What is in front of the receiver, and how it is computed.

    Args:
        device: ``auto`` takes CUDA if there is a GPU; ``cpu``, ``cuda``, ``cuda:1``.
        precision: floating-point type of the simulation, ``float32`` or ``float64``.
        framing: ``crop`` renders the panel's surroundings, ``filled`` pastes them into a full frame,
            ``full`` renders the whole sensor. Decisions are equal.
        scene: the simulated scenes.
        camera: the camera.
        panel: the LED panel.
    """

    device: str = "auto"
    precision: str = "float32"
    framing: str = "crop"
    scene: SceneSettings = field(default_factory=SceneSettings)
    camera: Camera = field(default_factory=Camera)
    panel: PanelSettings = field(default_factory=PanelSettings)


@dataclass
class ReceiverParts:
    """What receives, with every part that plugs in.

    Args:
        receiver: the receivers of the run and their common parts.
        classifiers: classifiers that plug in, by name.
        locators: locators of your own by name, each with ``_target_`` and arguments.
        features: features of your own by name, each with ``_target_`` and arguments.
    """

    receiver: ReceiverSettings = field(default_factory=ReceiverSettings)
    classifiers: dict[str, ClassifierSettings] = field(default_factory=dict)
    locators: dict[str, Any] = field(default_factory=dict)
    features: dict[str, Any] = field(default_factory=dict)


@dataclass
class Settings(ReceiverParts, WorldSettings, RunSettings):
    """The configuration of every task; a study adds its own section.

    Args:
        batch_frames: frames computed at a time. Changes speed and memory, not results.
        workers: processes of one thread each. 0 takes one per core; null adds processes, at most 8, when
            they are faster. Results are equal.
        executor: where frames are counted.
        tensorboard: write a TensorBoard log.
        input: task=decode, receive: a picture, a folder, a film, an array or a live source; task=transmit:
            a file; task=record: the folder of task=transmit; task=collect: the folder of a sweep.
        model: a receiver.pt for task=decode, receive and export_receiver. auto takes the receiver that ships, or
            trains one if a key of the training is given, such as scene or classifier. null trains one; it is the
            default of task=receive and export_receiver.
        plug_ins: Python files and packages whose code a model may run, such as [mine.py].
        experiment: what is measured.
        budget: numbers of frames and trainings.
    """

    batch_frames: int = MISSING
    workers: int | None = None
    executor: ExecutorSettings = field(default_factory=ExecutorSettings)
    tensorboard: bool = MISSING
    input: str | None = None
    model: str | None = None
    plug_ins: list[str] = field(default_factory=list)
    experiment: Experiment = MISSING
    budget: Budget = field(default_factory=Budget)

    def __post_init__(self) -> None:
        """Check the names."""
        demand_file_word("experiment.name", self.experiment.name)

    def plain(self) -> dict[str, Any]:
        """Give the plain values, as they are saved."""
        return asdict(self)


def as_yaml(settings: Settings) -> str:
    """Write the configuration as YAML text."""
    return OmegaConf.to_yaml(OmegaConf.create(settings.plain()))


def effect_settings(
    effects: dict[str, Any], key: str = "scene.effects"
) -> dict[str, Any]:
    """Check that the effects are a mapping of mappings; the registry checks names and parameters.

    Example:
        >>> effect_settings({"blooming": {"sigma_px": 1.5}})
        {'blooming': {'sigma_px': 1.5}}
    """
    for name, parameters in effects.items():
        if parameters is not None and not isinstance(parameters, dict):
            raise VoccError.of(
                f"{key}.{name}",
                repr(parameters),
                "a mapping of parameters, {} for none",
            )
    return effects


def read_flat(path: str | Path) -> dict[str, object]:
    r"""Read a ``config.yaml`` that a run wrote, as keys with dots and plain values.

    Args:
        path: the file.

    Raises:
        VoccError: no such file, or one that is no configuration of a run, with aliases, which multiply, or
            interpolations, which read the environment.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "config.yaml"
        ...     _ = path.write_text("seed: 1\npanel: {rows: 8}\nexperiment: {values: [30.0, 70.0]}\n")
        ...     read_flat(path)
        {'seed': 1, 'panel.rows': 8, 'experiment.values': [30.0, 70.0]}
    """
    read = read_yaml(path)
    if not isinstance(read, dict) or not read:
        raise VoccError(f"{path} is not a configuration: it must be a mapping of keys")
    demand_plain(str(path), read, allowed=DIRECTIVES)
    return {name: value for name, value in leaves(read) if value != {}}
