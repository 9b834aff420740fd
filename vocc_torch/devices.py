"""Which device computes."""

from __future__ import annotations

import torch

from vocc_torch.errors import VoccError


def resolve_device(name: str) -> torch.device:
    """Turn a device's name into a device that is there.

    Raises:
        VoccError: an unknown device or one that this machine does not have.

    Example:
        >>> resolve_device("cpu")
        device(type='cpu')
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        device = None
    if device is None or device.type not in ("cpu", "cuda") or (device.type == "cpu" and device.index):
        raise VoccError.of("device", repr(name), "auto, cpu or cuda")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        there = f"{torch.cuda.device_count()} CUDA devices"
        raise VoccError(f"device is {name!r}, and this machine has {there}: use device=cpu or device=auto")
    return device
