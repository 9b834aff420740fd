"""Tables, words and board of the price list say what is in it."""

import csv
import io

import pytest
from made_up_prices import (
    ALONE_MS,
    BIT_ERRORS,
    FRAMES,
    LEDS,
    SETTINGS,
    made_up_prices,
)
from rich.console import Console

from vocc_torch.studies.tradeoff.report import (
    print_prices,
    recommendation,
    write_prices,
)


@pytest.fixture(scope="module")
def prices():
    return made_up_prices()


def lines(prices, folder):
    """The lines of the table."""
    write_prices(folder / "tradeoff.csv", prices)
    with (folder / "tradeoff.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def rows(prices, tmp_path_factory):
    return lines(prices, tmp_path_factory.mktemp("tradeoff"))


def test_each_setting_and_place_has_a_row_whose_stages_and_shares_add_up(rows):
    names = (
        "receiver",
        "locator",
        "samples_per_led",
        "gradient",
        "dtype",
        "frames",
        "batch",
    )
    places = [tuple(row[name] for name in names) for row in rows]
    assert len(set(places)) == len(places) == 4 * len(SETTINGS)
    assert all(None not in row.values() for row in rows)
    for row in rows:
        names = ("read", "locate", "rectify", "features", "classify", "preambles")
        stages = sum(float(row[f"{name}_ms"]) for name in names)
        assert stages == pytest.approx(float(row["total_ms"]), rel=1e-4)
        assert float(row["share_of_detection"]) == pytest.approx(0.5)
        assert float(row["frames_per_s"]) == pytest.approx(
            1e3 / float(row["total_ms"]), rel=1e-4
        )
        assert (
            float(row["total_low_ms"])
            < float(row["total_ms"])
            < float(row["total_high_ms"])
        )


def test_rates_and_the_frontier_are_told(rows):
    whole = [row for row in rows if (row["frames"], row["batch"]) == ("whole", "32")]
    for row, wrong, ms in zip(whole, BIT_ERRORS, ALONE_MS, strict=True):
        assert float(row["mixture_ber"]) == pytest.approx(
            wrong / FRAMES / LEDS, rel=1e-4
        )
        assert float(row["mixture_bit_errors"]) == wrong
        assert float(row["total_ms"]) == pytest.approx(ms / 2, rel=1e-4)
        assert row["best_batch"] == "1"
    assert [row["mixture_frontier"] for row in whole] == list("11101110")
    assert [row["mixture_surely_beaten"] for row in whole] == list("00010001")
    assert whole[3]["mixture_beaten_by"] == "mlp-paper-K8-sobel-float32"
    alone = [row for row in rows if (row["frames"], row["batch"]) == ("whole", "1")]
    assert {row["best_batch"] for row in alone} == {"0"}
    assert {row["mixture_frontier_of_best_batches"] for row in alone} == {""}


def plain(text):
    return " ".join(text.split())


@pytest.mark.parametrize("width", [60, 80, 140])
def test_the_table_fits_and_shows_every_receiver(prices, width):
    console = Console(width=width, record=True, file=io.StringIO())
    print_prices(prices, recommendation(prices), console)
    said = console.export_text()
    lines = said.splitlines()
    assert ("weights" in said) == (width > 112)
    if width >= 80:
        assert sum("flda_3" in line for line in lines[:15]) == 4
        assert "< 4.7e-5" in said
    assert "on the frontier" in plain(said)
