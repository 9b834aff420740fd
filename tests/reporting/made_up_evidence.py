"""Made-up arrays for every drawing of the evidence: no simulation behind them."""

import numpy as np

_DRAW = np.random.default_rng(7)


def _picture(rows=8, columns=8, px=4):
    grey = _DRAW.uniform(80, 250, ((rows + 2) * px, (columns + 2) * px))
    return grey, (-1.0, columns + 1.0, rows + 1.0, -1.0)


def _leds(frames=5):
    bits = _DRAW.random((frames, 8, 8)) < 0.5
    return bits, np.where(bits, 160.0, 110.0) + _DRAW.normal(0, 8, bits.shape)


def _features():
    bits, grey = _leds()
    noise = _DRAW.normal(0, 1, bits.shape)
    values = {"average_grey": grey, "agr": grey / 130, "gri": 10.0 * bits - 2 + noise, "ngr": 1 + noise / 10}
    values |= {name: grey - 135 + noise for name in ("agr+gri", "agr+ngr", "gri+ngr", "agr+gri+ngr")}
    return bits, values


CONDITION = np.array([4000.0, 3500.0, 50.0, 102.0])


def _processing_time():
    """Times of five stages for two kinds of frames and two batch sizes, each with its quartiles."""
    middle = np.array([1.0, 0.105, 0.22, 0.3, 0.32]) * np.array([[[5.5], [1.6]], [[4.6], [0.48]]])
    shares = middle / middle[..., :1]
    width = np.where(np.arange(5) > 0, 0.08, 0.0)[:, None] * np.array([-1, 0, 1.5])
    return {
        "frames": ("whole_frames", "crops"),
        "batches": (1, 64),
        "stages": ("panel_detection", "center_greyscale", "average_greyscale", "flda_2", "flda_3"),
        "times_ms": middle[..., None] * np.array([0.95, 1, 1.1]),
        "shares": shares[..., None] * (1 + width),
        "ngr_costs": np.stack([np.full((2, 2, 3), 0.0667), np.full((2, 2, 3), -0.0154)], axis=2),
        "paper_shares": np.array([1.0, 0.05, 0.07, 0.12, 0.14]),
        "rounds": (48, 11),
        "sensor_px": (1080, 1920),
        "machine": "Example Accelerator 200, Example(R) Processor 8000 CPU @ 2.50GHz with 16 cores, "
        "16 threads, torch 2.13.0+cu128",
        "threads": 16,
        "waited_share": 0.374,
    }


def made_up_evidence():
    """Keyword arguments of each drawing, by the figure's name."""
    bits, values = _features()
    auc = dict.fromkeys(values, 0.987)
    wrong = dict.fromkeys(values, 0.0123)
    lines = {"agr+gri": (40.0, 0.5, 42.0), "agr+ngr": (40.0, -14.0, 25.0), "gri+ngr": (0.5, 3.0, 5.0)}
    shared = {"bits": bits, "auc": auc, "wrong": wrong, "lines": lines}
    on = np.where(np.arange(256) >= 150, 9.0, 0.0)
    off = np.where((np.arange(256) >= 110) & (np.arange(256) < 160), 14.0, 0.0)
    counts = on + off
    counts[102] = 2e6
    k = 6
    vectors = _DRAW.normal(0, 5, (2, 2, k, k))
    features = np.stack([values[name].ravel() for name in ("agr", "gri", "ngr")], axis=1)
    return {
        "fig04": {
            "greys": values["average_grey"],
            "bits": bits,
            "pair": (1, 3),
            "pictures": (_picture(), _picture()),
            "conditions": np.stack([CONDITION, CONDITION]),
            "threshold": 135.5,
            "wrong": 0.0312,
        },
        "fig05_06": {
            "pictures": (_picture(), _picture()),
            "greys": values["average_grey"][:2],
            "bits": bits[1],
            "led": (7, 0),
            "threshold": 140.0,
            "gri": values["gri"][1],
            "condition": CONDITION,
            "misread": 3,
            "off_leds": 150,
        },
        "fig08": {
            **shared,
            "values": {name: values[name] for name in ("average_grey", "agr")},
            "gallery": tuple(_picture() for _ in range(12)),
        },
        "fig09": {
            "grey": _DRAW.uniform(90, 200, (2, 3 * k, 3 * k)),
            "gradient": vectors,
            "inward": vectors[0] / np.hypot(*vectors[0]),
            "gri": np.array([6.5, -2.25]),
            "leds": ((0, 4), (2, 7)),
            "cell_px": 4.4,
            "condition": CONDITION,
            "all_gri": values["gri"].ravel(),
            "all_bits": bits.ravel(),
            "all_distances_m": np.repeat(np.linspace(30, 70, 5), 64),
        },
        "fig10": {**shared, "values": values},
        "fig12": {**shared, "values": values},
        "fig13_14": {
            "features": features,
            "bits": bits.ravel(),
            "direction": np.array([40.0, 0.1, -12.0]),
            "threshold": 30.0,
            "projections": features @ [40.0, 0.1, -12.0],
            "pair_direction": np.array([40.0, 0.5]),
            "midpoint": features.mean(axis=0),
            "deviation": features.std(axis=0),
            "frames": 5,
        },
        "fig17": {
            "pictures": (_picture(), _picture(), _picture()),
            "row_px": 11,
            "cell_px": 4.4,
            "sigma_px": 1.5,
            "condition": CONDITION,
        },
        "fig19": {
            "counts": counts,
            "on_counts": on,
            "off_counts": off,
            "threshold": 138,
            "levels": np.array([102.0, 147.0, 255.0]),
            "picture": _picture(),
            "mask": _picture()[0] > 138,
            "outline": np.array([[0.0, 0.1], [8.0, 0.1], [8.0, 7.9], [0.0, 7.9]]),
            "condition": CONDITION,
        },
        "fig20": {
            "pictures": tuple(_picture() for _ in range(6)),
            "contrasts": np.array([0.031, 0.425, 0.425, 0.06, 0.3, 0.5]),
            "seen": np.array([0.01, 0.33, 0.43, 0.02, 0.1, 0.18]),
            "conditions": np.tile(CONDITION, (6, 1)),
            "wanted": np.array([0.06, 0.3, 0.5, 0.06, 0.3, 0.5]),
        },
        "fig25": _processing_time(),
    }
