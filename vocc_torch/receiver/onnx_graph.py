"""A receiver as an ONNX graph, through torch.export: frames and corners in, bits out; an extra."""

import logging
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.receiver.classifiers import Guarded, SklearnClassifier
from vocc_torch.receiver.locators import OutsideLocator
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.types import Frames, Panels

RECTIFY, WHOLE = "receiver.onnx", "receiver_whole.onnx"
"""The graph that is told the corners, and the one that finds them."""

READ, FOUND = ("bits", "scores", "llr"), ("corners", "found")
"""What a graph gives, and what one gives too that looks for the panels."""


class _Graph(torch.nn.Module):
    """A receiver as a function of tensors alone: (B,H,W) frames, and (B,4,2) corners or none."""

    def __init__(self, receiver: Receiver) -> None:
        super().__init__()
        self.receiver = receiver

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Give what ``READ`` names, and what ``FOUND`` names where no corners are given."""
        frames, *corners = given
        seen = self.receiver(Frames.whole(frames), Panels.known(corners[0]) if corners else None)
        read = seen.bits, seen.scores, seen.llr
        return read if corners else (*read, seen.corners_px, seen.found)


def finds_panels(receiver: Receiver) -> bool:
    """Whether a receiver's locator says with ``exportable = True`` that it can be in a graph.

    Those that ship do not: how many blobs a frame has decides what they do next.
    """
    locator = receiver.locator
    made = locator.plug_in.made if isinstance(locator, OutsideLocator) else locator
    return getattr(made, "exportable", False) is True


def write_graph(receiver: Receiver, path: Path, frames: Tensor, corners_px: Tensor | None = None) -> None:
    """Write a receiver as an ONNX graph, whole or not at all; any number of frames, of any size, can be read.

    The graph takes ``frames`` (B,H,W) uint8, and ``corners`` (B,4,2) float64 px where it is told them, and
    gives ``bits`` (B,R,C) bool, ``scores`` and ``llr`` (B,R,C) float64, as :class:`Decoded` has them; one that
    looks for the panels gives ``corners`` and ``found`` (B,) too. It refuses nothing: what the receiver
    would refuse comes out as numbers without a meaning. A batch is read as finely as its nearest panel needs.

    Args:
        receiver: on the CPU.
        path: the file, replaced whole.
        frames: (B,H,W) uint8 frames to draw the graph with, at least two, with panels.
        corners_px: (B,4,2) their panels' corners; None for a graph that looks for them itself.

    Raises:
        VoccError: the extra is not installed, a scikit-learn estimator, a part that no graph can hold, or the
            file cannot be written.
    """
    try:
        from onnxscript import INT64
        from onnxscript import opset18 as op
    except ImportError as error:
        raise VoccError(f"{path.name} needs {error.name}: pip install 'vocc-torch[onnx]'") from None
    if isinstance(receiver.classifier, Guarded) and isinstance(
        receiver.classifier.classifier, SklearnClassifier
    ):
        raise VoccError(
            f"receiver {receiver.name} decides by scikit-learn, which is no part of an ONNX graph"
        )

    def searchsorted(table: Any, x: Any, out_int32: bool = False, right: bool = False, **_: object) -> Any:
        last = op.Constant(value_ints=[-1])
        beyond = (op.GreaterOrEqual if right else op.Greater)(op.Unsqueeze(x, last), table)
        return op.ReduceSum(op.Cast(beyond, to=INT64.dtype), last, keepdims=0)

    aten = torch.ops.aten
    given = (frames,) if corners_px is None else (frames, corners_px)
    batch, height, width = (torch.export.Dim(name, min=1) for name in ("batch", "height", "width"))
    sizes = ({0: batch, 1: height, 2: width}, {0: batch})[: len(given)]
    graph = _Graph(receiver.eval())
    quiet = logging.root.manager.disable
    with torch.no_grad(), warnings.catch_warnings():
        graph(*given)  # what parts work out once and keep is numbers from then on
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            program = torch.export.export(graph, given, dynamic_shapes={"given": sizes}, strict=False)
            drawn: Any = torch.onnx.export(
                program,
                dynamo=True,
                verbose=False,
                opset_version=18,
                input_names=("frames", "corners")[: len(given)],
                output_names=READ if len(given) == 2 else READ + FOUND,
                custom_translation_table={
                    aten.searchsorted.Tensor: searchsorted,
                    aten.bucketize.Tensor: lambda x, table, **how: searchsorted(table, x, **how),
                },
            )
        except Exception as error:  # of many kinds, from a part that looks at numbers to choose what it does
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            reason = f"{type(cause).__name__}: {str(cause).splitlines()[0]}"
            raise VoccError(f"receiver {receiver.name} fits no ONNX graph ({reason})") from error
        finally:
            logging.disable(quiet)
    with atomic_file(path) as temporary:
        drawn.save(temporary, external_data=False)
