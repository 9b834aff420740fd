"""What a price list is made of: the configurations, the scenes and how times are taken."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from vocc_torch.errors import VoccError, demand_least, section
from vocc_torch.measure.build import PRECISIONS, build_plan, without_absent
from vocc_torch.measure.config import Budget, Settings
from vocc_torch.measure.plan import (
    OWN_LOCATORS,
    Experiment,
    Locator,
    Plan,
    resolve_device,
)
from vocc_torch.receiver import onnx_graph
from vocc_torch.receiver.bank import FLDA_FEATURES
from vocc_torch.receiver.features import Gradient
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation.scene import SceneModel, narrowed
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.compare import TradeoffConfig

FRAMINGS: Mapping[str, Framing] = {"whole": "filled", "crops": "crop"}
"""How frames are rendered that a receiver gets whole, or cut to the panel's surroundings."""


@dataclass(frozen=True)
class TimingSettings:
    """How times are taken."""

    least_frames: int = 48  # timed rounds meet at least so many, whatever the batch
    most_batch: int = 1024  # frames at a time
    in_one_go: str = "flda_3"  # timed without stages too, to check the stages' sum
    varied: tuple[str, ...] = ("flda_3", "lmmse")  # measured at further values


TIMING = TimingSettings()

LISTS = (
    "locators",
    "samples_per_led",
    "gradients",
    "dtypes",
    "devices",
    "batch_sizes",
    "frames",
)
"""Lists of the configuration that hold at least one value, and each value once."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A configuration of the receiver: all that its decisions depend on.

    Args:
        receiver: what decides.
        locator: where the corners come from.
        samples_per_led: K.
        gradient: the gradient's kernel.
        dtype: working precision of rectification and features.

    Example:
        >>> Setting("flda_3", "paper", 8, "sobel", "float32").name
        'flda_3-paper-K8-sobel-float32'
    """

    receiver: str
    locator: Locator
    samples_per_led: int
    gradient: Gradient
    dtype: str

    @property
    def name(self) -> str:
        """A name of its own, also for a folder."""
        return f"{self.receiver}-{self.locator}-K{self.samples_per_led}-{self.gradient}-{self.dtype}"


