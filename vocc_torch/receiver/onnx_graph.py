"""A receiver as an ONNX graph, through torch.export: frames and corners in, bits out. An extra."""

import logging
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.receiver.classifiers import SklearnClassifier
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.types import Frames, Panels

READ, FOUND = ("bits", "scores", "llr"), ("corners", "found")
"""What a graph gives, and what one gives too that looks for the panels."""


def demand_extra() -> None:
    """Refuse to go on without the packages of the extra.

    Raises:
        VoccError: one is not installed, or torch is too old for a graph.
    """
    lacking = [
        name
        for name in ("onnx", "onnxscript", "onnxruntime")
        if find_spec(name) is None
    ]
    if not hasattr(torch.compiler, "is_exporting"):
        lacking.append("torch 2.7")
    if lacking:
        raise VoccError(
            f"an ONNX graph needs {' and '.join(lacking)}: pip install 'vocc-torch[onnx]'"
        )


class TensorReceiver(torch.nn.Module):
    """A receiver as a function of tensors: the graph is exported from it and compared with it.

    Args:
        receiver: on the CPU.
    """

    def __init__(self, receiver: Receiver) -> None:
        super().__init__()
        if receiver.reader.disc_share is not None:
            raise VoccError.of("receiver.cells", "pixels", "resampled for a graph")
        self.receiver = receiver.eval()

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Give what ``READ`` names of (B,H,W) frames at (B,4,2) corners; without those ``FOUND`` too."""
        frames, *corners = given
        decoded = self.receiver(
            Frames.whole(frames), Panels.known(corners[0]) if corners else None
        )
        read = decoded.bits, decoded.scores, decoded.llr
        return read if corners else (*read, decoded.corners_px, decoded.found)


def write_graph(
    receiver: Receiver, path: Path, frames: Tensor, corners_px: Tensor | None = None
) -> None:
    """Write a receiver as an ONNX graph, whole or not at all.

    The graph takes ``frames`` (B,H,W) uint8, any number of any size, and ``corners`` (B,4,2) float64, px,
    unless it locates the panels itself. It returns ``bits`` (B,R,C) bool and ``scores`` and ``llr`` (B,R,C)
    float64. A graph that locates panels also returns ``corners`` and ``found`` (B,). The graph does not check
    its input: invalid input gives meaningless numbers. All panels of a batch are sampled as finely as the
    largest.

    Args:
        receiver: on the CPU.
        path: the file, replaced whole.
        frames: (B,H,W) uint8 frames with panels to draw the graph with, at least two.
        corners_px: (B,4,2) their panels' corners; None for a graph that looks for panels itself.

    Raises:
        VoccError: the extra is not installed, an estimator of scikit-learn, a part that no graph can hold, or
            the file cannot be written.
    """
    demand_extra()
    learned = getattr(receiver.classifier, "classifier", None)
    if isinstance(learned, SklearnClassifier):
        raise VoccError(
            f"receiver {receiver.name} decides by scikit-learn: no ONNX graph of torch has that"
        )

    inputs = (frames,) if corners_px is None else (frames, corners_px)
    batch, height, width = (
        torch.export.Dim(name, min=1) for name in ("batch", "height", "width")
    )
    sizes = ({0: batch, 1: height, 2: width}, {0: batch})[: len(inputs)]
    function, disabled = TensorReceiver(receiver), logging.root.manager.disable
    with torch.no_grad(), warnings.catch_warnings():
        # What its parts work out once and keep is numbers from then on.
        function(*inputs)
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            program = torch.export.export(
                function, inputs, dynamic_shapes={"given": sizes}, strict=False
            )
            drawn: Any = torch.onnx.export(
                program,
                dynamo=True,
                verbose=False,
                opset_version=18,
                input_names=("frames", "corners")[: len(inputs)],
                output_names=READ if len(inputs) == 2 else READ + FOUND,
            )
        except Exception as error:  # of many kinds, from a part that looks at numbers to choose what it does
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            reason = " ".join(
                [f"{type(cause).__name__}:", *str(cause).splitlines()[:1]]
            )
            raise VoccError(
                f"receiver {receiver.name} fits no ONNX graph ({reason})"
            ) from error
        finally:
            logging.disable(disabled)
    with atomic_file(path) as temporary:
        drawn.save(temporary, external_data=False)


def read_graph(path: Path, threads: int = 0) -> Callable[..., list[Tensor]]:
    """Give what runs a graph on the CPU: tensors in, tensors out, as :class:`TensorReceiver` does.

    Args:
        path: what :func:`write_graph` wrote.
        threads: threads of a run; 0 takes one a core.

    Raises:
        VoccError: the extra is not installed.
    """
    demand_extra()
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(
        path, options, providers=["CPUExecutionProvider"]
    )
    names = [get_input.name for get_input in session.get_inputs()]

    def run(*given: Tensor) -> list[Tensor]:
        fed = {name: tensor.numpy() for name, tensor in zip(names, given, strict=True)}
        return [torch.from_numpy(array) for array in session.run(None, fed)]

    return run
