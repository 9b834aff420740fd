"""What the paper's locator takes for a panel, as plain values; this module needs no torch."""

from dataclasses import dataclass

from vocc_torch.errors import VoccError, demand_ranges, demand_word, within

MOST_CLOSING_PX = (1 << 16) - 1
QUADRILATERALS = ("min_area", "upright")


@dataclass(frozen=True, slots=True)
class LocatorLimits:
    """The limits of the paper's locator, which are the keys of ``receiver.location``.

    Args:
        closing_px: side of the closing square, px, odd, 1 to 65535. Choose 1.5 times the LED pitch; panels
            with a larger pitch are closed at half, quarter, ... resolution.
        min_area_px: smallest area of a closed blob, px^2, at least 1.
        min_rectangularity: smallest share of its rectangle that a blob fills, 0 to 1.
        min_compactness: smallest compactness of a blob, 0 to 1. Discs have 0.785 to 0.805, square panels of
            random bits above 0.82.
        quadrilateral: ``min_area`` (rectangle of least area) or ``upright`` (bounding box).

    Raises:
        VoccError: a value outside its range.
    """

    closing_px: int = 11
    min_area_px: int = within(1, 1 << 40, default=100, whole=True)
    min_rectangularity: float = within(0, 1, default=0.5)
    min_compactness: float = within(0, 1, default=0.81)
    quadrilateral: str = "min_area"

    def __post_init__(self) -> None:
        """Check every range."""
        side = self.closing_px
        if type(side) is not int or not 1 <= side <= MOST_CLOSING_PX or side % 2 == 0:
            raise VoccError.of(
                "location.closing_px",
                side,
                f"odd, at least 1 and at most {MOST_CLOSING_PX}",
            )
        demand_ranges("location", self)
        demand_word("location.quadrilateral", self.quadrilateral, QUADRILATERALS)
