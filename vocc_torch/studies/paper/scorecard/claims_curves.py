"""Claims of sections IV-D-1 to IV-D-4: error rates against contrast, ambient light, luminance, distance."""

from __future__ import annotations

from vocc_torch.studies.paper.scorecard.claim import Claim
from vocc_torch.studies.paper.scorecard.contrasts import contrast_example, contrast_range, interference_grows
from vocc_torch.studies.paper.scorecard.explanations import of_location, one_rule_for_all, own_preamble
from vocc_torch.studies.paper.scorecard.orders import above, chain, harder, lowest_at, monotone, valley
from vocc_torch.studies.paper.scorecard.quoted import QUOTED_BERS, QUOTED_GAINS, ber_is, gain_is
from vocc_torch.studies.paper.scorecard.words import percent, place, rate

NAMES = {
    "center_greyscale": "the adaptive centre greyscale",
    "average_greyscale": "the adaptive average greyscale",
    "flda_2": "two features (AGR, GRI)",
    "flda_3": "three features (AGR, GRI, NGR)",
}
"""The receivers of Figs 21 to 24, the one with the most errors first."""
GREYSCALE = ("center_greyscale", "average_greyscale")
PROPOSED = ("flda_2", "flda_3")
AXES = {
    "contrast": "contrast",
    "ambient": "ambient_lx",
    "luminance": "led_luminance_cd_m2",
    "distance": "distance_m",
}
PLACES = {
    "contrast": "IV-D-1, Fig. 21",
    "ambient": "IV-D-2, Fig. 22",
    "luminance": "IV-D-3, Fig. 23",
    "distance": "IV-D-4, Fig. 24",
}
LEVELS = {
    "contrast": "at all contrast levels",
    "ambient": "at all levels of ambient light",
    "luminance": "at all levels of LED luminance",
    "distance": "at all distances",
}


def orders(experiment: str) -> tuple[Claim, ...]:
    """Claims on which receiver is better, the same in each experiment."""
    where, levels = PLACES[experiment], LEVELS[experiment]
    superior = tuple(
        Claim(
            f"{experiment}.superior.{baseline}",
            where,
            f"two and three features are below {NAMES[baseline]} {levels}",
            f"superior {levels}" if experiment == "contrast" else f"much lower {levels}",
            above([experiment], [(baseline, proposed) for proposed in PROPOSED], factors=True),
            explanations=(own_preamble, one_rule_for_all),
        )
        for baseline in GREYSCALE
    )
    return (
        *superior,
        Claim(
            f"{experiment}.ngr_improves",
            where,
            f"NGR lowers the rate of AGR and GRI {levels}",
            "three features better than two",
            above([experiment], [PROPOSED]),
        ),
        Claim(
            f"{experiment}.order",
            where,
            f"the order is centre (worst), average, two, three features {levels}",
            "the order of the curves",
            chain(experiment, tuple(NAMES)),
            explanations=(own_preamble, one_rule_for_all),
        ),
    )


def numbers(experiment: str) -> tuple[Claim, ...]:
    """Claims with a quoted rate or gain."""
    where, axis = PLACES[experiment], AXES[experiment]
    rates = tuple(
        Claim(
            f"{experiment}.ber.{quoted.receiver}",
            where,
            f"the rate of {NAMES[quoted.receiver]} at {_at(axis, quoted.value)}",
            rate(quoted.ber),
            ber_is(quoted),
            explanations=(of_location(experiment, quoted.receiver, quoted.value, quoted.ber),),
        )
        for quoted in QUOTED_BERS
        if quoted.experiment == experiment
    )
    gains = tuple(
        Claim(
            f"{experiment}.gain" + (".average" if quoted.value is None else ""),
            where if quoted.value is not None else f"{where}; IV-D-5",
            f"NGR saves this share of the errors {_where_gained(axis, quoted.value)}",
            percent(quoted.gain),
            gain_is(quoted),
            explanations=() if quoted.value is None else (of_location(experiment, "flda_3", quoted.value),),
        )
        for quoted in QUOTED_GAINS
        if quoted.experiment == experiment
    )
    return rates + gains


def _where_gained(axis: str, value: float | None) -> str:
    """Write where a gain is claimed."""
    return "on average" if value is None else f"at {_at(axis, value)}"


