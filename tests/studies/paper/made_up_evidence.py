"""Made-up experiments with known rates."""

import numpy as np
from made_up_tallies import errors_of, tallies

from vocc_torch.measure.curve import Curves, Point
from vocc_torch.measure.estimate import Estimate
from vocc_torch.studies.paper.rules import Evidence

BITS = 64
AXES = {
    "ambient": "ambient_lx",
    "luminance": "led_luminance_cd_m2",
    "distance": "distance_m",
}


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


def curves_of(experiment, wrong):
    """Curves from each receiver's wrong bits a frame, ``{value: {receiver: (N,)}}``."""
    receivers, points, errors = tuple(next(iter(wrong.values()))), [], {}
    axis = AXES.get(experiment, experiment)
    for value, at in wrong.items():
        halves = 2 * np.array([at[name] for name in receivers], dtype=np.int64)
        errors[value] = [errors_of(halves, BITS)]
        points += [
            Point(experiment, axis, value, name, "paper", one, "frames")
            for name, one in zip(receivers, errors[value][0].counts, strict=True)
        ]
    return Curves(points, errors)


def of_rates(experiment="ambient", frames=2000, numbers=None, **rates):
    """Evidence of one experiment from rates by receiver, ``{value: ber}`` each."""
    values = next(iter(rates.values()))
    wrong = {
        value: {name: spread(at[value], frames) for name, at in rates.items()}
        for value in values
    }
    named = {
        name: one if isinstance(one, Estimate) else Estimate(one, one, one)
        for name, one in (numbers or {}).items()
    }
    return Evidence({experiment: curves_of(experiment, wrong)}, named)
