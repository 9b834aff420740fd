"""Claims of sections II-C, III-B and IV-B on greys and features: of curves, and of the paper's figures."""

from __future__ import annotations

from vocc_torch.studies.paper.scorecard.claim import Claim
from vocc_torch.studies.paper.scorecard.explanations import one_rule_for_all, own_preamble
from vocc_torch.studies.paper.scorecard.figures import between, figure_number, more_than, parted_by_a_line
from vocc_torch.studies.paper.scorecard.orders import above

EXPERIMENTS = ("contrast", "ambient", "luminance", "distance")
RARE = 0.1
"""Exceptions up to this share are let pass where the paper says what LEDs tend to."""
CHANCE = 0.1
"""An area under the ROC curve within this of a half is taken as a complete overlap."""

_ALONE = tuple(
    Claim(
        f"features.{feature}_alone.{baseline}",
        "III-B; abstract; V",
        f"{feature.upper()} alone has fewer errors than {baseline}, at every point of all four experiments: "
        "stronger than Figs 8 and 10 show, for this greyscale has a threshold of each scene's own",
        "substantially more discriminability than greyscale",
        above(EXPERIMENTS, [(baseline, f"flda_{feature}")]),
        explanations=(own_preamble, one_rule_for_all),
    )
    for feature in ("agr", "gri")
    for baseline in ("average_greyscale", "center_greyscale")
)

FEATURES_BY_CURVES = (
    *_ALONE,
    Claim(
        "features.agr_and_gri",
        "III-B-2, Fig. 10b",
        "AGR and GRI together have fewer errors than either alone, at every point",
        "remarkable only when combined",
        above(EXPERIMENTS, [("flda_agr", "flda_2"), ("flda_gri", "flda_2")]),
    ),
    Claim(
        "features.ngr_alone",
        "III-B-3, Fig. 12a",
        "NGR alone has more errors than AGR alone and than GRI alone, at every point",
        "a bad feature alone",
        above(EXPERIMENTS, [("flda_ngr", "flda_agr"), ("flda_ngr", "flda_gri")]),
    ),
    Claim(
        "features.ngr_helps_agr",
        "III-B-3, Fig. 12b",
        "NGR lowers the rate of AGR, at every point",
        "better separation",
        above(EXPERIMENTS, [("flda_agr", "flda_agr_ngr")]),
    ),
    Claim(
        "features.three_best",
        "III-B-3, Fig. 12d; V",
        "all three features have fewer errors than any smaller set, at every point",
        "highest discriminability",
        above(EXPERIMENTS, [(f"flda_{fewer}", "flda_3") for fewer in ("agr", "gri", "ngr", "2", "agr_ngr")]),
    ),
)

_GREYS = (
    Claim(
        "figures.grey_overlap",
        "II-C-1, Fig. 4",
        "On LEDs of one frame are darker than Off LEDs of another",
        "On lower than Off of another frame",
        more_than("fig04", "bright_frame_lowest_off_grey", ("dark_frame_highest_on_grey",)),
        "figures",
    ),
    Claim(
        "figures.misread_off",
        "II-C-2, Fig. 6",
        "blooming makes an Off LED read On",
        "easily miss-detected as On",
        more_than("fig05_06", "grey_with_blooming", ("threshold", "grey_without_blooming")),
        "figures",
    ),
    Claim(
        "figures.dull_after_gamma",
        "IV-B-1, Fig. 17",
        "a panel blurred after gamma encoding is duller than one blurred before",
        "duller",
        figure_number(
            "fig17",
            "mean_loss",
            lambda loss: loss > 0,
            "{mean_loss:.1f} grey values darker on average",
            "not darker",
        ),
        "figures",
    ),
    Claim(
        "figures.otsu",
        "IV-B-2, Fig. 19",
        "Otsu's threshold parts the background from the panel",
        "threshold between the two",
        between("fig19", "background_grey", "threshold", "on_grey"),
        "figures",
    ),
)

