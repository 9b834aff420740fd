"""Made-up experiments with known rates."""

import made_up_tallies
import numpy as np

from vocc_torch.measure.estimate import Estimate
from vocc_torch.studies.paper.rules import Evidence

BITS = 64
AXES = {
    "ambient": "ambient_lx",
    "luminance": "led_luminance_cd_m2",
    "distance": "distance_m",
}


def clustered(rng, ber, frames, correlation=0.05):
    """Wrong bits of frames that are hard or easy (beta-binomial)."""
    scale = (1 - correlation) / correlation
    return rng.binomial(BITS, rng.beta(ber * scale, (1 - ber) * scale, frames))


def counted(wrong):
    """Counts of receivers and their comparisons from wrong bits (L,N)."""
    halves = 2 * np.asarray(wrong, dtype=np.int64)
    return made_up_tallies.tallies(halves, BITS, np.ones(halves.shape, dtype=bool))


def curves_of(experiment, wrong):
    """Curves from each receiver's wrong bits a frame, ``{value: {receiver: (N,)}}``."""
    axis = AXES.get(experiment, experiment)
    return made_up_tallies.curves_of(wrong, experiment, axis)


def of_rates(experiment="ambient", frames=2000, numbers=None, **rates):
    """Evidence of one experiment from rates by receiver, ``{value: ber}`` each."""
    values = next(iter(rates.values()))
    wrong = {
        value: {
            name: made_up_tallies.spread(round(at[value] * BITS * frames), frames)
            for name, at in rates.items()
        }
        for value in values
    }
    named = {
        name: one if isinstance(one, Estimate) else Estimate(one, one, one)
        for name, one in (numbers or {}).items()
    }
    return Evidence({experiment: curves_of(experiment, wrong)}, named)
