"""What a panel loses that cannot dim: one LED luminance for every ambient light, against the best for each.

    vocc-torch experiment=dimming name=dimming
    python examples/fixed_luminance.py runs/dimming/ber.csv

For each receiver it prints the mean bit error rate over the ambient light, every octave alike, of three
panels: dimmed to the best luminance of the grid under each ambient light, with the single best luminance,
and with the grid's luminance nearest to a headlight's (3000 cd/m2, the middle of Table 1). It also prints the
power of the ambient light that the best luminance follows: 1 is a constant ratio of the two, 0 a constant
luminance. Rates are as measured, with 95 % intervals from those of ``ber.csv``, whose points have frames of
their own; the dimmed panel's, the least of several noisy ones, tends to look too low.
"""

import csv
import sys
from pathlib import Path

import numpy as np

HEADLIGHT_CD_M2 = 3000.0
FEWEST_LEVELS = 3


def read_grid(path):
    """Read ``ber.csv``: ambient lights (N,), luminances (K,), and by receiver and locator (2,N,K).

    These are the rates, and half the widths of their intervals.
    """
    with Path(path).open(newline="") as file:
        rows = list(csv.DictReader(file))
    ambient = sorted({float(row["ambient_lx"]) for row in rows})
    luminance = sorted({float(row["value"]) for row in rows})
    rates = {}
    for row in rows:
        place = ambient.index(float(row["ambient_lx"])), luminance.index(float(row["value"]))
        key = row["receiver"], row["locator"]
        ber, low, high = (float(row[name]) for name in ("ber", "ber_low", "ber_high"))
        found = rates.setdefault(key, np.full((2, len(ambient), len(luminance)), np.nan))
        found[:, *place] = ber, (high - low) / 2
    return np.array(ambient), np.array(luminance), rates


def octave_weights(values):
    """Each value's share of the octaves: half the way to either neighbour, and as far beyond the ends."""
    if len(values) == 1:
        return np.ones(1)
    gaps = np.diff(np.log2(values))
    widths = (np.append(gaps[0], gaps) + np.append(gaps, gaps[-1])) / 2
    return widths / widths.sum()


def panels(ambient, luminance, rate, half):
    """By panel its luminance (None: dimmed), mean rate over the octaves, and half its interval's width."""
    weights, rows = octave_weights(ambient), np.arange(len(ambient))
    fixed = (weights @ rate).argmin()
    headlight = np.abs(np.log(luminance / HEADLIGHT_CD_M2)).argmin()
    for columns in (rate.argmin(axis=1), fixed, headlight):
        mean, spread = weights @ rate[rows, columns], np.sqrt(weights**2 @ half[rows, columns] ** 2)
        yield (luminance[columns] if np.ndim(columns) == 0 else None), mean, spread


def followed_power(ambient, luminance, rate):
    """Slope of log luminance over log ambient light where one value inside the grid is best, if enough."""
    best = rate.argmin(axis=1)
    single = (rate == rate.min(axis=1, keepdims=True)).sum(axis=1) == 1
    inside = single & (best > 0) & (best < len(luminance) - 1)
    if inside.sum() < FEWEST_LEVELS:
        return None
    return np.polyfit(np.log(ambient[inside]), np.log(luminance[best[inside]]), 1)[0]


def main(path):
    """Print a line for each receiver and panel."""
    ambient, luminance, rates = read_grid(path)
    for (receiver, locator), (rate, half) in rates.items():
        (_, dimmed, spread), *others = panels(ambient, luminance, rate, half)
        power = followed_power(ambient, luminance, rate)
        follows = "too few ambient lights" if power is None else f"ambient light to the power {power:.2f}"
        print(f"{receiver}, {locator}: dimmed {dimmed:.2e}; the best luminance follows: {follows}")
        names = "best fixed", f"nearest to a headlight's {HEADLIGHT_CD_M2:g}"
        for name, (cd_m2, mean, own) in zip(names, others, strict=True):
            times = "no errors dimmed"
            if dimmed:
                ratio, apart = mean / dimmed, np.exp(np.hypot(own / mean, spread / dimmed))
                times = f"{ratio:.2f} times the dimmed ({ratio / apart:.2f} to {ratio * apart:.2f} at 95 %)"
            print(f"  {name}, {cd_m2:g} cd/m2: {mean:.2e}, {times}")


if __name__ == "__main__":
    main(*sys.argv[1:])
