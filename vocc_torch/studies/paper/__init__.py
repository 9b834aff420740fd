"""``task=figures``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass, field

from vocc_torch.measure.config import Experiment, demand_word


@dataclass
class FiguresConfig:
    """What ``task=figures`` makes: see :class:`vocc_torch.measure.sweep.Campaign`.

    Args:
        names: some of the figures, such as fig22; all by default.
        focal_lengths_mm: lenses for which the error rates are measured.
        locators: what finds the panel.
        experiments: the error rates that are measured, by name.
    """

    names: list[str] = field(default_factory=list)
    focal_lengths_mm: list[float] = field(default_factory=list)
    locators: list[str] = field(default_factory=list)
    experiments: dict[str, Experiment] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the experiments' names, which ledgers take."""
        for name in self.experiments:
            demand_word("figures.experiments", name)
