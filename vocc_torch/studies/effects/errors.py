"""Wrong bits of each test frame of a scene, read by receivers that trained on several scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.tally import half_errors
from vocc_torch.receiver.bank import ReceiverBank, needs_preambles
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BlockKey
from vocc_torch.studies.effects.plan import POINT, Key


@dataclass(frozen=True)
class FrameErrors:
    """Wrong bits of N frames, by frame.

    Args:
        halves: by the scene that the receivers trained on, (L,N) wrong bits times two of L receivers.
        found: (N,) whether the panel was found.
    """

    halves: Mapping[Key, NDArray[np.int64]]
    found: NDArray[np.bool_]

    @staticmethod
    def joined(parts: list[FrameErrors]) -> FrameErrors:
        """Join the frames of several parts in order."""
        halves = {
            key: np.concatenate([part.halves[key] for part in parts], axis=1) for key in parts[0].halves
        }
        return FrameErrors(halves, np.concatenate([part.found for part in parts]))


@dataclass(frozen=True)
class Piece:
    """Some blocks of a scene's test frames, as they are sent to a worker.

    Args:
        plan: the scene, the locator and the receivers.
        fldas: by the scene that they trained on.
        blocks: indices of the blocks.
        frames: frames of the blocks to read, from the first on.
    """

    plan: Plan
    fldas: Mapping[Key, FLDA]
    blocks: tuple[int, ...]
    frames: int


def read_piece(piece: Piece) -> FrameErrors:
    """Simulate, locate and read a piece, and count each frame's wrong bits."""
    names, link = piece.plan.receiver.names, Link.of(piece.plan)
    device = link.simulator.device
    banks = {key: ReceiverBank(names, flda.to(device)) for key, flda in piece.fldas.items()}
    keys = [BlockKey(piece.plan.seed, POINT, block) for block in piece.blocks]
    parts = []
    for seen in link.observe(
        piece.plan.world.scene, keys, preambles=needs_preambles(names), frames=piece.frames
    ):
        halves = {}
        for trained, bank in banks.items():
            scores = bank.scores(seen.readings, seen.preambles).values()
            wrong = [half_errors(score >= 0, seen.bits, seen.panels.found) for score in scores]
            halves[trained] = torch.stack(wrong).cpu().numpy()
        parts.append(FrameErrors(halves, seen.panels.found.cpu().numpy()))
    return FrameErrors.joined(parts)
