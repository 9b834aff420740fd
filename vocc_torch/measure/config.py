"""The configuration's schema for what all studies share, and how it is read and written."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING, OmegaConf
from omegaconf.errors import OmegaConfBaseException
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
    """See :class:`vocc_torch.measure.plan.ReceiverPlan`."""

    names: list[str] = MISSING
    locator: str = MISSING
    samples_per_led: int = MISSING
    gradient: str = MISSING
    save: str = MISSING
    location: LocationConfig = field(default_factory=LocationConfig)


@dataclass
class ClassifierConfig:
    """See :class:`vocc_torch.measure.plug_in.ClassifierPlan`."""

    build: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Any] = field(default_factory=dict)
    file: str | None = None
    training: dict[str, Any] = field(default_factory=dict)
    frames: int | None = None
    scene: dict[str, Any] = field(default_factory=dict)


@dataclass
class ExperimentConfig:
    """See :class:`vocc_torch.measure.plan.Experiment`."""

    name: str = MISSING
    axis: str = MISSING
    values: list[float] = MISSING
    scene: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    row_axis: str | None = None
    rows: list[float] = field(default_factory=list)


@dataclass
class BudgetConfig:
    """See :class:`vocc_torch.measure.plan.Budget`."""

    frames: int = MISSING
    training_frames: int = MISSING
    target_frame_errors: int | None = None
    precision: float | None = None
    least_ber: float = 0.0


@dataclass
class Settings:
    """What every task is told; a study adds a section of its own."""

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
    classifiers: dict[str, ClassifierConfig] = field(default_factory=dict)


def as_yaml(settings: Settings) -> str:
    """Write the resolved configuration as YAML text."""
    return OmegaConf.to_yaml(OmegaConf.create(asdict(settings)))


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
