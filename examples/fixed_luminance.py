"""What a panel loses that cannot dim: one LED luminance for every ambient light, against the best for each.

    vocc-torch experiment=dimming name=dimming
    python examples/fixed_luminance.py runs/dimming/ber.csv

For each receiver it prints the mean bit error rate over the ambient light, every octave alike, of three
panels: dimmed to the best luminance of the grid under each ambient light, with the single best luminance, and
with the one nearest to a headlight's (3000 cd/m2, the middle of Table 1). It also prints the power of the
ambient light that the best luminance follows: 1 is a constant ratio of the two, 0 a constant luminance.
Rates are as measured; the dimmed panel's, the least of several noisy ones, tends to look too low.
"""

import csv
import sys
from pathlib import Path

import numpy as np

HEADLIGHT_CD_M2 = 3000.0
FEWEST_LEVELS = 3


def read_grid(path):
    """Read ``ber.csv``: ambient lights (N,), luminances (K,), and rates (N,K) by receiver and locator."""
    with Path(path).open(newline="") as file:
        rows = list(csv.DictReader(file))
    ambient = sorted({float(row["ambient_lx"]) for row in rows})
    luminance = sorted({float(row["value"]) for row in rows})
    rates = {}
    for row in rows:
        place = ambient.index(float(row["ambient_lx"])), luminance.index(float(row["value"]))
        key = row["receiver"], row["locator"]
        rates.setdefault(key, np.full((len(ambient), len(luminance)), np.nan))[place] = float(row["ber"])
    return np.array(ambient), np.array(luminance), rates


def octave_weights(values):
    """Each value's share of the octaves: half the way to either neighbour, and as far beyond the ends."""
    if len(values) == 1:
        return np.ones(1)
    gaps = np.diff(np.log2(values))
    widths = (np.append(gaps[0], gaps) + np.append(gaps, gaps[-1])) / 2
    return widths / widths.sum()


def panels(ambient, luminance, rate):
    """Mean rate of the dimmed panel, then luminance and mean rate of the fixed one and the headlight."""
    means = octave_weights(ambient) @ rate
    dimmed = octave_weights(ambient) @ rate.min(axis=1)
    fixed = means.argmin()
    headlight = np.abs(np.log(luminance / HEADLIGHT_CD_M2)).argmin()
    return dimmed, (luminance[fixed], means[fixed]), (luminance[headlight], means[headlight])


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
    for (receiver, locator), rate in rates.items():
        dimmed, *others = panels(ambient, luminance, rate)
        power = followed_power(ambient, luminance, rate)
        follows = "too few ambient lights" if power is None else f"ambient light to the power {power:.2f}"
        print(f"{receiver}, {locator}: dimmed {dimmed:.2e}; the best luminance follows: {follows}")
        for name, (cd_m2, mean) in zip(("best fixed", "headlight"), others, strict=True):
            times = f"{mean / dimmed:.2f} times" if dimmed else "no errors dimmed"
            print(f"  {name}, {cd_m2:g} cd/m2: {mean:.2e}, {times}")


if __name__ == "__main__":
    main(*sys.argv[1:])
