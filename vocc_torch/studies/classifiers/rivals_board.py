"""The comparison of many receivers as a TensorBoard: curves by receiver, and one hparams row each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from vocc_torch.show.styles import value_text
from vocc_torch.show.tensorboard import write_boards
from vocc_torch.studies.classifiers.rivals import GENIE, Rivals


def write_rival_board(
    folder: str | Path, rivals: Rivals, figures: Mapping[str, Figure], texts: Mapping[str, str]
) -> None:
    """Write a run for each receiver, and one for the genie.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        rivals: what was measured.
        figures: figures by name.
        texts: Markdown by name.

    Raises:
        VoccError: the folder cannot be written.
    """
    tables = list(rivals.tables().values())
    names = [*rivals.receivers, *([GENIE] if rivals.marks else [])]
    numbers = {name: _numbers(rivals, name) for name in names}
    write_boards(folder, {"": tables}, figures, {}, texts, numbers)


def _numbers(rivals: Rivals, name: str) -> dict[str, float]:
    """Give what stands in a receiver's row beside its rates over all points."""
    tables, numbers = rivals.tables(), {}
    for experiment, value in rivals.points.items():
        for row in tables[experiment].of(name):
            if row.value == value:
                numbers[f"BER/{experiment}_{value_text(value)}"] = row.ber
        ratio = None if name == GENIE else rivals.ratio(experiment, name, value)
        if ratio is not None:
            numbers[f"of_{rivals.reference}/{experiment}_{value_text(value)}"] = ratio.value
    if name == GENIE:
        return numbers
    made = rivals.making[name]
    numbers |= {"making/training_s": made.training_s, "making/training_frames": float(made.frames)}
    for what, given in (("parameters", made.parameters), ("size_bytes", made.size_bytes)):
        if given is not None:
            numbers[f"making/{what}"] = float(given)
    if name in rivals.bits_ms:
        numbers["bits_ms"] = rivals.bits_ms[name]
    return numbers