def _at(axis: str, value: float) -> str:
    """Write a value as the paper does."""
    return "30 to 36 % contrast" if axis == "contrast" else place(axis, value)


def lowests(experiment: str, values: dict[str, float], quoted: str) -> tuple[Claim, ...]:
    """Claims on where each curve is lowest."""
    return tuple(
        Claim(
            f"{experiment}.lowest.{receiver}",
            PLACES[experiment],
            f"the rate of {NAMES[receiver]} is lowest at {place(AXES[experiment], value)}",
            quoted.format(f"{value:g}"),
            lowest_at(experiment, receiver, value),
        )
        for receiver, value in values.items()
    )


def valleys(experiment: str, text: str) -> tuple[Claim, ...]:
    """Claims that each curve falls and rises again."""
    return tuple(
        Claim(
            f"{experiment}.valley.{receiver}",
            f"{PLACES[experiment]}; IV-D-5",
            f"the rate of {NAMES[receiver]} falls and rises again",
            text,
            valley(experiment, receiver),
        )
        for receiver in NAMES
    )


def slopes(experiment: str, first: float, last: float, text: str, *, rising: bool) -> tuple[Claim, ...]:
    """Claims that each curve rises, or falls, from one value to another."""
    axis, verb = AXES[experiment], "rises" if rising else "falls"
    return tuple(
        Claim(
            f"{experiment}.{verb}.{receiver}",
            PLACES[experiment],
            f"the rate of {NAMES[receiver]} {verb} from {place(axis, first)} to {place(axis, last)}",
            text,
            monotone(experiment, receiver, first, last, rising=rising),
        )
        for receiver in NAMES
    )


_FIG20 = tuple(
    Claim(
        f"contrast.example.{stated}",
        "IV-D-1, Fig. 20",
        f"{ambient:g} lx with {luminance:g} cd/m2 give a contrast of {stated} %",
        f"{stated} %",
        contrast_example(stated, ambient, luminance),
        "figures",
    )
    for stated, ambient, luminance in ((6, 32000.0, 500.0), (30, 4000.0, 3500.0), (50, 1000.0, 4000.0))
)

CONTRAST = (
    *_FIG20,
    Claim(
        "contrast.interference",
        "IV-D-1, Fig. 20",
        "blooming interference, in points of contrast lost, grows with the contrast",
        "increase in interference",
        interference_grows,
        "figures",
    ),
    Claim(
        "contrast.low_is_hard",
        "IV-D-1, Fig. 20",
        "at the lowest contrast every receiver has more errors than at a middle one (30 to 36 %)",
        "all have difficulties",
        harder("contrast", tuple(NAMES), 0.33),
    ),
    Claim(
        "contrast.range.low",
        "IV-D-1",
        "the contrast of the 20000 frames begins at 6 %",
        "6 %",
        contrast_range(0.06, lower=True),
        "figures",
    ),
    Claim(
        "contrast.range.high",
        "IV-D-1",
        "the contrast of the 20000 frames ends at 54 %",
        "54 %",
        contrast_range(0.54, lower=False),
        "figures",
    ),
    *valleys("contrast", "non-monotonic"),
    *orders("contrast"),
    *numbers("contrast"),
)

AMBIENT = (
    *lowests("ambient", dict.fromkeys(GREYSCALE, 4000.0), "approximately {} lx"),
    *lowests("ambient", dict.fromkeys(PROPOSED, 8000.0), "{} lx"),
    *valleys("ambient", "optimal ambient light"),
    *orders("ambient"),
    *numbers("ambient"),
)

LUMINANCE = (
    *lowests("luminance", dict.fromkeys(NAMES, 4000.0), "{} cd/m2"),
    *slopes("luminance", 500.0, 4000.0, "decrease to 4000 cd/m2", rising=False),
    *slopes("luminance", 4000.0, 8000.0, "increase beyond 4000 cd/m2", rising=True),
    *orders("luminance"),
    *numbers("luminance"),
)

DISTANCE = (
    *slopes("distance", 30.0, 70.0, "increase with distance", rising=True),
    *orders("distance"),
    *numbers("distance"),
)
