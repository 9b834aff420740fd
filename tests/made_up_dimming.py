"""A made-up grid of bit error rates whose best luminance is known in closed form."""

import numpy as np

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Curves, Point
from vocc_torch.measure.grid import Grid

AMBIENT = tuple(1000.0 * 2**i for i in range(6))
LUMINANCE = tuple(250.0 * 2**i for i in range(7))
BITS = 64


def true_ber(ambient, luminance, least=4e-4, ratio=0.5, bloom=1.1, dark=1.4):
    """Blooming grows and contrast falls with luminance over ambient light; ``least`` is reached at ``ratio``.

    The derivative by log(luminance) is 0 where both terms' rates of change agree, at ``ratio`` exactly.
    """
    x = np.asarray(luminance)[None, :] / np.asarray(ambient)[:, None] / ratio
    shares = dark / (bloom + dark), bloom / (bloom + dark)
    return np.minimum(0.4, least * (shares[0] * x**bloom + shares[1] * x**-dark))


def counted(rng, ber, frames, correlation=0.03):
    """Counts of frames whose bits share an error probability: beta-binomial errors a frame."""
    if ber == 0:
        return Counts(frames, BITS * frames)
    scale = (1 - correlation) / correlation
    wrong = rng.binomial(BITS, rng.beta(ber * scale, (1 - ber) * scale, frames))
    halves = 2 * wrong.astype(np.int64)
    sums = (halves.sum(), (halves**2).sum(), (halves > 0).sum())
    return Counts(frames, BITS * frames, *(int(value) for value in sums))


def grid_of(cells, ambient=AMBIENT, luminance=LUMINANCE):
    """A grid from rows of counts by receiver."""
    rows = []
    for i in range(len(ambient)):
        place = "dimming", "led_luminance_cd_m2"
        points = [
            Point(*place, value, receiver, "truth", table[i][j], "frames")
            for j, value in enumerate(luminance)
            for receiver, table in cells.items()
        ]
        rows.append(Curves(points))
    return Grid("ambient_lx", ambient, tuple(rows))


def made_up_grid(truths, seed=0, frames=2000, correlation=0.03, **axes):
    """A grid with counts drawn from each receiver's true rates, (rows, columns)."""
    rng = np.random.default_rng(seed)
    cells = {
        receiver: [
            [counted(rng, ber, frames, correlation) for ber in row] for row in truth
        ]
        for receiver, truth in truths.items()
    }
    return grid_of(cells, **axes)


def sure_grid(truth, ambient=AMBIENT, luminance=LUMINANCE):
    """A grid with so many frames that its rates are the true ones."""
    frames = 10**9
    wrong = np.rint(truth * BITS * frames).astype(np.int64)
    return grid_of(
        {"a": [[spread(int(w), frames) for w in row] for row in wrong]},
        ambient,
        luminance,
    )


def spread(wrong, frames):
    """Wrong bits as evenly over the frames as can be."""
    each, more = divmod(wrong, frames)
    squared = 4 * (more * (each + 1) ** 2 + (frames - more) * each**2)
    return Counts(frames, BITS * frames, 2 * wrong, squared, frames if each else more)


PAPER_LIKE = {
    "center_greyscale": {"least": 4e-3, "ratio": 0.40, "bloom": 1.2, "dark": 1.5},
    "average_greyscale": {"least": 2.2e-3, "ratio": 0.45, "bloom": 1.1, "dark": 1.5},
    "flda_agr": {"least": 1.5e-3, "ratio": 0.5, "bloom": 1.0, "dark": 1.6},
    "flda_gri": {"least": 1.2e-3, "ratio": 0.55, "bloom": 1.0, "dark": 1.6},
    "flda_ngr": {"least": 9e-2, "ratio": 0.4, "bloom": 0.3, "dark": 0.4},
    "flda_agr_ngr": {"least": 1.0e-3, "ratio": 0.5, "bloom": 1.0, "dark": 1.6},
    "flda_2": {"least": 5e-4, "ratio": 0.6, "bloom": 1.1, "dark": 1.8},
    "flda_3": {"least": 3e-5, "ratio": 0.7, "bloom": 2.6, "dark": 2.6},
}
"""Receivers from bad to so good that the plateau about the best has no errors."""


def paper_like_grid(
    receivers=("center_greyscale", "average_greyscale", "flda_2", "flda_3"), **options
):
    """A grid that looks like the simulator's."""
    ambient, luminance = (
        options.get("ambient", AMBIENT),
        options.get("luminance", LUMINANCE),
    )
    truths = {
        name: true_ber(ambient, luminance, **PAPER_LIKE[name]) for name in receivers
    }
    return made_up_grid(truths, **options)
