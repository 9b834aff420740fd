"""What ``vocc-torch --help`` says of every key: its value, and the words that its class has for it."""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any, get_type_hints

from omegaconf import DictConfig, OmegaConf

from vocc_torch.measure.config import ARGUMENT

EFFECTS = [
    "pose",
    "lens_distortion",
    "rolling_shutter",
    "stuck_leds",
    "led_scatter",
    "attenuation",
    "background_texture",
    "lamps",
    "second_panel",
    "airlight",
    "occlusion",
    "veiling_glare",
    "motion_blur",
    "defocus",
    "diffraction",
    "blooming",
    "vignetting",
    "bayer",
    "photoelectrons",
    "prnu",
    "dark_current",
    "hot_pixels",
    "shot_noise",
    "full_well",
    "dsnu",
    "row_noise",
    "read_noise",
    "gain",
    "demosaicing",
    "saturation",
    "quantization",
    "jpeg",
]
LOCATORS = ("truth", "paper", "refined")
RECEIVERS = [
    "center_greyscale",
    "average_greyscale",
    "flda_agr",
    "flda_gri",
    "flda_ngr",
    "flda_agr_ngr",
    "flda_2",
    "flda_3",
]
"""By name: what defines them needs torch, which the help does not wait for."""


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
    names = {"Effects": EFFECTS, "Receivers": RECEIVERS, "Locators": LOCATORS}
    lists = [f"{what} by name: {', '.join(known)}" for what, known in names.items()]
    # Hydra puts the text into a template of its own, where $ begins a placeholder.
    return "\n".join([*lines, "", *lists]).replace("$", "$$")


def keys_of(schema: type, prefix: str = "") -> dict[str, Any]:
    """List every key of a schema, with dots, and its type.

    Example:
        >>> from vocc_torch.measure.config import Settings
        >>> keys_of(Settings)["camera.gamma"]
        <class 'float'>
    """
    keys: dict[str, Any] = {}
    hints = get_type_hints(schema)
    for one in dataclasses.fields(schema):
        kind = keys[prefix + one.name] = hints[one.name]
        if isinstance(kind, type) and dataclasses.is_dataclass(kind):
            keys |= keys_of(kind, f"{prefix}{one.name}.")
    return keys


def descriptions(schema: type) -> dict[str, str]:
    """Read what the docstrings of a dataclass and its sections say of each key, by the key with dots.

    Example:
        >>> from vocc_torch.measure.config import Settings
        >>> descriptions(Settings)["budget.frames"]
        'test frames a point at most, at least 1'
    """
    said: dict[str, str] = {}
    for key, kind in {"": schema, **keys_of(schema)}.items():
        known = isinstance(kind, type) and dataclasses.is_dataclass(kind)
        for base in reversed(kind.__mro__) if known else ():
            for argument in re.findall(ARGUMENT, inspect.cleandoc(base.__doc__ or ""), re.MULTILINE):
                name, _, words = " ".join(argument.replace("``", "").split()).rstrip(".").partition(": ")
                said[f"{key}.{name}".lstrip(".")] = words
    return said
