"""The study's section of the configuration."""

from __future__ import annotations

from dataclasses import dataclass

from omegaconf import MISSING


@dataclass
class DecodeConfig:
    """What ``task=decode`` writes besides the bits."""

    channel: str = MISSING
    annotate: bool = MISSING
    scale: int = MISSING
