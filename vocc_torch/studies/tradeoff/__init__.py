"""``task=tradeoff``, what accuracy costs in time: its section of the configuration, without torch."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class TradeoffConfig:
    """What ``task=tradeoff`` compares, on which frames, and how times are taken.

    Of each list the first value is the base: every receiver is measured there with each of the locators, and
    those that are ``varied`` at the other values too.

    Args:
        locators: what finds the panel.
        samples_per_led: samples along an LED cell's side.
        gradients: kernels of the gradient.
        dtypes: working precisions of rectification and features.
        varied: receivers that are measured at further values too; null for flda_3 and lmmse.
        combine: ``one_at_a_time`` varies samples, gradient and precision by itself, ``all`` combines them.
        devices: where times are taken.
        batch_sizes: frames at a time.
        frames: what is handed to the receiver: ``whole`` frames, ``crops``.
        repeats: timed rounds, at least 1; small batches have more, so that all meet as many frames.
        threads: threads within an operation while times are taken; 0 for torch's own choice.
        frames_a_preamble: frames of data that a pair of frames of known bits serves, at least 1; errors are
            counted with a pair for each.
        genie_frames: frames of each kind of scenes for a decoder that knows the scene; 0 for none.
        scenes: kinds of scenes by name: what they narrow.
        onnx: whether reading located panels in onnxruntime is timed too, on the CPU; an extra.
    """

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
    onnx: bool = False
