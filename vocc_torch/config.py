"""The configuration's schema, and the one place where Hydra's objects become the package's own."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from yaml import YAMLError

from vocc_torch.errors import VoccError

# A distribution is a number or a list such as [uniform, 40, 60]; OmegaConf has no type for that union.
Spec = Any


@dataclass
class SceneCameraConfig:
    """What a scene sets on the camera; the rest stays the camera group's."""

    focal_length_mm: float | None = None
    sensor_width_mm: float | None = None
    width_px: int | None = None
    height_px: int | None = None
    exposure_time_s: float | None = None
    f_number: float | None = None
    gamma: float | None = None
    iso_limits: list[float] | None = None


@dataclass
class SceneConfig:
    """Distributions of the scene's values, its settings of the camera, and the named effects."""

    name: str = ""
    ambient_lx: Spec = MISSING
    led_luminance_cd_m2: Spec = MISSING
    distance_m: Spec = MISSING
    background_grey: Spec = MISSING
    offset_x_m: Spec = MISSING
    offset_y_m: Spec = MISSING
    camera: SceneCameraConfig = field(default_factory=SceneCameraConfig)
    effects: dict[str, Any] = field(default_factory=dict)


@dataclass
class CameraConfig:
    """See :class:`vocc_torch.simulation.Camera`."""

    focal_length_mm: float = MISSING
    sensor_width_mm: float = MISSING
    width_px: int = MISSING
    height_px: int = MISSING
    exposure_time_s: float = MISSING
    f_number: float = MISSING
    calibration_constant: float = MISSING
    gamma: float = MISSING
    iso_limits: list[float] | None = None


@dataclass
class PanelConfig:
    """See :class:`vocc_torch.simulation.LedPanel`."""

    rows: int = MISSING
    columns: int = MISSING
    led_diameter_m: float = MISSING
    led_gap_m: float = MISSING
    led_reflectance: float = MISSING
    background_reflectance: float = MISSING
    board_reflectance: float | None = None


@dataclass
class LocationConfig:
    """See :class:`vocc_torch.receiver.location.PaperLocator`."""

    closing_px: int = MISSING
    min_area_px: int = MISSING
    min_rectangularity: float = MISSING
    min_compactness: float = MISSING
    quadrilateral: str = MISSING


@dataclass
class ReceiverConfig:
    """See :class:`vocc_torch.studies.plan.ReceiverPlan`."""

    names: list[str] = MISSING
    locator: str = MISSING
    samples_per_led: int = MISSING
    gradient: str = MISSING
    save: str = MISSING
    location: LocationConfig = field(default_factory=LocationConfig)


@dataclass
class ClassifierConfig:
    """See :class:`vocc_torch.studies.plug_in.ClassifierPlan`."""

    build: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Any] = field(default_factory=dict)
    file: str | None = None
    training: dict[str, Any] = field(default_factory=dict)
    frames: int | None = None
    scene: dict[str, Any] = field(default_factory=dict)


@dataclass
class ExperimentConfig:
    """See :class:`vocc_torch.studies.plan.Experiment`."""

    name: str = MISSING
    axis: str = MISSING
    values: list[float] = MISSING
    scene: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    row_axis: str | None = None
    rows: list[float] = field(default_factory=list)


@dataclass
class BudgetConfig:
    """See :class:`vocc_torch.studies.plan.Budget`."""

    frames: int = MISSING
    training_frames: int = MISSING
    target_frame_errors: int | None = None
    precision: float | None = None
    least_ber: float = 0.0


@dataclass
class FiguresConfig:
    """What ``task=figures`` makes: see :class:`vocc_torch.studies.campaign.Campaign`."""

    names: list[str] = field(default_factory=list)
    focal_lengths_mm: list[float] = field(default_factory=list)
    locators: list[str] = field(default_factory=list)
    experiments: dict[str, ExperimentConfig] = field(default_factory=dict)


