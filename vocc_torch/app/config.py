"""The whole configuration: all sections, their descriptions for ``--help``, and the run's folder."""

import inspect
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.conf import HydraConf, JobConf, RunDir, SweepDir
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult
from omegaconf import OmegaConf

from vocc_torch.app.tasks import Task, covers, task_named
from vocc_torch.errors import VoccError, shown
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.messages.config import (
    MessagesConfig,
    ReceiveConfig,
    RecordConfig,
    TransmitConfig,
)
from vocc_torch.measure.config import ARGUMENT, Settings
from vocc_torch.measure.schema import keys_of
from vocc_torch.studies.compare import ComparisonConfig, EffectsConfig, TradeoffConfig
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.export import ExportConfig, GraphConfig
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.train_detector import TrainDetectorConfig
from vocc_torch.yaml_text import read_yaml


@dataclass
class AppConfig(Settings):
    """The whole configuration.

    Args:
        decode: how task=decode reads, and what it writes.
        figures: what task=figures makes.
        effects: what task=effects measures.
        tradeoff: what task=tradeoff compares.
        comparison: what task=classifiers compares.
        export: what task=export writes.
        export_receiver: how task=export_receiver checks a graph.
        transmit: how task=transmit writes a message.
        record: the simulated camera of task=record.
        receive: how task=receive reads a recording.
        messages: what task=messages varies and sends.
        calibrate: what task=calibrate fits.
        train_detector: how long task=train_detector trains.
    """

    decode: DecodeConfig = field(default_factory=DecodeConfig)
    figures: FiguresConfig = field(default_factory=FiguresConfig)
    effects: EffectsConfig = field(default_factory=EffectsConfig)
    tradeoff: TradeoffConfig = field(default_factory=TradeoffConfig)
    comparison: ComparisonConfig = field(default_factory=ComparisonConfig)
    export: ExportConfig = field(default_factory=ExportConfig)
    export_receiver: GraphConfig = field(default_factory=GraphConfig)
    transmit: TransmitConfig = field(default_factory=TransmitConfig)
    record: RecordConfig = field(default_factory=RecordConfig)
    receive: ReceiveConfig = field(default_factory=ReceiveConfig)
    messages: MessagesConfig = field(default_factory=MessagesConfig)
    calibrate: CalibrateConfig = field(default_factory=CalibrateConfig)
    train_detector: TrainDetectorConfig = field(default_factory=TrainDetectorConfig)

    def __post_init__(self) -> None:
        """Check what no section can check alone."""
        super().__post_init__()
        run_folder(self.name)
        for side in ("rows", "columns"):
            value = getattr(self.panel, side)
            if isinstance(value, str) and (value, self.task) != ("auto", "decode"):
                rule = "a whole number, and auto for task=decode alone"
                raise VoccError.of(f"panel.{side}", repr(value), rule)
        finds = self.task == "calibrate" or (
            self.task in ("decode", "receive") and self.model is None
        )
        if finds and self.receiver.locator == "truth":
            finders = "paper, refined or detector"
            rule = f"{finders} for task={self.task}: a recording has no true corners"
            raise VoccError.of("receiver.locator", "'truth'", rule)

    def plain(self) -> dict[str, Any]:
        """Give the plain values of the keys that the task uses."""
        return used(super().plain(), task_named(self.task))


def used(plain: Mapping[str, Any], task: Task, section: str = "") -> dict[str, Any]:
    """Leave out of plain values the keys that a task does not use.

    Args:
        plain: the values of a section.
        task: whose keys stay. Unknown keys stay too, so that they are refused later.
        section: where they are, with a point at its end.
    """
    values, known = dict[str, Any](), keys_of(AppConfig)
    for name, value in plain.items():
        key = f"{section}{name}"
        if key not in known or covers(task.keys, key):
            nested = is_dataclass(known.get(key)) and isinstance(value, dict)
            values[name] = used(value, task, f"{key}.") if nested else value
    return values


def inside_runs(folder: str | Path) -> bool:
    """Whether a folder is below ``runs/``, where links have led too; ``runs`` itself may be a link.

    Example:
        >>> inside_runs("runs/a"), inside_runs("runs"), inside_runs("runs/../a")
        (True, False, False)
    """
    # Path.resolve raises for links in a circle.
    return Path(os.path.realpath("runs")) in Path(os.path.realpath(folder)).parents


def run_folder(name: object) -> str:
    """Give the folder of a run, in which Hydra makes it, or refuse one that is not below ``runs/``.

    Raises:
        VoccError: the name leads out of ``runs/``, by itself or through a link, or has characters that mean
            something to a terminal, to Rich's markup or to Markdown.

    Example:
        >>> run_folder("two/words")
        'runs/two/words'
    """
    path = Path(text := str(name))
    if not text.isprintable() or set("`[]") & set(text):
        raise VoccError.of("name", ascii(text), "printable, without `, [ and ]")
    if not path.parts or ".." in path.parts or not inside_runs("runs" / path):
        raise VoccError.of(
            "name", repr(text), "a folder below runs/, without .. or links out"
        )
    return str("runs" / path)


def job_folder(name: object, job: int) -> str:
    """Give the folder of a multirun's job in that of its run, or refuse one that is a link out of it."""
    run_folder(f"{name}/{job}")
    return str(job)


NAMES = {
    "Effects": "pose, lens_distortion, rolling_shutter, stuck_leds, led_scatter, colour, attenuation, "
    "led_look, multiplexing, panel_absent, background_texture, scenery, backdrop, leaves, clutter, lamps, "
    "second_panel, housing, airlight, occlusion, veiling_glare, motion_blur, defocus, "
    "diffraction, blooming, vignetting, bayer, photoelectrons, prnu, dark_current, hot_pixels, shot_noise, "
    "full_well, dsnu, row_noise, read_noise, gain, demosaicing, saturation, letterbox, quantization, jpeg",
    "Receivers": "center_greyscale, average_greyscale, flda_agr, flda_gri, flda_ngr, flda_agr_ngr, flda_2, "
    "flda_3",
    "Locators": "truth, paper, refined, detector",
}
"""What the help lists by name: it does not wait for torch, which what defines them needs."""


def described(plain: dict[str, Any]) -> str:
    """Write a configuration as YAML, each key below its description."""
    said = descriptions(AppConfig)
    lines: list[str] = []
    path: list[str] = []
    for line in OmegaConf.to_yaml(OmegaConf.create(plain)).splitlines():
        if found := re.match(r"( *)(\w+):", line):
            path[len(found[1]) // 2 :] = [found[2]]
            if text := said.get(".".join(path)):
                lines.append(f"{found[1]}# {text}")
        lines.append(line)
    lists = [f"{kind} by name: {known}" for kind, known in NAMES.items()]
    # Hydra puts the text into a template of its own, where $ begins a placeholder.
    return "\n".join([*lines, "", *lists]).replace("$", "$$")


def descriptions(schema: type) -> dict[str, str]:
    """Read what the docstrings of a dataclass and its sections say of each key, by the key with dots.

    Example:
        >>> from vocc_torch.measure.config import Settings
        >>> descriptions(Settings)["budget.frames"]
        'most test frames per point, at least 1'
    """
    said: dict[str, str] = {}
    for key, kind in {"": schema, **keys_of(schema)}.items():
        known = isinstance(kind, type) and is_dataclass(kind)
        for base in reversed(kind.__mro__) if known else ():
            for argument in re.findall(
                ARGUMENT, inspect.cleandoc(base.__doc__ or ""), re.MULTILINE
            ):
                name, _, words = (
                    " ".join(argument.replace("``", "").split())
                    .rstrip(".")
                    .partition(": ")
                )
                said[f"{key}.{name}".lstrip(".")] = words
    return said


# Here, because worker processes of a multirun import this and register nothing.
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)


def hydra_settings() -> HydraConf:
    """Give Hydra's own settings, which hold for every primary configuration, a run's saved one too."""
    quiet = {"job_logging": "disabled", "hydra_logging": "disabled"}
    defaults = [
        {group: quiet.get(group, option) for group, option in choice.items()}
        for choice in HydraConf().defaults
    ]
    return HydraConf(
        defaults=defaults,
        output_subdir=None,  # the run's config.yaml has the whole configuration
        # The resolvers refuse a name that leads out of runs/ before anything is made.
        run=RunDir("${run_folder:${name}}"),
        sweep=SweepDir(
            "${run_folder:${name}}", "${job_folder:${name},${hydra.job.num}}"
        ),
        job=JobConf(chdir=False),
    )


class FileConfigSource(file_config_source.FileConfigSource):
    """A folder of configuration files that a user names: ``--config-dir``, ``--config-path``, a run's scene.

    The class has the name of Hydra's own reader, so that Hydra's workers do not replace it.
    """

    def is_group(self, config_path: str) -> bool:
        """Say whether a folder has options: ``tensorboard/`` of a run has none, and is a key there."""
        folder = Path(self.path, config_path)
        return super().is_group(config_path) and any(folder.rglob("*.yaml"))

    def load_config(self, config_path: str) -> ConfigResult:
        """Read a file as :func:`~vocc_torch.yaml_text.read_yaml` does, with Hydra's ``# @package`` on top.

        Raises:
            VoccError: no mapping, or what the reader refuses.
        """
        path = Path(self.path, self._normalize_file_name(config_path))
        plain = read_yaml(path, "configuration")
        if not isinstance(plain, dict | None):
            raise VoccError.of(str(path), shown(plain), "a mapping, as in key: value")
        head = path.read_bytes()[:512].decode(errors="replace")
        header = self._get_header_dict(head)
        config = OmegaConf.create(plain or {})
        return ConfigResult(self.provider, f"file://{self.path}", config, header)


def register() -> None:
    """Make the run's folder and the reader of files known to Hydra; again changes nothing."""
    Plugins.instance()  # which registers Hydra's own reader
    SourcesRegistry.instance().types["file"] = FileConfigSource
    store = ConfigStore.instance()
    store.store(
        group="hydra", name="config", node=hydra_settings(), provider="vocc_torch"
    )