_SAMPLE = (
    Claim(
        "figures.agr_over_grey",
        "III-B-1, Fig. 8",
        "with one threshold for all frames AGR parts better than the average grey (area under ROC)",
        "much higher discriminability",
        more_than("fig08", "auc_agr", ("auc_average_grey",)),
        "figures",
    ),
    Claim(
        "figures.gri_over_grey",
        "III-B-2, Figs 8 and 10; abstract; V",
        "with one threshold for all frames GRI parts better than the average grey (area under ROC)",
        "substantially more discriminability than greyscale",
        more_than("fig10", "auc_gri", ("auc_average_grey",), of_figure="fig08"),
        "figures",
    ),
    Claim(
        "figures.gri_inward",
        "III-B-2, Fig. 9",
        "GRI is positive in On LEDs (in 9 of 10 at least)",
        "GRI = 0.6 (no unit given)",
        figure_number(
            "fig09",
            "gri_negative_share_on",
            lambda share: share <= RARE,
            "negative in {gri_negative_share_on:.0%} of On LEDs; {gri_on:.1f} grey values a pixel in a "
            "middle one",
            "too many are negative",
        ),
        "figures",
    ),
    Claim(
        "figures.gri_outward",
        "III-B-2, Fig. 9",
        "GRI is negative in Off LEDs (in 9 of 10 at least)",
        "GRI = -0.2 (no unit given)",
        figure_number(
            "fig09",
            "gri_negative_share_off",
            lambda share: share >= 1 - RARE,
            "negative in {gri_negative_share_off:.0%} of Off LEDs "
            "({gri_negative_share_off_nearer_half:.0%} of those in the nearer half of the frames, "
            "{gri_negative_share_off_farther_half:.0%} in the farther); {gri_off:.1f} grey values "
            "a pixel in a middle one",
            "too many are positive: where an LED is many pixels wide, an Off LED's own reflection stands out "
            "against the darker board",
        ),
        "figures",
    ),
    Claim(
        "figures.gri_alone",
        "III-B-2, Fig. 10a",
        "one threshold on GRI alone tells most LEDs right",
        "most can be distinguished",
        figure_number(
            "fig10",
            "wrong_share_gri",
            lambda share: share < 0.5,
            "{wrong_share_gri:.2%} are wrong at the best threshold",
            "most are wrong",
        ),
        "figures",
    ),
    Claim(
        "figures.agr_and_gri",
        "III-B-2, Fig. 10b",
        "AGR and GRI together tell every LED of the sample right",
        "all distinguished",
        parted_by_a_line("fig10", "agr+gri"),
        "figures",
    ),
    Claim(
        "figures.ngr_alone",
        "III-B-3, Fig. 12a",
        "NGR alone tells nothing: On and Off overlap completely (area under ROC 0.4 to 0.6)",
        "completely overlap",
        figure_number(
            "fig12",
            "auc_ngr",
            lambda area: abs(area - 0.5) <= CHANCE,
            "area under ROC {auc_ngr:.3f}",
            "the area is farther from a half",
        ),
        "figures",
    ),
    Claim(
        "figures.ngr_helps_agr",
        "III-B-3, Fig. 12b",
        "AGR and NGR part better than AGR (area under ROC)",
        "better separation",
        more_than("fig12", "auc_agr+ngr", ("auc_agr",)),
        "figures",
    ),
    Claim(
        "figures.ngr_helps_gri",
        "III-B-3, Fig. 12c",
        "GRI and NGR part better than GRI (area under ROC)",
        "also better",
        more_than("fig12", "auc_gri+ngr", ("auc_gri",)),
        "figures",
    ),
    Claim(
        "figures.three_best",
        "III-B-3, Fig. 12d",
        "all three features part best (area under ROC)",
        "highest discriminability",
        more_than("fig12", "auc_agr+gri+ngr", ("auc_agr+gri", "auc_agr+ngr", "auc_gri+ngr")),
        "figures",
    ),
)

FEATURES_BY_FIGURES = _GREYS + _SAMPLE
