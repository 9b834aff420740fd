"""The detector's networks in numbers of 8 bits: graphs that onnxruntime runs on a CPU. An extra."""

import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file, file_digest, ordinary_file

ROUNDED = ("Conv", "Add", "Relu", "Resize")
"""Operations in 8 bits. The others take as long in float32."""

MADE_OF = "made_of"
"""The entry of a graph's metadata that names the network and the digest of its file of weights."""


def demand_packages(*names: str) -> None:
    """Refuse to go on without some of the packages of the extra."""
    if lacking := [name for name in names if find_spec(name) is None]:
        raise VoccError(
            f"arithmetic int8 needs {' and '.join(lacking)}: pip install 'vocc-torch[onnx]'"
        )


def graph_path(weights: Path, part: str) -> Path:
    """Give the file of a network's graph, beside its file of weights.

    Example:
        >>> graph_path(Path("runs/mine/detector.json"), "scout").as_posix()
        'runs/mine/detector.scout.onnx'
    """
    return weights.with_suffix(f".{part}.onnx")


def origin(weights: Path, part: str) -> str:
    """Name a network and the digest of its weights, as a graph's metadata do."""
    return f"{part} {file_digest(weights)}"


class Graph(nn.Module):
    """A network whose graph onnxruntime runs, on as many threads as torch takes when it is loaded.

    Args:
        weights: the file of weights that the graph is of and lies beside.
        part: the network's name.

    Raises:
        VoccError: a package or the graph is missing, the graph is damaged, or it is of other weights.
    """

    def __init__(self, weights: Path, part: str) -> None:
        super().__init__()
        demand_packages("onnxruntime")
        import onnxruntime

        path, wanted = graph_path(weights, part), origin(weights, part)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        with ordinary_file(path) as file:
            content = file.read()
        # Bytes, unlike a path, let a graph refer to no other file.
        try:
            self.session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime's errors have no class in common
            rule = "holds no graph: train the detector again"
            raise VoccError(f"{path} {rule} ({type(error).__name__})") from None
        made_of = self.session.get_modelmeta().custom_metadata_map.get(MADE_OF)
        if made_of != wanted:
            rule = f"is not of the {part} in {weights.name}: train the detector again"
            raise VoccError(f"{path} {rule}")
        self.names = [given.name for given in self.session.get_inputs()]

    def forward(self, *given: Tensor) -> Any:
        """Compute the network's outputs."""
        fed = {
            name: tensor.float().numpy()
            for name, tensor in zip(self.names, given, strict=True)
        }
        outputs = [torch.from_numpy(array) for array in self.session.run(None, fed)]
        return outputs[0] if len(outputs) == 1 else tuple(outputs)


def write_graphs(
    nets: nn.ModuleDict,
    looks: Mapping[str, Sequence[tuple[Tensor, ...]]],
    weights: Path,
) -> None:
    """Write networks as graphs of 8 bits, beside their file of weights.

    Args:
        nets: by their names, on the CPU.
        looks: inputs of each network; the values inside the network set the ranges of the 8 bits.
        weights: the file of the networks' weights.

    Raises:
        VoccError: a package is missing, or a file cannot be written.
    """
    demand_packages("onnx", "onnxscript", "onnxruntime")
    import onnx
    from onnxruntime.quantization import QuantType, quantize_static

    for part, net in nets.items():
        with TemporaryDirectory() as folder, _quiet():
            plain, rounded = (Path(folder) / name for name in ("plain", "rounded"))
            names = _write_plain(net, looks[part][0], plain)
            quantize_static(
                plain,
                rounded,
                _Looks(names, looks[part]),
                op_types_to_quantize=list(ROUNDED),
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
            )
            model = onnx.load(rounded)
        # Metadata of operations would name source files of this machine.
        for node in model.graph.node:
            del node.metadata_props[:]
        del model.graph.value_info[:]
        del model.graph.metadata_props[:]
        onnx.helper.set_model_props(model, {MADE_OF: origin(weights, part)})
        with atomic_file(graph_path(weights, part)) as temporary:
            temporary.write_bytes(model.SerializeToString())


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide the libraries' warnings about graphs."""
    disabled = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)


class _Looks:
    """Inputs of a network, one after the other, as onnxruntime's quantisation reads them."""

    def __init__(self, names: list[str], looks: Sequence[tuple[Tensor, ...]]) -> None:
        self.fed = iter(
            {
                name: tensor.float().numpy()
                for name, tensor in zip(names, look, strict=True)
            }
            for look in looks
        )

    def get_next(self) -> Mapping[str, Any] | None:
        """Give the next inputs by name, or None at the end."""
        return next(self.fed, None)


def _write_plain(net: nn.Module, look: tuple[Tensor, ...], path: Path) -> list[str]:
    """Write a network as a graph of float32, and give its inputs' names."""
    count = torch.export.Dim("count", min=1)
    side: Any = net.sides_px
    high, wide = (side * torch.export.Dim(name, min=1) for name in ("high", "wide"))
    sizes = [
        {given.dim() - 2: high, given.dim() - 1: wide}
        | ({0: count} if number == 0 else {})
        for number, given in enumerate(look)
    ]
    # A batch of one would become a constant of the graph.
    several = torch.cat([look[0], look[0]]).float()
    floats = (several, *(given.float() for given in look[1:]))
    with torch.no_grad():
        program = torch.export.export(
            net, floats, dynamic_shapes=tuple(sizes), strict=False
        )
        drawn: Any = torch.onnx.export(
            program, dynamo=True, verbose=False, opset_version=18
        )
    drawn.save(path, external_data=False)
    return [given.name for given in drawn.model.graph.inputs]
