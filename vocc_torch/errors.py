"""What the package raises when the user asks for something it cannot do."""

from __future__ import annotations


class VoccError(ValueError):
    """A mistake at the boundary: one line that names the key or argument, its value and what is allowed.

    The command line prints the message without a traceback and exits with status 2.

    Example:
        >>> raise VoccError("scene.distance_m is -3: it must be above 0")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: scene.distance_m is -3: it must be above 0
    """
