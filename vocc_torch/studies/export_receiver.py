"""``task=export_receiver``: a receiver as an ONNX graph, held against torch on simulated frames."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.api import simulate
from vocc_torch.measure import build, config, plan
from vocc_torch.receiver import onnx_graph
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.decode.run import receiver_of
from vocc_torch.studies.export import GraphConfig

GRAPHS = ("receiver.onnx", "receiver_whole.onnx")
"""The graph that is told the corners, and the one that looks for them."""


class GraphDifference(NamedTuple):
    """How far a graph is from torch.

    Args:
        bits: how many were compared.
        bits_apart: how many of them differ.
        scores_apart: how many of their scores differ at all.
        most: by which a score differs.
    """

    bits: int
    bits_apart: int
    scores_apart: int
    most: float

    def __str__(self) -> str:
        """Say it in a line."""
        scores = f"{self.scores_apart} scores differ, by at most {self.most:.2g}"
        return f"{self.bits_apart} of {self.bits} bits differ from torch's; {scores}"


def run_export_receiver(
    settings: config.Settings, graph: GraphConfig, folder: Path
) -> None:
    """Write ``receiver.onnx``, and ``receiver_whole.onnx`` where the locator can be in a graph.

    Raises:
        VoccError: the extra is not installed, or a receiver that no graph can hold.
    """
    onnx_graph.demand_extra()
    study, console = build.build_plan(settings), terminal.Console()
    study = replace(study, experiment=replace(study.experiment, training={}))
    receiver = receiver_of(settings, study, at_truth=False).cpu()
    names = GRAPHS[: 1 + receiver.locator.exportable]
    if names != GRAPHS:
        run_folder.say(
            console, "the graph takes the corners as an input: it has no locator"
        )
    for inputs, name in zip((2, 1), names, strict=False):
        drawn = next(crops(study, 2))[:inputs]
        onnx_graph.write_graph(receiver, folder / name, *drawn)
        apart = compared(
            onnx_graph.TensorReceiver(receiver),
            onnx_graph.read_graph(folder / name),
            (crop[:inputs] for crop in crops(study, graph.frames)),
        )
        run_folder.say(console, f"{name}: {apart}")
        run_folder.print_places(console, folder, [("graph", name)])
    run_folder.write_config(settings, folder)
    if settings.model is None:
        receiver.save(folder / "receiver.pt")
        run_folder.print_places(console, folder, [("receiver", "receiver.pt")])


def crops(study: plan.Plan, frames: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Simulate frames of a study's scenes as a graph takes them.

    Yields:
        Batches (B,H,W) uint8 and their panels' corners (B,4,2), from each crop's first pixel on.
    """
    for batch in simulate(
        study.world, frames, study.seed, batch=study.batch_frames, point="export"
    ):
        grey = batch.frames.grey[:, 0].round().clamp(0, 255).byte()
        corners = batch.corners_px - batch.frames.origin_px[:, None]
        yield grey.cpu().contiguous(), corners.cpu()


def compared(
    receiver: Callable[..., Sequence[Tensor]],
    graph: Callable[..., Sequence[Tensor]],
    batches: Iterable[tuple[Tensor, ...]],
) -> GraphDifference:
    """Count where a graph and torch differ.

    Args:
        receiver: gives bits and scores first, of a batch.
        graph: likewise.
        batches: what both are given.
    """
    answers = []
    with torch.inference_mode():
        for batch in batches:
            answers.append((*receiver(*batch)[:2], *graph(*batch)[:2]))
    bits, scores, graph_bits, near = map(torch.cat, zip(*answers, strict=True))
    return GraphDifference(
        bits.numel(),
        int((bits != graph_bits).sum()),
        int((scores != near).sum()),
        float((scores - near).abs().max()),
    )
