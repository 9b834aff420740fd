"""Where a module's training stands, on disk after each pass, so that it goes on after an interruption."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.receiver.classifiers.recipe import TrainingRecipe

_CHECKSUM_BYTES = hashlib.sha256().digest_size


class Checkpoint:
    """One file for one training: module, source, first weights, recipe, panels, device and release name it.

    Another of these is another file, so nothing goes on from what is not its own. What the module's source
    calls in other files is not looked at. The file begins with the SHA-256 of its name and of what follows:
    one that was changed or renamed afterwards is refused.

    Args:
        folder: where the files are.
        module: before its training.
        recipe: how it is trained.
        data: inputs and bits of the training and of the validation.

    Example:
        >>> recipe, panels = TrainingRecipe(), [torch.zeros(4, 1), torch.zeros(4)]
        >>> one, other = (Checkpoint("kept", nn.Linear(1, 1), recipe, panels) for _ in range(2))
        >>> one.path.suffix, one.path == other.path  # other first weights
        ('.pt', False)
    """

    def __init__(
        self, folder: str, module: nn.Module, recipe: TrainingRecipe, data: Sequence[Tensor]
    ) -> None:
        settings, place = dataclasses.replace(recipe, checkpoints=None), data[0].device.type
        told = hashlib.sha256(f"{module!r} {settings!r} {place} {torch.__version__}".encode())
        for kind in dict.fromkeys(type(part) for part in module.modules()):
            told.update(f"{kind.__module__}.{kind.__qualname__} {_source(kind)}".encode())
        for tensor in [*module.state_dict().values(), *data]:
            told.update(str((tensor.shape, tensor.dtype)).encode())
            told.update(tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().data)
        self.path = Path(folder) / f"{type(module).__name__}-{told.hexdigest()[:16]}.pt"

    def load(self, device: torch.device) -> dict[str, Any] | None:
        """Read how far the training came, or None where it has not begun.

        Raises:
            VoccError: a file that is damaged, or that is not this training's.
        """
        if not self.path.exists():
            return None
        try:
            whole = self.path.read_bytes()
            kept = whole[_CHECKSUM_BYTES:]
            if whole[:_CHECKSUM_BYTES] != self._checksum(kept):
                raise VoccError(f"checkpoint {self.path} is damaged (its checksum does not fit): delete it")
            # The states of an optimizer and of a schedule have no narrower type.
            state: dict[str, Any] = torch.load(io.BytesIO(kept), map_location=device, weights_only=True)
        except VoccError:
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: it cannot be read"
            raise VoccError(f"checkpoint {self.path} is damaged ({reason}): delete it") from error
        return state

    def save(self, state: dict[str, Any]) -> None:
        """Write how far it came, whole or not at all.

        Raises:
            VoccError: the file cannot be written.
        """
        kept = io.BytesIO()
        torch.save(state, kept)
        write_atomically(self.path, self._checksum(kept.getvalue()) + kept.getvalue())

    def _checksum(self, kept: bytes) -> bytes:
        """Hash the file's name and the state."""
        return hashlib.sha256(self.path.name.encode() + kept).digest()


def _source(kind: type[nn.Module]) -> str:
    """Give the text of the file that defines a class, or nothing where there is none."""
    try:
        return Path(inspect.getfile(kind)).read_text(encoding="utf-8")
    except (OSError, TypeError, UnicodeDecodeError):
        return ""
