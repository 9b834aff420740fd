"""Receivers that come with the package, so that a picture is decoded without training."""

from dataclasses import replace
from importlib import resources
from pathlib import Path

from vocc_torch.errors import VoccError
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.types import PanelShape

SHIPPED = ("street",)
"""Names of the receivers that ship; ``models/README.md`` describes each."""


def shipped_receiver(name: str, shape: PanelShape | None = None) -> Receiver:
    """Load a receiver that ships, for a panel of any shape: its classifier decides LED by LED.

    Args:
        name: of the receiver.
        shape: rows and columns of the panel; those that it was calibrated on by default.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> shipped_receiver("street", PanelShape(4, 4)).shape.leds
        16
    """
    if name not in SHIPPED:
        raise VoccError.of(
            "model", repr(name), f"a receiver.pt, or {' or '.join(SHIPPED)}"
        )
    folder = Path(str(resources.files("vocc_torch.receiver")))
    receiver = Receiver.load(folder / "models" / f"{name}.pt")
    if shape is not None:
        receiver.reader = replace(receiver.reader, shape=shape)
    return receiver
