"""The study's section of the configuration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


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