@dataclass
class SeverityConfig:
    """See :class:`vocc_torch.studies.effect_costs.Severity`."""

    parameter: str = ""
    values: list[Any] = field(default_factory=list)


@dataclass
class EffectsConfig:
    """What ``task=effects`` looks at: see :class:`vocc_torch.studies.effect_costs.EffectStudy`."""

    names: list[str] = field(default_factory=list)
    located_frames: int = 0
    severity_frames: int = 0
    repeats: int = 0
    parts: dict[str, Any] = field(default_factory=dict)
    severity: dict[str, SeverityConfig] = field(default_factory=dict)


@dataclass
class RendererKnobsConfig:
    """See :class:`vocc_torch.studies.tradeoff.RendererKnobs`."""

    frames: int = 0
    kernel_sigmas: list[float] = field(default_factory=list)
    margins_px: list[int] = field(default_factory=list)
    supersampling: list[int] = field(default_factory=list)


@dataclass
class TradeoffConfig:
    """What ``task=tradeoff`` prices: see :class:`vocc_torch.studies.tradeoff.TradeoffStudy`."""

    locators: list[str] = field(default_factory=list)
    samples_per_led: list[int] = field(default_factory=list)
    gradients: list[str] = field(default_factory=list)
    dtypes: list[str] = field(default_factory=list)
    varied: list[str] | None = None
    combine: str = "one_at_a_time"
    devices: list[str] = field(default_factory=list)
    batch_sizes: list[int] = field(default_factory=list)
    frames: list[str] = field(default_factory=list)
    repeats: int = 0
    threads: int = 0
    frames_a_preamble: int = 1
    genie_frames: int = 0
    scenes: dict[str, Any] = field(default_factory=dict)
    simulation: RendererKnobsConfig = field(default_factory=RendererKnobsConfig)


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares: see :class:`vocc_torch.studies.rivals.RivalStudy`."""

    experiments: dict[str, ExperimentConfig] = field(default_factory=dict)
    reference: str = ""
    points: dict[str, float] = field(default_factory=dict)
    genie_frames: int = 0
    scenes: dict[str, SceneConfig] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 0


@dataclass
class DecodeConfig:
    """What ``task=decode`` writes besides the bits."""

    channel: str = MISSING
    annotate: bool = MISSING
    scale: int = MISSING


@dataclass
class AppConfig:
    """The whole configuration."""

    task: str = MISSING
    name: str = MISSING
    seed: int = MISSING
    device: str = MISSING
    precision: str = MISSING
    framing: str = MISSING
    batch_frames: int = MISSING
    workers: int = MISSING
    tensorboard: bool = MISSING
    input: str | None = None
    model: str | None = None
    scene: SceneConfig = field(default_factory=SceneConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    panel: PanelConfig = field(default_factory=PanelConfig)
    receiver: ReceiverConfig = field(default_factory=ReceiverConfig)
    experiment: ExperimentConfig = field(default_factory=ExperimentConfig)
    budget: BudgetConfig = field(default_factory=BudgetConfig)
    decode: DecodeConfig = field(default_factory=DecodeConfig)
    classifiers: dict[str, ClassifierConfig] = field(default_factory=dict)
    figures: FiguresConfig = field(default_factory=FiguresConfig)
    effects: EffectsConfig = field(default_factory=EffectsConfig)
    tradeoff: TradeoffConfig = field(default_factory=TradeoffConfig)
    rivals: RivalsConfig = field(default_factory=RivalsConfig)


def inside_runs(folder: str | Path) -> bool:
    """Whether a folder is below ``runs/``, where links have led too; ``runs`` itself may be a link.

    Example:
        >>> inside_runs("runs/a"), inside_runs("runs"), inside_runs("runs/../a")
        (True, False, False)
    """
    # Path.resolve raises for links in a circle.
    return Path(os.path.realpath("runs")) in Path(os.path.realpath(folder)).parents


def run_folder(name: str) -> str:
    """Give the folder of a run, in which Hydra makes it, or refuse one that is not below ``runs/``.

    Raises:
        VoccError: the name leads out of ``runs/``, by itself or through a link.

    Example:
        >>> run_folder("two/words")
        'runs/two/words'
    """
    path = Path(name)
    if not path.parts or ".." in path.parts or not inside_runs("runs" / path):
        raise VoccError(f"name is {name!r}: it must be a folder below runs/, without .. or links out")
    return str("runs" / path)


def job_folder(name: str, job: int) -> str:
    """Give the folder of a multirun's job in that of its run, or refuse one that is a link out of it."""
    run_folder(f"{name}/{job}")
    return str(job)


