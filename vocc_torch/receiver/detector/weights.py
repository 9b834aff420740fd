"""The detector's file of weights: text with a digest, and no code in it."""

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector.judge import Judge
from vocc_torch.receiver.detector.placer import Placer
from vocc_torch.receiver.detector.scout import Scout
from vocc_torch.receiver.model_file import read_model, write_model

SHIPPED = "detector.json"
"""The weights that ship, beside this file; ``vocc-torch task=train_detector`` wrote them."""

CLUES = 12
"""Numbers of a candidate that the verdict weighs."""

_KIND = "detector"


class Verdict(nn.Module):
    """A candidate's score, from its clues: a layer of few units on standardised numbers.

    Example:
        >>> Verdict()(torch.zeros(3, CLUES)).shape
        torch.Size([3])
    """

    mean: Tensor
    spread: Tensor

    def __init__(self, hidden: int = 16) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(CLUES))
        self.register_buffer("spread", torch.ones(CLUES))
        self.direct = nn.Linear(CLUES, 1)
        self.layer = nn.Sequential(
            nn.Linear(CLUES, hidden), nn.Tanh(), nn.Linear(hidden, 1)
        )

    def forward(self, clues: Tensor) -> Tensor:
        """Give the log odds (n,) of clues (n,CLUES)."""
        standard = ((clues.float() - self.mean) / self.spread).clamp(-4, 4)
        odds: Tensor = (self.direct(standard) + self.layer(standard))[:, 0]
        return odds


@dataclass(frozen=True)
class Networks:
    """What was trained."""

    scout: Scout
    judge: Judge
    placer: Placer
    verdict: Verdict

    @classmethod
    def fresh(cls) -> "Networks":
        """Give untrained networks, laid out in memory for speed."""
        nets = (Scout(), Judge(), Placer())
        return cls(
            *(net.to(memory_format=torch.channels_last) for net in nets), Verdict()
        )

    def parts(self) -> nn.ModuleDict:
        """Give them as one module, for its state."""
        names = ("scout", "judge", "placer", "verdict")
        return nn.ModuleDict({name: getattr(self, name) for name in names})

    def save(self, path: Path) -> None:
        """Write the weights.

        Raises:
            VoccError: the file cannot be written.
        """
        write_model(path, {"kind": _KIND}, self.parts().state_dict())


@lru_cache(maxsize=8)
def load_networks(path: Path | None, device: torch.device) -> Networks:
    """Read the weights of a file, or those that ship; nothing in the file is executed.

    Raises:
        VoccError: a file that is missing, damaged or of another kind.
    """
    if path is None:
        with resources.as_file(
            resources.files("vocc_torch.receiver.detector") / SHIPPED
        ) as shipped:
            return load_networks(shipped, device)
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
        networks.parts().eval().requires_grad_(False).to(device)
    return networks
