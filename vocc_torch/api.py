"""The public functions: scenes, trained receivers, simulated frames, and measured bit error rates."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch.utils.data import IterableDataset, get_worker_info

from vocc_torch.boundary import checked
from vocc_torch.errors import VoccError, section, shown, told_known
from vocc_torch.files import demand_folder, file_digest
from vocc_torch.measure import curve, runner, sweep
from vocc_torch.measure import train as training
from vocc_torch.measure.build import build_world, receiver_plan
from vocc_torch.measure.config import (
    Budget,
    ClassifierSettings,
    ReceiverParts,
    ReceiverSettings,
    WorldSettings,
)
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.link import Observation, block_keys, rendered
from vocc_torch.measure.plan import Experiment, Plan, ReceiverPlan, World, identity
from vocc_torch.measure.schema import options_of, refuse_shadowed, typed
from vocc_torch.measure.store import Store
from vocc_torch.plugins import TARGET, demand_plain, is_target
from vocc_torch.receiver.deciders import FLDA_FEATURES
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.report import folder, plots, rate_tables, terminal
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.types import Frames, Scene
from vocc_torch.yaml_text import parse_yaml, read_yaml

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATES = ("own", "sklearn")
"""Options of the group classifier that name no class."""


@checked
def load_scene(
    scene: str | Path | Mapping[str, object] = "paper", *overrides: str
) -> World:
    """Load a scene: camera, panel, ranges of its values, and effects.

    Args:
        scene: the name of a scene that ships, such as ``night``; a YAML file like those in ``conf/scene``;
            or a mapping with the same keys. Other keys are those of ``paper``; ``effects`` replace those of
            ``paper``. An effect with ``_target_`` runs code: check files of others first.
        overrides: words of the command line, such as ``camera.focal_length_mm=25`` and ``panel.rows=16``.

    Raises:
        VoccError: an unknown scene or key, a value outside its range, or an interpolation (``${``).

    Example:
        >>> world = load_scene({"distance_m": 40, "effects": {"saturation": {}}}, "panel.rows=4")
        >>> world.scene.distance_m.bounds, world.panel.shape.rows, list(world.effects)
        ((40.0, 40.0), 4, ['saturation'])
    """
    plain: Any = scene
    shipped = isinstance(scene, str) and not scene.endswith((".yaml", ".yml"))
    if shipped:
        plain = _shipped("scene", str(scene))
    elif isinstance(scene, str | Path):
        plain = read_yaml(scene, "scene")
    if not isinstance(plain, Mapping):
        raise VoccError.of("scene", shown(plain), "a mapping, as in key: value")
    demand_plain("scene", plain, allowed=(TARGET,))
    if not shipped:
        plain = {**_shipped("scene", "paper"), "name": "own", **plain}
    settings = typed(WorldSettings, {"scene": plain}, words=overrides)
    for word in overrides:
        refuse_shadowed(settings.scene, word)
    world = build_world(settings)
    world.simulator()  # a wrong effect is refused now
    return world


def _shipped(group: str, name: str) -> dict[str, Any]:
    """Read an option of a group of the configuration.

    Raises:
        VoccError: there is none of that name.
    """
    options = options_of(group)
    if name not in options:
        raise VoccError(f"{group} is {shown(name)}: {told_known(name, options)}")
    text = (
        resources.files("vocc_torch.conf")
        .joinpath(group, f"{name}.yaml")
        .read_text(encoding="utf-8")
    )
    return dict(parse_yaml(text))


@checked
def train(
    scene: World | str,
    *,
    locator: str = "paper",
    classifier: str = "flda_3",
    features: Sequence[str] | None = None,
    frames: int = 1000,
    seed: int = 0,
) -> Receiver:
    """Train a receiver on simulated frames and calibrate its scores.

    Args:
        scene: a scene of :func:`load_scene`, or its name.
        locator: ``paper``, ``refined``, ``detector``, or your own as ``FILE.py:NAME`` or
            ``PACKAGE.MODULE.NAME``.
        classifier: an FLDA receiver such as ``flda_3``, a classifier that ships such as ``lmmse``, or your
            own as ``FILE.py:NAME`` or ``PACKAGE.MODULE.NAME``.
        features: features of FLDA or of your own classifier, such as ``["agr", "gri",
            "mine.py:deviation"]``.
        frames: training frames, at least 2; a network has its own number.
        seed: seed of all random draws.

    Returns:
        A receiver that decodes images and can be saved.

    Raises:
        VoccError: an unknown name, or no panel in any training frame.

    Example:
        >>> receiver = train("paper", frames=64)
        >>> receiver.name, receiver.shape.leds
        ('flda_3', 64)
    """
    world = load_scene(scene) if isinstance(scene, str) else scene
    builtin = classifier if classifier in FLDA_FEATURES else "flda_3"
    receiver = ReceiverSettings(
        [builtin], locator, list(features or FEATURE_NAMES), save=classifier
    )
    parts = ReceiverParts(receiver)
    if is_target(classifier):
        receiver.save = classifier.replace(":", ".").rpartition(".")[2]
        parts.classifiers[receiver.save] = ClassifierSettings(
            build={TARGET: classifier}
        )
    elif classifier not in FLDA_FEATURES and not (
        classifier == "flda" and features is not None
    ):
        trained = {*options_of("classifier")} - {*TEMPLATES}
        if classifier not in trained:
            known = told_known(classifier, [*FLDA_FEATURES, *sorted(trained)])
            raise VoccError(
                f"classifier is {shown(classifier)}: {known}, or FILE.py:NAME"
            )
        parts.classifiers[classifier] = typed(
            ClassifierSettings, _shipped("classifier", classifier)
        )
    with (
        section("locator", before="receiver.locator"),
        section("features", before="receiver.features"),
        section("frames", before="budget.training_frames"),
    ):
        receivers = receiver_plan(parts, world.panel)
        experiment = Experiment("own", "distance_m", world.scene.distance_m.bounds[:1])
        budget = Budget(training_frames=frames)
        plan = Plan(world, receivers, experiment, budget, seed)
    return training.calibrated_receiver(plan, training.train(plan))


class Simulated(NamedTuple):
    """One batch of B simulated frames with their truth.

    Args:
        frames: crops around the panel, or whole frames if an effect fills the sensor; uint8 if the scene has
            the effect ``quantization``.
        bits: (B,R,C) bool, the bits sent.
        corners_px: (B,4,2) float64 true corners on the sensor, clockwise from the top left.
        scene: the scene values of each frame.
        further: bits (B,R,C) of further colours, ``second`` and ``third``, if there are any.
    """

    frames: Frames
    bits: torch.Tensor
    corners_px: torch.Tensor
    scene: Scene
    further: Mapping[str, torch.Tensor]


@checked
def simulate(
    scene: World | str,
    frames: int,
    seed: int = 0,
    *,
    batch: int = BLOCK_FRAMES,
    point: str = "frames",
) -> Iterator[Simulated]:
    """Simulate frames of a scene. They do not depend on the batch size.

    Args:
        scene: a scene of :func:`load_scene`, or its name.
        frames: number of frames, at least 1.
        seed: seed of all random draws.
        batch: frames per batch, at least 1.
        point: name of the random draws; another name gives other frames.

    Raises:
        VoccError: an unknown scene, or a number outside its range.

    Example:
        >>> sent = [one.bits for one in simulate("paper", frames=100)]
        >>> [len(bits) for bits in sent]
        [64, 36]
    """
    world = load_scene(scene) if isinstance(scene, str) else scene
    return iter(SimulatedFrames(world, frames, seed, batch=batch, point=point))


class SimulatedFrames(IterableDataset[Simulated]):
    """Batches of :func:`simulate` for ``torch.utils.data.DataLoader(..., batch_size=None)``.

    The workers of a loader share the batches. Frames and their order do not depend on the number of workers.

    Args:
        world: a scene of :func:`load_scene`.
        frames: number of frames, at least 1.
        seed: seed of all random draws.
        batch: frames per batch, at least 1.
        point: name of the random draws.

    Example:
        >>> from torch.utils.data import DataLoader
        >>> loader = DataLoader(SimulatedFrames(load_scene("paper"), 100), batch_size=None)
        >>> [len(batch.bits) for batch in loader]
        [64, 36]
    """

    @checked
    def __init__(
        self,
        world: World,
        frames: int,
        seed: int = 0,
        *,
        batch: int = BLOCK_FRAMES,
        point: str = "frames",
    ) -> None:
        self.world, self.frames = world, frames
        self.seed, self.batch, self.point = seed, batch, point

    def __iter__(self) -> Iterator[Simulated]:
        """Simulate the batches of this worker, drawing no more scenes at a time than a batch or a block needs."""
        worker, simulator, batch = get_worker_info(), self.world.simulator(), self.batch
        place, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        window = batch if workers > 1 else batch * -(-BLOCK_FRAMES // batch)
        for start in range(0, self.frames, window)[place::workers]:
            stop = min(start + window, self.frames)
            keys = block_keys(self.seed, self.point, stop, start)
            first = start % BLOCK_FRAMES
            rows = range(first, first + stop - start, batch)
            for drawn, bits, names, takes in rendered(
                simulator, self.world.scene, keys, rows, False
            ):
                corners = simulator.true_panels(drawn, names, rendered=True).corners_px
                further = simulator.further_bits(drawn, names)
                yield Simulated(takes[0], bits, corners, drawn, further)


@dataclass(frozen=True)
class Table:
    """Measured bit error rates, with intervals.

    Args:
        curves: every receiver at every value.
    """

    curves: curve.Curves

    @property
    def rows(self) -> tuple[curve.Row, ...]:
        """A row for each receiver and value: bit errors, bit error rate and its 95 % interval."""
        return self.curves.rows

    def plot(self, path: str | Path | None = None) -> "Figure":
        """Draw the curves; ``path`` also saves them as ``.png``, ``.pdf`` or ``.svg``."""
        figure = plots.ber_figure(self.curves, "Bit error rate")
        if path is not None:
            _demand_path(path)
            plots.save_figure(figure, path)
        return figure

    def to_csv(self, path: str | Path) -> None:
        """Write the rows, in the columns of ``ber.csv``."""
        _demand_path(path)
        folder.write_rows(path, rate_tables.ber_rows(self.curves))

    def __str__(self) -> str:
        """Write the table as text."""
        console = terminal.Console(width=110, force_jupyter=False, force_terminal=False)
        with console.capture() as text:
            terminal.print_table(self.curves, console)
        return text.get().rstrip()


def _demand_path(path: object) -> None:
    """Refuse a path that is no file in an existing folder."""
    if not isinstance(path, str | Path) or not Path(path).name:
        raise VoccError.of("path", shown(path), "that of a file")
    demand_folder(path)


@checked
def measure(
    receivers: Receiver | Mapping[str, Receiver],
    scene: World | str,
    axis: str,
    values: Sequence[float],
    frames: int = 1024,
    *,
    seed: int = 0,
    experiment: str = "scenes",
    progress: Callable[[int], None] = lambda frames: None,
    store: str | Path | None = None,
) -> Table:
    """Measure bit error rates of receivers on the same simulated frames, each with its own locator.

    ``vocc-torch experiment=scenes`` with the same scene, seed, locator and training counts the same errors.

    Args:
        receivers: a receiver, or several by name.
        scene: a scene of :func:`load_scene`, or its name.
        axis: the scene value that varies, such as ``distance_m``.
        values: values of the axis, ascending.
        frames: frames per value, at least 1.
        seed: seed of all random draws.
        experiment: name of the random draws, as ``experiment.name``.
        progress: called with the frames added since the last call.
        store: a file for the counts; the same call resumes from it.

    Raises:
        VoccError: an unknown axis or scene, values out of order, or a panel of another shape.

    Example:
        >>> table = measure(train("paper", frames=64), "paper", "distance_m", [30, 50], frames=64)
        >>> [(row.value, row.frames) for row in table.rows]
        [(30.0, 64), (50.0, 64)]
    """
    world = load_scene(scene) if isinstance(scene, str) else scene
    named = receivers
    if isinstance(named, Receiver):
        named = {named.name: named}
    if not named:
        raise VoccError.of("receivers", "{}", "a receiver, or several by name")
    axes = Experiment(experiment, axis, tuple(map(float, values)))
    reader = next(iter(named.values())).reader
    plan = Plan(world, ReceiverPlan(reader=reader), axes, Budget(frames), seed)
    jobs = [
        WholeJob(
            plan,
            axes.model_at(world, value),
            axes.point_name(value),
            (),
            receivers=named,
        )
        for value in axes.simulated_values
    ]
    counts: AbstractContextManager[Store | None] = nullcontext()
    if store is not None:
        settings = {**identity(plan, (OWN,)), "receivers": digests(named)}
        counts = Store.open(store, settings)
    with counts as opened:
        counted = sweep.outcomes(jobs, Workers(1), opened, progress)
        outcomes = dict(zip(axes.simulated_values, counted, strict=True))
    keys = {key.receiver: key for key in jobs[0].keys}
    return Table(sweep.curves_of(axes, keys, outcomes))


OWN = "of each receiver"
"""What the table calls the locator of each receiver."""


@dataclass(frozen=True, eq=False)
class WholeJob(runner.Job):
    """Receivers that look for the panel themselves.

    Args:
        receivers: by name.
    """

    receivers: Mapping[str, Receiver] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[Key, ...]:
        """Whose decisions are counted, in order."""
        return tuple(Key(OWN, name) for name in self.receivers)

    @property
    def finders(self) -> dict[str, PanelLocator | None]:
        """The locators by the receiver's name."""
        return {name: receiver.locator for name, receiver in self.receivers.items()}

    def decisions(
        self, views: Mapping[str, Observation]
    ) -> Iterator[tuple[torch.Tensor, Observation]]:
        """Decide one batch."""
        for name, receiver in self.receivers.items():
            view = views[name]
            with torch.inference_mode():
                bits = receiver(view.frames, view.panels).bits
            yield bits, view


def digests(receivers: Mapping[str, Receiver]) -> dict[str, str]:
    """Give a digest of each receiver's file.

    Raises:
        VoccError: a receiver that cannot be saved.
    """
    found = {}
    with tempfile.TemporaryDirectory() as there:
        for name, receiver in receivers.items():
            receiver.save(path := Path(there) / "receiver.pt")
            found[name] = file_digest(path)
    return found
