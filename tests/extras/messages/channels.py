"""A film as a camera that is not synchronised sees it, as soft values with normal noise."""

import numpy as np
from scipy.stats import norm

EXPOSURE, READOUT = 0.07, 0.03
"""Of a symbol."""


def seen(film, ratio, draws, *, ber=0.02, drift=0.0, begin=None, end=None, faults=None):
    """Log-likelihood ratios (F,R,C) of frames, the moment of each in symbols, and the camera's own times.

    Rows are exposed one after the other, each from its begin for EXPOSURE; two symbols add up by their share.
    """
    times = (draws.random() if begin is None else begin) + np.arange(
        int(len(film) * ratio)
    ) * (1 + drift) / ratio
    times = times[times < (len(film) if end is None else end) - EXPOSURE - READOUT]
    if faults is not None:
        times = faults(times, draws)
    rows = np.arange(film.shape[1])
    begins = np.nan_to_num(times)[:, None] + rows / film.shape[1] * READOUT
    first, last = np.floor(begins).astype(int), np.floor(begins + EXPOSURE).astype(int)
    share = np.where(last > first, (last - begins) / EXPOSURE, 1.0)[..., None]
    sent = 2.0 * film - 1
    light = sent[first, rows] * share + sent[last, rows] * (1 - share)
    sigma = 1 / norm.isf(ber)
    llr = 2 * (light + sigma * draws.standard_normal(light.shape)) / sigma**2
    llr[np.isnan(times)] = 0
    return llr.astype(np.float32), times, np.arange(len(times)) / ratio


def parts(llr, stamps, batch=64):
    """Soft values and times of frames, some at a time."""
    for at in range(0, len(llr), batch):
        yield llr[at : at + batch], list(stamps[at : at + batch])