@dataclass(frozen=True)
class TradeoffStudy:
    """A study of what accuracy costs in time.

    Args:
        plan: the world, the receivers and the budget, whose frames are counted for each kind of scenes; its
            experiment and the settings of its reader have no part in it.
        config: the study's section of the configuration.
        scene_name: what results call the scene.
        missing: devices that were asked for and are not there, and why.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: a value outside its range or an unknown name.
    """

    plan: Plan
    config: TradeoffConfig
    scene_name: str = ""
    missing: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every list and every number, before any work is done."""
        config = self.config
        if config.onnx:
            with section("tradeoff.onnx is true:", before="an ONNX graph"):
                onnx_graph.demand_extra()
        for name in (*LISTS, "scenes"):
            if not getattr(config, name):
                raise VoccError(
                    f"tradeoff.{name} is empty: it must hold at least one value"
                )
        allowed: dict[str, tuple[list[Any] | tuple[str, ...], tuple[str, ...]]] = {
            "locators": (
                config.locators,
                (*OWN_LOCATORS, *self.plan.receiver.locators),
            ),
            "dtypes": (config.dtypes, tuple(PRECISIONS)),
            "frames": (config.frames, tuple(FRAMINGS)),
            "combine": ([config.combine], ("one_at_a_time", "all")),
            "varied": (self.varied, self.plan.receiver.names),
        }
        for name, (values, known) in allowed.items():
            for value in values:
                if value not in known:
                    raise VoccError.of(
                        f"tradeoff.{name}", repr(value), f"of {', '.join(known)}", "has"
                    )
        for batch in config.batch_sizes:
            if not 1 <= batch <= TIMING.most_batch:
                raise VoccError.of(
                    "tradeoff.batch_sizes",
                    batch,
                    f"from 1 to {TIMING.most_batch}",
                    "has",
                )
        demand_least(
            "tradeoff.",
            config,
            repeats=1,
            threads=0,
            frames_a_preamble=1,
        )
        for name, scene in config.scenes.items():
            if not name.isidentifier() or not isinstance(scene, dict):
                raise VoccError.of(
                    f"tradeoff.scenes.{name}",
                    repr(scene),
                    "a word with values of scenes",
                )
            self.model(name)
        why = "task=tradeoff, which compares receivers on the same frames"
        self.plan.budget.demand_no_stop_rule(why)
        patches = {one.name: one.inputs.patch for one in self.plan.receiver.classifiers}
        for setting in self.settings:
            self.reader(setting)
            patch = patches.get(setting.receiver)
            if patch and setting.samples_per_led % patch.samples:
                rule = f"a multiple of classifiers.{setting.receiver}.inputs.patch.samples, {patch.samples}"
                raise VoccError.of(
                    "tradeoff.samples_per_led", setting.samples_per_led, rule, "has"
                )

    @property
    def varied(self) -> tuple[str, ...]:
        """Receivers that are measured at further values."""
        if self.config.varied is None:
            return tuple(
                name for name in TIMING.varied if name in self.plan.receiver.names
            )
        return tuple(self.config.varied)

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """The configurations: every receiver with every locator, then the varied ones.

        What a receiver does not look at is as the others have it, so that no two of them are the same.
        """
        config, receiver = self.config, self.plan.receiver
        combinations: list[tuple[Any, ...]] = list(
            itertools.product(config.samples_per_led, config.gradients, config.dtypes)
        )
        base = combinations[0]
        if config.combine == "one_at_a_time":
            combinations = [
                values
                for values in combinations
                if sum(a != b for a, b in zip(values, base, strict=True)) <= 1
            ]
        features = FLDA_FEATURES | {
            classifier.name: classifier.inputs.features
            for classifier in receiver.classifiers
        }
        # Checked by name: locators in the constructor, gradients by the reader.
        locators: list[Any] = config.locators
        settings: dict[Setting, None] = {}
        for names, choices in (
            (receiver.names, [base]),
            (self.varied, combinations),
        ):
            for locator, name, values in itertools.product(locators, names, choices):
                if name == "center_greyscale":
                    values = base
                samples, gradient, dtype = values
                if "gri" not in features.get(name, ()):
                    gradient = base[1]
                settings[Setting(name, locator, samples, gradient, dtype)] = None
        return tuple(settings)

    def reader(self, setting: Setting) -> Reader:
        """A setting's rectification and features.

        Raises:
            VoccError: a value that no reader has.
        """
        with (
            section(
                "tradeoff.samples_per_led has", before="receiver.samples_per_led is"
            ),
            section("tradeoff.gradients has", before="receiver.gradient is"),
        ):
            return replace(
                self.plan.receiver.reader,
                samples_per_led=setting.samples_per_led,
                gradient=setting.gradient,
            )

    def training(self, setting: Setting) -> Plan:
        """The plan by which a setting's receiver is trained; precision has no part in it."""
        classifiers = tuple(
            classifier
            for classifier in self.plan.receiver.classifiers
            if classifier.name == setting.receiver
        )
        receiver = replace(
            self.plan.receiver,
            names=(setting.receiver,),
            classifiers=classifiers,
            reader=self.reader(setting),
            save="flda_3",
            locator=setting.locator,
        )
        return replace(self.plan, receiver=receiver)

    @property
    def rule(self) -> Budget:
        """When a kind of scenes has enough frames."""
        return Budget(self.plan.budget.frames)

    def model(self, scenes: str) -> SceneModel:
        """The scenes of a kind.

        Raises:
            VoccError: a value outside its range.
        """
        return narrowed(
            self.plan.world.scene,
            self.config.scenes[scenes],
            f"tradeoff.scenes.{scenes}",
        )

    def point(self, scenes: str) -> str:
        """The point that keys the draws of a kind of scenes."""
        return f"tradeoff/{scenes}"

    def rounds(self, batch: int) -> int:
        """Timed rounds with batches of a size."""
        return max(self.config.repeats, -(-TIMING.least_frames // batch))


def build_tradeoff_study(
    settings: Settings, config: TradeoffConfig, folder: Path
) -> TradeoffStudy:
    """Build the study that ``task=tradeoff`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    receiver, left_out = without_absent(plan.receiver)
    # All frames are of the study's own scenes: no experiment narrows them.
    experiment = Experiment("tradeoff", "distance_m", (plan.world.scene.nearest_m,))
    once: dict[str, Any] = {
        name: list(dict.fromkeys(getattr(config, name))) for name in LISTS
    }
    # What ${receiver.locator} brought goes by its name.
    names = {settings.receiver.locator: plan.receiver.locator}
    once["locators"] = [names.get(name, name) for name in once["locators"]]
    devices: list[str] = []
    missing: dict[str, str] = {}
    for name in once["devices"]:
        try:
            with section("tradeoff.devices has", before="device is"):
                devices.append(str(resolve_device(name)))
        except VoccError as error:
            if not name.startswith("cuda") or len(config.devices) == 1:
                raise
            missing[name] = str(error).partition(", and ")[2].partition(":")[0]
    once |= {
        "devices": list(dict.fromkeys(devices)),
        "batch_sizes": sorted(once["batch_sizes"]),
    }
    plan = replace(plan, receiver=receiver, experiment=experiment)
    return TradeoffStudy(
        plan, replace(config, **once), settings.scene.name, missing, left_out
    )
