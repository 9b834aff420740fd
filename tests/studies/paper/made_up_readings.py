"""Made-up experiments with known truth, and one set that behaves as the paper says throughout."""

import numpy as np
from made_up_tallies import tallies

from vocc_torch.measure.curve import Curves, Measured
from vocc_torch.measure.grid import Grid
from vocc_torch.studies.paper.judgement import PaperReading
from vocc_torch.studies.paper.scorecard import Claim, readings_of, score

BITS = 64
AXES = {"ambient": "ambient_lx", "luminance": "led_luminance_cd_m2", "distance": "distance_m"}


def spread(ber, frames):
    """Wrong bits of each frame, the most first, as even as can be: the lower of two rates never has more."""
    total = round(ber * BITS * frames)
    return np.full(frames, total // frames) + (np.arange(frames) < total % frames)


def clustered(rng, ber, frames, correlation=0.05):
    """Wrong bits of frames that are hard or easy (beta-binomial)."""
    scale = (1 - correlation) / correlation
    return rng.binomial(BITS, rng.beta(ber * scale, (1 - ber) * scale, frames))


def counted(wrong):
    """Counts of receivers and their comparisons from wrong bits (L,N)."""
    halves = 2 * np.asarray(wrong, dtype=np.int64)
    return tallies(halves, BITS, np.ones(halves.shape, dtype=bool))


def curves_of(experiment, wrong, locator="truth"):
    """Curves from each receiver's wrong bits a frame, ``{value: {receiver: (N,)}}``."""
    receivers, counts, paired = tuple(next(iter(wrong.values()))), {}, {}
    for value, at in wrong.items():
        found, pairs = counted([at[name] for name in receivers])
        counts |= {(name, value): one for name, one in zip(receivers, found, strict=True)}
        paired |= {(receivers[i], receivers[j], value): one for (i, j), one in pairs.items()}
    stopped = dict.fromkeys(wrong, "frames")
    axis = AXES.get(experiment, experiment)
    return Curves(experiment, axis, locator, receivers, tuple(wrong), counts, paired, stopped)


def measured_of(experiment, truth, located=None):
    """An experiment with true corners, and with located panels on the same frames."""
    located = truth if located is None else located
    location = {
        (name, value): counted([located[value][name], truth[value][name]])[1][0, 1]
        for value in truth
        for name in truth[value]
    }
    curves = {
        "truth": curves_of(experiment, truth, "truth"),
        "paper": curves_of(experiment, located, "paper"),
    }
    return Measured(curves, location)


def of_rates(experiment, rates, frames=2000):
    """The same from rates, ``{receiver: {value: ber}}``, for both locators."""
    values = next(iter(rates.values()))
    wrong = {value: {name: spread(at[value], frames) for name, at in rates.items()} for value in values}
    return measured_of(experiment, wrong)


def reading_of(measured, locator="truth", findings=None, focal_length_mm=25.0):
    """A reading of experiments by name."""
    return PaperReading(focal_length_mm, locator, measured, findings or {})


def judged(reading, rule, **arguments):
    """A claim on curves judged by a rule."""
    return Claim("made.up", "IV", "text", "paper", rule, arguments, "curves").judge(reading)


# The paper's behaviour. Two features by experiment; the rest follows by factors.


def at(values, rates):
    """Rates by value of the axis, from words."""
    return dict(zip(map(float, values.split()), map(float, rates.split()), strict=True))


TWO = {
    "contrast": at(".09 .15 .21 .27 .33 .39 .45 .51", "5e-3 2.5e-3 1.2e-3 7e-4 5.3e-4 8e-4 1.4e-3 2.4e-3"),
    "ambient": at("1e3 2e3 4e3 8e3 16e3 32e3", "3e-3 1.6e-3 9e-4 6.6e-4 1.1e-3 2.2e-3"),
    "luminance": at(
        "500 1e3 2e3 3e3 4e3 5e3 6e3 7e3 8e3", "6e-3 3.5e-3 1.8e-3 1.1e-3 7e-4 9e-4 1.3e-3 1.8e-3 2.4e-3"
    ),
    "distance": at("30 40 50 60 70", "4e-4 9e-4 2e-3 5e-3 1.2e-2"),
}
GAINS = {("contrast", 0.33): 1.4 / 5.3, ("ambient", 8e3): 1.6 / 6.6, ("luminance", 8e3): 0.18}
GAINS |= {("distance", 30.0): 0.3}
OTHER_CONTRAST_GAIN = (8 * 0.11 - 1.4 / 5.3) / 7
FACTORS = {"center_greyscale": 6.0, "average_greyscale": 4.0, "flda_agr": 2.4, "flda_gri": 2.8}
GREYSCALE_AMBIENT = {1e3: 1.4, 2e3: 1.2, 4e3: 1.0, 8e3: 1.7, 16e3: 1.4, 32e3: 1.2}
"""Moves the greyscale receivers' lowest rate from 8000 to 4000 lx."""


def paper_rates(experiment):
    """Every receiver's rates as the paper has them, or could have them."""
    two = TWO[experiment]
    other = OTHER_CONTRAST_GAIN if experiment == "contrast" else 0.1
    rates = {}
    for name, factor in FACTORS.items():
        moved = GREYSCALE_AMBIENT if experiment == "ambient" and name.endswith("greyscale") else {}
        rates[name] = {value: factor * moved.get(value, 1.0) * ber for value, ber in two.items()}
    rates["flda_ngr"] = dict.fromkeys(two, 0.45)
    rates["flda_2"] = two
    rates["flda_agr_ngr"] = {value: 2 * ber for value, ber in two.items()}
    rates["flda_3"] = {value: (1 - GAINS.get((experiment, value), other)) * ber for value, ber in two.items()}
    return rates


def timed(name, median, low=None, high=None):
    """A time, or a ratio of times, of Fig. 25 with its quartiles, 5 % around it unless told."""
    at = f"{name}_whole_frames_batch_1"
    low, high = 0.95 * median if low is None else low, 1.05 * median if high is None else high
    return {at: median, f"{at}_low": low, f"{at}_high": high}


FINDINGS = {
    "fig04": {"bright_frame_lowest_off_grey": 130.0, "dark_frame_highest_on_grey": 107.0},
    "fig05_06": {"grey_with_blooming": 179.0, "threshold": 169.0, "grey_without_blooming": 115.0},
    "fig08": {"auc_average_grey": 0.8, "auc_agr": 0.99},
    "fig09": {
        **{"gri_on": 22.0, "gri_off": -7.0, "gri_negative_share_on": 0.0, "gri_negative_share_off": 0.95},
        **{"gri_negative_share_off_nearer_half": 0.92, "gri_negative_share_off_farther_half": 0.98},
    },
    "fig10": {
        **{"auc_gri": 0.98, "wrong_share_gri": 0.08},
        **{"wrong_share_agr+gri": 0.001, "separable_agr+gri": 1.0},
    },
    "fig12": {
        **{"auc_agr": 0.99, "auc_gri": 0.98, "auc_ngr": 0.53, "auc_agr+gri": 0.996},
        **{"auc_agr+ngr": 0.995, "auc_gri+ngr": 0.985, "auc_agr+gri+ngr": 0.999},
    },
    "fig17": {"mean_loss": 15.0},
    "fig19": {"background_grey": 102.0, "threshold": 138.0, "on_grey": 255.0},
    "fig20": {
        **{f"contrast_paper_scene_{stated}": stated / 100 for stated in (6, 30, 50)},
        **{f"background_grey_paper_scene_{stated}": 102.0 for stated in (6, 30, 50)},
        **{f"contrast_true_{stated}": stated / 100 for stated in (6, 30, 50)},
        **{f"contrast_in_picture_true_{stated}": stated / 200 for stated in (6, 30, 50)},
    },
    "fig25": {
        **timed("share_center_greyscale", 0.05),
        **timed("share_average_greyscale", 0.07),
        **timed("share_flda_2", 0.12),
        **timed("share_flda_3", 0.14),
        "share_flda_3_crops_batch_1": 5.0,
        **timed("extra_cost_of_ngr", 0.17),
        **timed("extra_total_cost_of_ngr", 0.0178),
        **timed("ms_panel_detection", 10.0),
        **timed("ms_center_greyscale", 0.5),
        **timed("ms_average_greyscale", 0.7),
        **timed("ms_flda_2", 1.2),
        **timed("ms_flda_3", 1.4),
    },
}


def paper_experiments(frames=20_000):
    """The four experiments as the paper has them."""
    return {name: of_rates(name, paper_rates(name), frames) for name in TWO}


def grid_of(best_by_ambient, receivers=("flda_2", "flda_3"), frames=20_000):
    """A map whose best luminance at each ambient light is given."""
    columns = (1e3, 4e3, 16e3)
    rows = tuple(best_by_ambient)
    curves = []
    for row in rows:
        wrong = {
            value: {
                name: spread(1e-3 if value == best_by_ambient[row] else 5e-3, frames) for name in receivers
            }
            for value in columns
        }
        curves.append(curves_of("luminance", wrong))
    return Grid("ambient_lx", rows, tuple(curves))


def located_experiments(factor=3.0, frames=2000):
    """The paper's behaviour with true corners, and ``factor`` times as many errors with the panel located."""
    found = {}
    for name in TWO:
        rates = paper_rates(name)
        truth, located = (
            {
                value: {who: spread(min(0.5, scale * at[value]), frames) for who, at in rates.items()}
                for value in TWO[name]
            }
            for scale in (1.0, factor)
        )
        found[name] = measured_of(name, truth, located)
    return found


def card_of(by_focal_mm, own=(25.0, "paper"), locators=("paper", "truth"), grids=None):
    """The scorecard of made-up experiments."""
    return score(readings_of(by_focal_mm, FINDINGS, locators, grids), own)
