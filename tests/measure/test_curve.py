"""Points state what their counts say, and a table keeps what belongs together."""

from dataclasses import asdict

import pytest

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import COLUMNS, BerTable, Point, Row
from vocc_torch.measure.intervals import ber_interval

CLEAN = Counts(frames=10, bits=640)
WRONG = Counts(
    10, 640, half_errors=7, half_errors_squared=29, frame_errors=2, panels_missed=1
)


def point(
    value=50.0,
    receiver="flda_3",
    counts=WRONG,
    locator="truth",
    experiment="d",
    axis="distance_m",
):
    return Point(experiment, axis, value, receiver, locator, counts, "frames")


def test_the_row_has_exactly_the_columns_that_others_rely_on():
    names = "experiment axis value receiver locator frames bits bit_errors ber ber_low ber_high frame_errors"
    later = "trainings ber_mean ber_sd ber_best ber_worst algorithm_low algorithm_high"
    last = "method effective_frames unseen_below location_share"
    assert (
        *names.split(),
        "panels_missed",
        "stopped_by",
        *later.split(),
        *last.split(),
    ) == COLUMNS


def test_the_row_states_the_counts_and_their_interval():
    row, interval = asdict(point().stated()), ber_interval(WRONG)
    assert (row["frames"], row["bits"], row["bit_errors"], row["ber"]) == (
        10,
        640,
        3.5,
        3.5 / 640,
    )
    assert (row["ber_low"], row["ber_high"]) == (interval.low, interval.high)
    assert (row["frame_errors"], row["panels_missed"], row["stopped_by"]) == (
        2,
        1,
        "frames",
    )


def test_a_table_orders_values_and_keeps_the_receivers_order():
    places = [
        (70.0, "flda_3"),
        (30.0, "center_greyscale"),
        (30.0, "flda_3"),
        (50.0, "flda_3"),
    ]
    table = BerTable([point(value, receiver) for value, receiver in places])
    assert table.receivers == ("flda_3", "center_greyscale")
    assert table.values == (30.0, 50.0, 70.0)
    assert [row.value for row in table.of("flda_3")] == [30.0, 50.0, 70.0]
    assert table.of("nobody") == ()
    assert [(row.value, row.receiver) for row in table] == places
    assert (table.experiment, table.axis, table.locators, len(table)) == (
        "d",
        "distance_m",
        ("truth",),
        4,
    )


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([point(), point(70.0, experiment="other")], r"^experiment is d and other: "),
        (
            [point(), point(70.0, axis="ambient_lx")],
            r"^axis is ambient_lx and distance_m: ",
        ),
        (
            [point(), point(locator="paper")],
            r"^receiver flda_3 has two points at distance_m=50: ",
        ),
        ([point(value=float("nan"))], r"^distance_m is nan: "),
        ([point(value=1e308)], r"^distance_m is 1e\+308: .* at most 1e\+100"),
    ],
)
def test_what_does_not_belong_in_a_table_is_refused(points, message):
    with pytest.raises(VoccError, match=message):
        BerTable(points)


def test_a_row_with_its_rate_outside_its_interval_is_refused():
    with pytest.raises(
        VoccError, match=r"^ber of flda_3 at distance_m=50 is 0.2 in \[0.3, 0.4\]: "
    ):
        Row(
            "d",
            "distance_m",
            50.0,
            "flda_3",
            "truth",
            1,
            10,
            2.0,
            0.2,
            0.3,
            0.4,
            1,
            0,
            "frames",
        )


def test_the_limit_of_a_clean_point_takes_wrong_frames_to_be_as_at_the_other_points():
    """Ten wrong bits a wrong frame elsewhere: the limit is ten times that of one, and 10 * 3 / bits or so."""
    spoilt = Counts(
        frames=1000,
        bits=64_000,
        half_errors=80,
        half_errors_squared=1600,
        frame_errors=4,
    )
    clean = Counts(frames=1000, bits=64_000)
    alone = BerTable(
        [Point("d", "distance_m", 30.0, "flda_3", "paper", clean, "frames")]
    )
    both = BerTable(
        [
            Point("d", "distance_m", value, "flda_3", "paper", counts, "frames")
            for value, counts in ((30.0, clean), (70.0, spoilt))
        ]
    )
    assert both.rows[0].ber_high == pytest.approx(10 * alone.rows[0].ber_high)
    assert both.rows[0].ber_high == pytest.approx(10 * (1 - 0.05 ** (1 / 1000)) / 64)


def test_location_has_a_share_where_a_locator_looked_and_bits_were_wrong():
    misplaced = Counts(10, 640, 8, 40, 2, 1, misplaced=1, misplaced_half_errors=6)
    assert point(counts=misplaced, locator="paper").stated().location_share == 0.75
    assert point(counts=misplaced).stated().location_share is None
    assert point(counts=CLEAN, locator="paper").stated().location_share is None
