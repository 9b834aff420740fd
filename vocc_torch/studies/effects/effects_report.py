"""``effects.md``: the table of effects and its figures, for a reader who was not there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vocc_torch.show.report import Bullets, Picture, Report, Section
from vocc_torch.studies.effects.effects_table import effects_table, notes, scene_text
from vocc_torch.studies.effects.table import EffectTable

_CAPTIONS = {
    "effects": "What each effect adds to the time of a frame and to the bit error rate.",
    "gallery": "One panel under each effect, at its harshest.",
    "severity": "Bit error rate over each effect's severity.",
}


def _data_of(picture: Path) -> Path | None:
    """Name the table that a figure draws."""
    return None if picture.stem == "gallery" else Path(f"{picture.stem}.csv")


def effects_report(table: EffectTable, pictures: Sequence[Path]) -> Report:
    """Lay out the report.

    Args:
        table: the effects.
        pictures: the figures, whose data lie beside them as CSV.
    """
    shown = tuple(
        Picture(Path(path.name), _CAPTIONS[path.stem], _CAPTIONS[path.stem], _data_of(path))
        for path in pictures
    )
    return Report(
        "What each effect costs and does",
        f"One at a time and all together, on the same frames{scene_text(table)}.",
        (
            Section("Table", "table", (effects_table(table), Bullets(tuple(notes(table))))),
            Section("Figures", "figures", shown),
        ),
    )
