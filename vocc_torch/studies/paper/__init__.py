"""``task=figures``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass, field

from vocc_torch.measure.config import Experiment, demand_file_word


@dataclass
class FiguresConfig:
    """What ``task=figures`` makes.

    Args:
        names: figures to make, such as [fig22]; [] makes all.
        readings: sets of assumptions where the paper is open, by name or as a YAML file; the first is
            reported in full.
        experiments: the measured error rates, by name.
    """

    names: list[str] = field(default_factory=list)
    readings: list[str] = field(default_factory=list)
    experiments: dict[str, Experiment] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the experiments' names, which ledgers take."""
        for name in self.experiments:
            demand_file_word("figures.experiments", name)