# Here, because worker processes of a multirun import this and do not register the schema.
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)


def register_schema() -> None:
    """Make the schema known to Hydra; calling it again changes nothing."""
    ConfigStore.instance().store(name="schema", node=AppConfig)


def resolved(config: DictConfig) -> AppConfig:
    """Turn Hydra's object into plain dataclasses, with every interpolation resolved and type checked.

    Raises:
        VoccError: a value that is missing or does not resolve.
    """
    try:
        settings = OmegaConf.to_object(config)
    except MissingMandatoryValue as error:
        raise VoccError(f"{error.full_key} is missing: it must have a value") from None
    except OmegaConfBaseException as error:
        said, _, place = " ".join(str(error).split()).partition(" full_key: ")
        key = place.split(" ")[0]
        raise VoccError(f"{key} cannot be resolved: {said}" if key else said) from None
    if not isinstance(settings, AppConfig):
        raise VoccError(
            "the configuration does not follow the schema: keep `schema` first in conf/config.yaml"
        )
    return settings


def as_yaml(settings: AppConfig) -> str:
    """Write the resolved configuration as YAML text."""
    return OmegaConf.to_yaml(OmegaConf.create(asdict(settings)))


def is_written_configuration(path: Path) -> bool:
    """Whether a file has all keys of a ``config.yaml`` that a run wrote; one that is not there has none."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return False
    return {line.partition(":")[0] for line in lines} >= {key.name for key in fields(AppConfig)}


def effect_settings(effects: dict[str, Any], key: str = "scene.effects") -> dict[str, Any]:
    """Check that the effects are a mapping of mappings; the registry checks names and parameters.

    Example:
        >>> effect_settings({"blooming": {"sigma_px": 1.5}})
        {'blooming': {'sigma_px': 1.5}}
    """
    for name, parameters in effects.items():
        if parameters is not None and not isinstance(parameters, dict):
            raise VoccError(
                f"{key}.{name} is {parameters!r}: it must be a mapping of parameters, {{}} for none"
            )
    return effects


def read_flat(path: str | Path) -> dict[str, object]:
    r"""Read a ``config.yaml`` that a run wrote, as keys with dots and plain values.

    Args:
        path: the file.

    Raises:
        VoccError: no such file, or one that is no configuration.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "config.yaml"
        ...     _ = path.write_text("seed: 1\npanel: {rows: 8}\nexperiment: {values: [30.0, 70.0]}\n")
        ...     read_flat(path)
        {'seed': 1, 'panel.rows': 8, 'experiment.values': [30.0, 70.0]}
    """
    try:
        read = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except OSError as error:
        raise VoccError(f"cannot read {path}: {error.strerror or error}") from None
    except (YAMLError, OmegaConfBaseException, UnicodeDecodeError) as error:
        raise VoccError(f"{path} is not a configuration: {' '.join(str(error).split())}") from None
    if not isinstance(read, dict) or not read:
        raise VoccError(f"{path} is not a configuration: it must be a mapping of keys")
    return _flat(read, "")


def _flat(settings: dict[Any, Any], prefix: str) -> dict[str, object]:
    """Join the keys of nested mappings by dots."""
    flat: dict[str, object] = {}
    for key, value in settings.items():
        name = f"{prefix}{key}"
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat
