"""The whole configuration: all sections, their descriptions for ``--help``, and the run's folder."""

import inspect
import os
import re
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.conf import HydraConf, JobConf, RunDir, SweepDir
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, OmegaConf

from vocc_torch.errors import VoccError, shown
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.messages.config import (
    MessagesConfig,
    ReceiveConfig,
    RecordConfig,
    TransmitConfig,
)
from vocc_torch.hardware import LedPanel
from vocc_torch.measure.config import ARGUMENT, Budget, Experiment, Settings
from vocc_torch.measure.schema import keys_of as keys_of
from vocc_torch.studies.compare import EffectsConfig, RivalsConfig, TradeoffConfig
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.export import ExportConfig
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.train_detector import TrainDetectorConfig
from vocc_torch.yaml_text import read_yaml

TASKS = {
    "train": ("studies.curve:run_train", None),
    "test": ("studies.curve:run_test", None),
    "decode": ("studies.decode.run:run_decode", "decode"),
    "figures": ("studies.paper.run:run_figures", "figures"),
    "effects": ("studies.compare.effects:run_effects_task", "effects"),
    "tradeoff": ("studies.compare.tradeoff:run_tradeoff", "tradeoff"),
    "classifiers": ("studies.compare.classifiers:run_classifiers", "rivals"),
    "collect": ("studies.collect:run_collect", None),
    "export": ("studies.export.run:run_export", "export"),
    "export_receiver": ("studies.export_receiver:run_export_receiver", None),
    "transmit": ("extras.messages.transmit_task:run_transmit", "transmit"),
    "record": ("extras.messages.record_task:run_record", "record"),
    "receive": ("extras.messages.receive_task:run_receive", "receive"),
    "messages": ("extras.messages.comparison_task:run_messages", "messages"),
    "calibrate": ("extras.calibrate.task:run_calibrate", "calibrate"),
    "train_detector": (
        "studies.train_detector.run:run_train_detector",
        "train_detector",
    ),
}
"""What runs each task, below ``vocc_torch``, and the section that is its own."""


@dataclass
class AppConfig(Settings):
    """The whole configuration.

    Args:
        decode: what task=decode writes besides the bits.
        figures: what task=figures makes.
        effects: what task=effects looks at.
        tradeoff: what task=tradeoff prices.
        rivals: what task=classifiers compares.
        export: what task=export writes.
        transmit: how task=transmit writes a message.
        record: the camera's time in task=record.
        receive: how task=receive reads a recording.
        messages: what task=messages varies and sends.
        calibrate: what task=calibrate looks at.
        train_detector: how much task=train_detector learns from.
    """

    decode: DecodeConfig = field(default_factory=DecodeConfig)
    figures: FiguresConfig = field(default_factory=FiguresConfig)
    effects: EffectsConfig = field(default_factory=EffectsConfig)
    tradeoff: TradeoffConfig = field(default_factory=TradeoffConfig)
    rivals: RivalsConfig = field(default_factory=RivalsConfig)
    export: ExportConfig = field(default_factory=ExportConfig)
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
        if self.task not in TASKS:
            raise VoccError.of("task", repr(self.task), f"one of {', '.join(TASKS)}")
        for side in ("rows", "columns"):
            value = getattr(self.panel, side)
            if isinstance(value, str) and (value, self.task) != ("auto", "decode"):
                rule = "a whole number, and auto for task=decode alone"
                raise VoccError.of(f"panel.{side}", repr(value), rule)
        finds = self.task == "calibrate" or (
            self.task in ("decode", "receive") and self.model is None
        )
        if finds and self.receiver.locator == "truth":
            finders = "paper, refined or learned"
            rule = (
                f"{finders} for task={self.task}: a recording does not tell its corners"
            )
            raise VoccError.of("receiver.locator", "'truth'", rule)


PARTS = ("classifiers", "locators", "features")
"""What plugs in."""

RECORDED = ("input", "model", "plug_ins")
"""What tells of a recording, and of a receiver that is at hand."""

COUNTING = tuple(
    f"budget.{one.name}" for one in fields(Budget) if one.name != "training_frames"
)
TESTING = tuple(
    f"experiment.{one.name}" for one in fields(Experiment) if one.name != "training"
)
ALONE = (
    "workers",
    "executor",
    "tensorboard",
    "scene.name",
    "receiver.names",
    *COUNTING,
)
"""What has no part in making one receiver."""

IGNORED = {
    "train": (*RECORDED, *ALONE, *TESTING),
    "test": RECORDED,
    "decode": (*ALONE, "experiment"),
    "figures": (
        *(
            *RECORDED,
            "experiment",
            "receiver.locator",
            "receiver.false_alarms",
            "scene.name",
        ),
        *("camera.focal_length_mm", "panel.board_reflectance"),  # readings set them
    ),
    "effects": (
        *(
            *RECORDED,
            "experiment",
            "receiver.locator",
            "receiver.false_alarms",
            "receiver.features",
        ),
        *("budget.trainings", *PARTS),
    ),
    "tradeoff": (*RECORDED, "experiment", "receiver.save"),
    "classifiers": (*RECORDED, "experiment"),
    "export_receiver": (
        *(
            "input",
            "experiment",
            "workers",
            "executor",
            "tensorboard",
            "scene.name",
            "receiver.names",
        ),
        *(one for one in COUNTING if one != "budget.frames"),
    ),
    "export": (*RECORDED, "receiver", "budget", "tensorboard", "scene.name", *PARTS),
    "transmit": (
        *(
            "model",
            "plug_ins",
            "seed",
            "device",
            "precision",
            "framing",
            "batch_frames",
            "workers",
        ),
        *(
            "executor",
            "tensorboard",
            "scene",
            "camera",
            "receiver",
            "experiment",
            "budget",
            *PARTS,
        ),
        *(f"panel.{one.name}" for one in fields(LedPanel) if one.name != "shape"),
    ),
    "record": (
        *(
            "model",
            "plug_ins",
            "workers",
            "executor",
            "tensorboard",
            "scene.name",
            "receiver",
            "experiment",
        ),
        *("budget", "panel.rows", "panel.columns", *PARTS),
    ),
    "receive": (*ALONE, "experiment", "panel.rows", "panel.columns"),
    "messages": (
        *(*RECORDED, "tensorboard", "scene.name", "receiver.save", *COUNTING),
        *(one for one in TESTING if one != "experiment.scene"),
        *(
            f"messages.signalling.{one}"
            for one in ("code", "code_rate", "interleave", "scramble")
        ),
        *(f"messages.record.{one}" for one in ("fps", "start_s", "quality")),
    ),
    "calibrate": (
        *(
            "model",
            "plug_ins",
            "seed",
            "device",
            "precision",
            "framing",
            "batch_frames",
            "workers",
        ),
        *(
            "executor",
            "tensorboard",
            "camera.iso_limits",
            "scene",
            "experiment",
            "budget",
            *PARTS,
        ),
        *(
            "receiver.names",
            "receiver.features",
            "receiver.samples_per_led",
            "receiver.gradient",
            "receiver.cells",
        ),
        "receiver.save",
    ),
    "train_detector": (
        *(
            "model",
            "input",
            "plug_ins",
            "device",
            "precision",
            "framing",
            "batch_frames",
            "workers",
        ),
        *(
            "executor",
            "tensorboard",
            "scene",
            "camera",
            "panel",
            "receiver",
            "experiment",
            "budget",
            *PARTS,
        ),
    ),
    "collect": tuple(
        one.name
        for one in fields(AppConfig)
        if one.name not in ("task", "name", "input")
    ),
}
"""What each task passes over, besides the sections of others: keys, and sections for all that is in them."""


def passes_over(task: str, key: str) -> bool:
    """Whether a task makes no use of a key, or of any key of a section or group.

    Example:
        >>> passes_over("train", "budget.frames"), passes_over("train", "budget")
        (True, False)
    """
    others = [part for _, part in TASKS.values() if part not in (None, TASKS[task][1])]
    return any(
        f"{key}.".startswith(f"{one}.") for one in (*IGNORED.get(task, ()), *others)
    )


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
        VoccError: the name leads out of ``runs/``, by itself or through a link, or has characters that mean
            something to a terminal, to Rich's markup or to Markdown.

    Example:
        >>> run_folder("two/words")
        'runs/two/words'
    """
    path = Path(name)
    if not name.isprintable() or set("`[]") & set(name):
        raise VoccError.of("name", ascii(name), "printable, without `, [ and ]")
    if not path.parts or ".." in path.parts or not inside_runs("runs" / path):
        raise VoccError.of(
            "name", repr(name), "a folder below runs/, without .. or links out"
        )
    return str("runs" / path)


def job_folder(name: str, job: int) -> str:
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
    "Locators": "truth, paper, refined, learned",
}
"""What the help lists by name: it does not wait for torch, which what defines them needs."""


def described(root: DictConfig, schema: type) -> str:
    """Write a configuration as YAML, each key below its description; ``hydra`` is left out.

    Args:
        root: the configuration.
        schema: its class, whose docstring and those of its sections describe the keys.
    """
    said = descriptions(schema)
    lines: list[str] = []
    path: list[str] = []
    shown = OmegaConf.masked_copy(root, [str(key) for key in root if key != "hydra"])
    for line in OmegaConf.to_yaml(shown).splitlines():
        if found := re.match(r"( *)(\w+):", line):
            depth = len(found[1]) // 2
            path[depth:] = [found[2]]
            if text := said.get(".".join(path)):
                lines.append(f"{found[1]}# {text}")
        lines.append(line)
    lists = [f"{what} by name: {known}" for what, known in NAMES.items()]
    # Hydra puts the text into a template of its own, where $ begins a placeholder.
    return "\n".join([*lines, "", *lists]).replace("$", "$$")


def descriptions(schema: type) -> dict[str, str]:
    """Read what the docstrings of a dataclass and its sections say of each key, by the key with dots.

    Example:
        >>> from vocc_torch.measure.config import Settings
        >>> descriptions(Settings)["budget.frames"]
        'test frames a point at most, at least 1'
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


# Here, because worker processes of a multirun import this and do not register the schema.
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)
OmegaConf.register_new_resolver(
    "described", lambda _root_: described(_root_, AppConfig), replace=True
)


@dataclass
class Composed(AppConfig):
    """The configuration while Hydra puts it together: a classifier may get its first key by a dotted name."""

    classifiers: dict[str, Any] = field(default_factory=dict)


@cache
def schema(kind: type[AppConfig] = AppConfig) -> DictConfig:
    """Make the schema once; its sections take values although some are built as frozen dataclasses."""
    made: DictConfig = OmegaConf.structured(kind)
    for frozen in (made.camera, made.receiver.location):
        OmegaConf.set_readonly(frozen, None)
    return made


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

    Hydra's workers take a class of this name for Hydra's own reader, and leave it in its place.
    """

    def load_config(self, config_path: str) -> ConfigResult:
        """Read a file as :func:`~vocc_torch.yaml_text.read_yaml` does, with Hydra's ``# @package`` on top.

        Raises:
            VoccError: no mapping, or what the reader refuses.
        """
        path = Path(self.path, self._normalize_file_name(config_path))
        plain = read_yaml(path, "configuration")
        if not isinstance(plain, dict | None):
            raise VoccError.of(str(path), shown(plain), "a mapping, as in key: value")
        with path.open(encoding="utf-8") as file:
            header = self._get_header_dict(file.read(512))
        config = OmegaConf.create(plain or {})
        return ConfigResult(self.provider, f"file://{self.path}", config, header)


def register_schema() -> None:
    """Make the schema, the run's folder and the reader of files known to Hydra; again changes nothing."""
    Plugins.instance()  # which registers Hydra's own reader
    SourcesRegistry.instance().types["file"] = FileConfigSource
    store = ConfigStore.instance()
    store.store(name="schema", node=schema(Composed))
    store.store(
        group="hydra", name="config", node=hydra_settings(), provider="vocc_torch"
    )
