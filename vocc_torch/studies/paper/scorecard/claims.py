"""Everything that the paper claims and that is checked here, in the paper's order of sections."""

from __future__ import annotations

from vocc_torch.studies.paper.scorecard.arithmetic import (
    half_of_middle_grey,
    iso_range_suffices,
    net_rate_is,
    quoted_gains_follow,
    transmission_is,
)
from vocc_torch.studies.paper.scorecard.claim import Claim
from vocc_torch.studies.paper.scorecard.claims_curves import AMBIENT, CONTRAST, DISTANCE, LUMINANCE, NAMES
from vocc_torch.studies.paper.scorecard.claims_features import FEATURES_BY_CURVES, FEATURES_BY_FIGURES
from vocc_torch.studies.paper.scorecard.luminances import best_luminance_moves
from vocc_torch.studies.paper.scorecard.times import panel_detection_rules, time_is, times_rise
from vocc_torch.studies.paper.scorecard.words import percent

SETUP = (
    Claim(
        "setup.net_data_rate",
        "IV-C, Table 1",
        "8 x 8 LEDs at 100 frames a second carry 6.4 kbps",
        "6.4 kbps",
        net_rate_is(6.4, 100.0),
        "arithmetic",
    ),
    Claim(
        "setup.transmission",
        "IV-C, Eq. 20",
        "the air lets 0.9932 of the light through 70 m at a visibility of 40 km",
        "0.9932",
        transmission_is(0.9932, 70.0, 40_000.0),
        "arithmetic",
    ),
    Claim(
        "setup.background_grey",
        "IV-C, Eq. 1",
        "grey 86 is half of middle grey (118) before gamma encoding",
        "86 to 118",
        half_of_middle_grey,
        "arithmetic",
    ),
    Claim(
        "setup.gains_follow",
        "IV-D",
        "the quoted gains and times follow from the quoted rates and shares",
        "24 %, 26 %, 17 %, 1.78 %",
        quoted_gains_follow,
        "arithmetic",
    ),
    Claim(
        "setup.iso_range",
        "IV-C, Eqs 1 and 2",
        "ISO 100 to 3200 keeps the background at 86 to 118 from 1000 to 32000 lx",
        "ISO 100 to 3200",
        iso_range_suffices,
        "arithmetic",
    ),
)

_SHARES = {"flda_3": 0.14, "flda_2": 0.12, "average_greyscale": 0.07, "center_greyscale": 0.05}

PROCESSING_TIME = (
    Claim(
        "time.panel_detection",
        "IV-D-5, Fig. 25",
        "panel detection takes much longer than bit detection",
        "much longer",
        panel_detection_rules,
        "figures",
    ),
    *(
        Claim(
            f"time.{receiver}",
            "IV-D-5, Fig. 25",
            f"{receiver} takes this share of panel detection's time",
            percent(share),
            time_is(f"share_{receiver}", share),
            "figures",
        )
        for receiver, share in _SHARES.items()
    ),
    Claim(
        "time.order",
        "IV-D-5, Fig. 25",
        "the centre greyscale takes least time, then the average greyscale, two features, three features",
        "5, 7, 12, 14 %",
        times_rise,
        "figures",
    ),
    Claim(
        "time.ngr",
        "IV-D-5",
        "three features take so much longer than two",
        "17 %",
        time_is("extra_cost_of_ngr", 0.17),
        "figures",
    ),
    Claim(
        "time.ngr_in_total",
        "IV-D-5",
        "three features lengthen all image processing by so much",
        "1.78 %",
        time_is("extra_total_cost_of_ngr", 0.0178, digits=2),
        "figures",
    ),
)


DISCUSSION = tuple(
    Claim(
        f"discussion.dimming.{receiver}",
        "IV-D-5; V",
        f"the best LED luminance of {NAMES[receiver]} differs between levels of ambient light",
        "should be optimized at every level of ambient light",
        best_luminance_moves(receiver),
        "figures",
    )
    for receiver in NAMES
)

CLAIMS: tuple[Claim, ...] = (
    *FEATURES_BY_FIGURES,
    *FEATURES_BY_CURVES,
    *SETUP,
    *CONTRAST,
    *AMBIENT,
    *LUMINANCE,
    *DISTANCE,
    *PROCESSING_TIME,
    *DISCUSSION,
)
"""Every claim, each under a key of its own."""
