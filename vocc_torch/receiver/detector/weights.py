"""The detector's file of weights: text with a digest, and no code in it."""

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import torch
from torch import nn
from torch.nn.utils import convert_conv2d_weight_memory_format

from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector.graphs import Graph
from vocc_torch.receiver.detector.judge import Judge
from vocc_torch.receiver.detector.placer import Placer
from vocc_torch.receiver.detector.scout import Scout
from vocc_torch.receiver.model_file import read_model, write_model

SHIPPED = "detector.json"
"""The weights that ship, beside this file; ``vocc-torch task=train_detector`` writes a file of this name."""

PARTS = ("scout", "judge", "placer")
"""The networks, in the order in which they see a frame; each is trained on what those before it find."""

ARITHMETICS = FLOAT32, INT8 = "float32", "int8"
"""How the networks compute: torch, the reference, or onnxruntime with numbers of 8 bits."""

_KIND = "detector"


@dataclass(frozen=True)
class Networks:
    """What was trained."""

    scout: nn.Module
    judge: nn.Module
    placer: nn.Module

    @classmethod
    def fresh(cls) -> "Networks":
        """Give untrained networks."""
        return cls(Scout(), Judge(), Placer())

    def parts(self) -> nn.ModuleDict:
        """Give them as one module, for its state."""
        return nn.ModuleDict({name: getattr(self, name) for name in PARTS})

    def save(self, path: Path) -> None:
        """Write the weights, rounded to 11 bits.

        Raises:
            VoccError: the file cannot be written.
        """
        state = self.parts().state_dict()
        rounded = {name: weights.half() for name, weights in state.items()}
        write_model(path, {"kind": _KIND}, rounded)


@lru_cache(maxsize=8)
def load_networks(
    path: Path | None, device: torch.device, arithmetic: str = FLOAT32
) -> Networks:
    """Read the weights of a file, or the weights that ship; nothing in the file is executed.

    Args:
        path: the file; None takes the weights that ship.
        device: where the networks run.
        arithmetic: one of ``ARITHMETICS``.

    Raises:
        VoccError: a file that is missing, damaged or of another kind; int8 elsewhere than on a CPU.
    """
    if path is None:
        with resources.as_file(
            resources.files("vocc_torch.receiver.detector") / SHIPPED
        ) as shipped:
            return load_networks(shipped, device, arithmetic)
    if arithmetic == INT8:
        if device.type != "cpu":
            raise VoccError(
                f"arithmetic int8 is for CPUs, and this is {device}: give device=cpu"
            )
        return Networks(**{part: Graph(path, part) for part in PARTS})
    settings, state = read_model(
        path, "weights", "a file that task=train_detector wrote"
    )
    with torch.inference_mode(False):
        networks = Networks.fresh()
        try:
            if settings["kind"] != _KIND or not all(
                bool(one.isfinite().all()) for one in state.values()
            ):
                raise ValueError
            networks.parts().load_state_dict(state)
        except (KeyError, RuntimeError, ValueError):
            raise VoccError(
                f"weights {path} hold no detector: train it again"
            ) from None
        nets = networks.parts().eval().requires_grad_(False).to(device)
        # With the channels last in memory a CPU convolves in 0.8 of the time.
        convert_conv2d_weight_memory_format(nets, torch.channels_last)
    return networks
