"""What the readings of a recording come to: the best one, hints where nothing is found, and warnings."""

import math
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console

from vocc_torch.receiver.receiver import Receiver
from vocc_torch.report.folder import say
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.reading import Reading, is_adjustable

BY_CHANCE = 0.3
"""False alarms in all frames from which on the likeliest place is not worth a hint. In one frame rates above
0.07 are not told from 1: the first floor of the tables."""


@dataclass
class Summary:
    """What the readings of a recording come to.

    Args:
        best: the reading with the largest least margin.
        frames: how many frames there are.
        shown: how many of them have a panel that was found.
        found: panels that were read, in each colour; the next three are counted among them.
        doubtful: how many may be no panel or misread.
        alike: how many have LEDs of one level.
        least_alarms: false alarms a frame at the likeliest place not found; NaN where none are stated.
        likeliest: the frame that shows it.
        most: surely seen in one frame, of a locator that says how sure it is.
        notes: what the reader assumed about files, and the first file of each.
    """

    best: Reading | None = None
    frames: int = 0
    shown: int = 0
    found: int = 0
    doubtful: int = 0
    alike: int = 0
    least_alarms: float = math.nan
    likeliest: str = ""
    most: int = 0
    notes: dict[str, str] = field(default_factory=dict)
    _last: tuple[str, int] | None = None

    def add(self, reading: Reading) -> None:
        """Count a reading."""
        place, alarms = (
            (reading.frame.source, reading.frame.index),
            reading.false_alarms,
        )
        is_new, self._last = place != self._last, place
        self.frames += is_new
        self.shown += reading.found and is_new
        if reading.frame.note:
            self.notes.setdefault(reading.frame.note, reading.frame.source)
        if not reading.found:
            if alarms > 0 and not self.least_alarms <= alarms:
                self.least_alarms, self.likeliest = alarms, reading.place
            return
        self.found += 1
        if not math.isnan(alarms):
            self.most = max(self.most, reading.candidates)
        self.doubtful += reading.is_doubtful
        self.alike += reading.one_level
        if self.best is None or reading.margin > self.best.margin:
            self.best = reading

    def print_best(self, console: Console, most: int) -> None:
        """Print the surest bits as they sit on the panel, of up to ``most`` panels of a frame."""
        if self.best is None:
            return
        off, on = ".#" if console.options.ascii_only else "·●"
        grid = ["  " + " ".join(row) for row in np.where(self.best.bits, on, off)]
        judged = (
            f"{self.best.judged}; panel found in {self.shown} of {self.frames} frames"
        )
        judged += f", {self.found} readings" * (self.found > self.shown)
        if self.most > most:
            judged += f"; a frame shows {self.most}: decode.most={self.most} reads them"
        notes = [f"{source}: {note}" for note, source in self.notes.items()]
        say(console, *grid, f"  {on} On, {off} Off", self.best.text, judged, *notes)

    def hint(self, config: DecodeConfig, is_trained: bool, receiver: Receiver) -> str:
        """Say what may be tried where nothing was found, by a receiver that was trained here or before."""
        enough, by_chance = 0.0, self.least_alarms * self.frames
        if by_chance < BY_CHANCE and is_adjustable(receiver.locator):
            step = 10.0 ** (math.floor(math.log10(self.least_alarms)) - 1)
            enough = math.ceil(self.least_alarms / step) * step
        (hint,) = self._said(
            "hint",
            receiver=receiver,
            config=config,
            is_trained=is_trained,
            stated=not math.isnan(self.least_alarms),
            enough=enough,
        )
        return hint

    def doubts(self) -> list[str]:
        """Say what makes the bits doubtful."""
        return self._said("doubts") if self.doubtful or self.alike else []

    def _said(self, template: str, **values: object) -> list[str]:
        """Fill in a template of this package."""
        from vocc_torch.report import page  # rarely needed, and slow to import

        values |= {"summary": self}
        return page.render(__package__, f"{template}.txt.j2", **values).splitlines()
