"""A made-up table of effects and made-up severities, for every view."""

import numpy as np

from vocc_torch.measure.counts import Counts
from vocc_torch.studies.effects.table import (
    Change,
    Cost,
    EffectRow,
    EffectTable,
    SeverityCurve,
    SeverityPoint,
)

FRAMES = 200


def change(wrong, wrong_without=2, frames=FRAMES, missed=0):
    """So many frames with a wrong bit with the effect, and others without it; some without a panel."""
    present, absent, found = np.zeros(frames, np.int64), np.zeros(frames, np.int64), np.ones(frames, bool)
    present[:wrong], absent[frames - wrong_without :] = 2, 2
    if missed:
        found[:missed] = False
        present[:missed] = 64
    return Change.of(present, absent, found, np.ones(frames, bool), 64)


def row(name, group, changes, near, located=None, own=None, **facts):
    """One effect; ``changes`` are those of flda_3, and flda_2 has one wrong frame more."""
    settings = {"settings": "sigma_px=2", "companions": (), "in_scene": False, "fills_sensor": False} | facts
    return EffectRow(
        name=name,
        group=group,
        own=own or (name,),
        near=Cost(near),
        located=Cost(located or near),
        whole=Cost(tuple(40 * one for one in near)),
        changes={
            reading: {"flda_2": change(wrong + 1), "flda_3": change(wrong)}
            for reading, wrong in changes.items()
        },
        **settings,
    )


ROWS = (
    row("pose", "view", {"true_corners": 3, "retrained": 2, "located": 4}, (0.3, 0.31, 0.29)),
    row(
        *("blooming", "optics", {"true_corners": 90, "retrained": 2, "located": 120}, (0.2, 0.2, 0.2)),
        in_scene=True,
    ),
    row(
        *("photoelectrons", "sensor", {"true_corners": 2, "retrained": 2, "located": 2}, (-0.1, 0.1, 0.0)),
        own=("photoelectrons", "gain"),
    ),
    row(
        *(
            "shot_noise",
            "sensor",
            {"true_corners": 40, "retrained": 30},
            (0.6, 0.7, 0.65),
            (60.0, 70.0, 65.0),
        ),
        fills_sensor=True,
        companions=("photoelectrons", "gain"),
    ),
    row("demosaicing", "sensor", {"true_corners": 0, "retrained": 0, "located": 0}, (-0.3, -0.3, -0.2)),
)
TOGETHER = row(
    *("all together", "", {"true_corners": 130, "retrained": 80}, (1.6, 1.7, 1.65), (140.0, 150.0, 145.0)),
    own=("pose", "photoelectrons", "shot_noise", "gain", "demosaicing"),
    fills_sensor=True,
    settings="",
)


def table(rows=ROWS, together=TOGETHER):
    """Five effects, one of which the scene has."""
    base = Counts(FRAMES, 64 * FRAMES, 4, 8, 2)
    return EffectTable(
        scene="dusk",
        rows=rows,
        together=together,
        base_near=Cost((0.3, 0.3, 0.3)),
        base_located=Cost((0.4, 0.4, 0.4)),
        base_whole=Cost((60.4, 60.4, 60.4)),
        base={"truth": {"flda_2": base, "flda_3": base}, "paper": {"flda_2": base, "flda_3": base}},
        receivers=("flda_2", "flda_3"),
        shown="flda_3",
        training_frames=500,
        machine="a machine, 1 thread",
        waited_share=0.2,
        frames_a_call=(32, 1),
    )


def counts(wrong):
    """So many frames with one wrong bit."""
    return Counts(FRAMES, 64 * FRAMES, 2 * wrong, 4 * wrong, wrong)


def curve(name, parameter, values, wrong, usual):
    """So many wrong frames at each value without training, and two fewer with it."""
    points = tuple(
        SeverityPoint(
            value,
            {
                "true_corners": {"flda_2": counts(some + 1), "flda_3": counts(some)},
                "retrained": {"flda_2": counts(some), "flda_3": counts(max(0, some - 2))},
            },
        )
        for value, some in zip(values, wrong, strict=True)
    )
    return SeverityCurve(name, parameter, points, usual)


CURVES = (
    curve("pose", "pose.yaw_deg", (10.0, 20.0, 40.0), (2, 4, 40), None),
    curve("blooming", "blooming.sigma_px", (0.5, 1.5, 3.0), (0, 2, 100), 1.5),
    curve("shot_noise", "photoelectrons.quantum_efficiency", (0.6, 0.06, 0.006), (2, 9, 60), 0.6),
)
