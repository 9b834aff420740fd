"""The report on the paper: what was measured is shown as it was measured, what was not is left out."""

import re
from dataclasses import replace
from html import unescape
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_paper import (
    OTHERS,
    RATES,
    card,
    contents,
    experiments,
    facts,
    figures,
    only,
    readings,
)
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from vocc_torch.studies.paper.report.contents import Contents
from vocc_torch.studies.paper.report.groups import groups_of, on_figure, tally_text
from vocc_torch.studies.paper.report.location_figure import location_figure
from vocc_torch.studies.paper.report.making_section import making
from vocc_torch.studies.paper.report.numbers import named, numbers_table
from vocc_torch.studies.paper.report.rates import PAPER_RECEIVERS
from vocc_torch.studies.paper.report.readings_section import FIT_COLUMNS, best_text, fit_rows
from vocc_torch.studies.paper.report.scorecard_section import TONES
from vocc_torch.studies.paper.report.sections import paper_report
from vocc_torch.studies.paper.report.statements import OUTCOME_TONES, STATEMENTS, causes, outcome
from vocc_torch.studies.paper.report.words import RECEIVERS, plain, rate_interval, ratio_interval, spaced
from vocc_torch.studies.paper.scorecard.quoted import QUOTED_BERS
from vocc_torch.studies.paper.scorecard.words import rate

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.grid import best_luminance
from vocc_torch.show.report import Cell, Highlights, Picture, Table, as_html, as_markdown, write_report
from vocc_torch.show.report.inline import words
from vocc_torch.show.styles import receiver_styles
from vocc_torch.studies.paper.scorecard import (
    CLAIMS,
    VERDICTS,
    Claim,
    Judgement,
    LocationSplit,
    best_reading,
    fits,
    location_split,
)

INVISIBLE = str.maketrans({"\N{NO-BREAK SPACE}": " ", "\N{WORD JOINER}": None, "\N{MINUS SIGN}": "-"})


def visible(text):
    """Inline text as a reader types it."""
    return words(text).translate(INVISIBLE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def whole(folder):
    """Everything that a report can show."""
    return contents(folder)


@pytest.fixture(scope="module")
def report(whole):
    return paper_report(whole)


def sections(report):
    return {section.anchor: section for section in report.sections}


def blocks(report, kind):
    """All blocks of a kind with their section's anchor."""
    return [
        (section.anchor, block)
        for section in report.sections
        for block in section.blocks
        if isinstance(block, kind)
    ]


def rows_of(table):
    """A table's cells as read, by row."""
    return [[visible(cell.text) for cell in row] for row in table.cells]


def table_in(report, anchor, number=0):
    return [block for at, block in blocks(report, Table) if at == anchor][number]


# Everything is there


def test_sections_come_in_order(report):
    levels = {section.anchor: section.level for section in report.sections}
    chapters = [anchor for anchor, level in levels.items() if level == 2]
    assert chapters == [
        *("summary", "scorecard", "readings", "location", "rates", "figures", "dimming", "making"),
    ]
    parts = [anchor for anchor, level in levels.items() if level == 3]
    groups = [
        "pictures",
        "features",
        "setup",
        "contrast",
        "ambient",
        "luminance",
        "distance",
        "time",
        "discussion",
    ]
    figure_anchors = [name.replace("_", "-") for name in (*RATES, *OTHERS)]
    assert parts == [*(f"score-{name}" for name in groups), *figure_anchors]


def test_every_picture_is_shown_once_with_its_data(report, whole):
    shown = [block for _, block in blocks(report, Picture)]
    expected = [(path, figure.table) for figure in whole.figures for path, _ in figure.pictures]
    assert sorted((picture.path, picture.data) for picture in shown) == sorted(expected)
    assert all(len(picture.alt) > len("Fig. 22: ") for picture in shown)


def test_captions_tell_the_paper_from_what_was_measured(report):
    """A caption of the paper's figure is the paper's word; those of other pictures are ours."""
    for anchor, picture in blocks(report, Picture):
        name = anchor.replace("-", "_")
        own = picture.path.stem.endswith("_readings") or anchor in ("dimming", "location")
        expected = "Side by side." if picture.path.stem.endswith("_readings") else f"Caption of {name}."
        assert visible(picture.caption) == (expected if own else f"The paper: {expected}")


def test_every_link_within_leads_to_a_section(report, folder):
    page = as_html(report, folder)
    targets = set(re.findall(r'href="#([\w-]+)"', page))
    assert targets <= set(re.findall(r'id="([\w-]+)"', page))
    assert {f"score-{name}" for name in ("features", "contrast", "ambient", "time")} <= targets


def test_both_files_hold_the_same_words_and_no_leftover_markup(report, folder):
    markdown, page = write_report(report, folder)
    assert (markdown.name, page.name) == ("report.md", "report.html")
    text = re.sub(r"<style>.*?</style>|<[^>]+>", " ", page.read_text(), flags=re.DOTALL)
    assert not re.search(r"[*`\\{]|\bnan\b|\bNone\b", unescape(text.replace("{}", "")))
    for section in report.sections:
        assert f"{'#' * section.level} " in markdown.read_text()
        assert section.title.partition(":")[0].split("_")[0] in unescape(text)


def test_receivers_and_numbers_have_names_for_people(report, folder):
    """No name of a receiver, a number or a locator as the code has it, but in the configuration."""
    page = as_html(report, folder)
    text = unescape(re.sub(r"<style>.*?</style>|<code>.*?</code>|<[^>]+>", " ", page, flags=re.DOTALL))
    assert not re.search(r"\b(flda|auc|share|ms|wrong)_|_greyscale|\d mm, (paper|truth)|[a-z]\+[a-z]", text)


def test_no_line_ends_between_a_number_and_its_unit(report, folder):
    for text in (as_markdown(report, folder), unescape(as_html(report, folder))):
        told = re.sub(r"<style>.*?</style>|`[^`]*`|content=\"[^\"]*\"", "", text, flags=re.DOTALL)
        assert not re.findall(r"\d (?:lx|cd/m|mm|ms|min|%)(?![a-z])", told)
        assert "cd/m2" not in told.replace("cd_m2", "")


# The scorecard


def test_every_claim_stands_once_with_its_verdict_and_numbers(report, whole):
    found = []
    for group in groups_of(whole.scorecard):
        table = table_in(report, group.anchor)
        found += list(zip(group.claims, table.rows, strict=True))
    claims = [claim for (claim, _), _ in found]
    assert sorted(claim.key for claim in claims) == sorted(claim.key for claim in CLAIMS)
    for (claim, judged), row in found:
        text, measured, verdict, *why = row
        assert verdict == Cell(judged.verdict, TONES[judged.verdict])
        assert visible(measured) == plain(judged.measured).translate(INVISIBLE)
        assert visible(text).lower().startswith(plain(claim.text).translate(INVISIBLE).lower())
        assert f"Paper ({plain(claim.where)}): {plain(claim.paper)}".translate(INVISIBLE) in visible(text)
        assert [bool(part) for part in why] in ([], [bool(judged.reason)])


def test_tones_tell_the_verdicts():
    assert TONES == {"agree": "agree", "differ": "differ", "cannot say": "unsure"}
    assert OUTCOME_TONES["holds in part"] is None
    assert {OUTCOME_TONES[outcome] for outcome in ("holds", "does not hold", "cannot say")} == set(
        TONES.values()
    )


def test_counts_are_those_of_the_scorecard(report, whole):
    tally = whole.scorecard.tally()
    ((_, highlights),) = blocks(report, Highlights)
    assert [(int(item.value), item.tone) for item in highlights.items] == [
        (tally[verdict], TONES[verdict]) for verdict in VERDICTS
    ]
    *groups, total = rows_of(table_in(report, "scorecard", 1))
    numbers = [[int(cell) for cell in row[1:]] for row in groups]
    assert [sum(column) for column in zip(*numbers, strict=True)] == [int(cell) for cell in total[1:]]
    assert total[1:] == [str(len(CLAIMS)), *(str(tally[verdict]) for verdict in VERDICTS)]
    assert all(row[0] == sum(row[1:]) for row in numbers)


def test_main_statements_stand_on_claims_that_exist(whole, report):
    """Every pattern finds a claim; every statement leads to a group that holds one of its claims."""
    keys = {claim.key for claim in CLAIMS}
    groups = {group.anchor: {claim.key for claim, _ in group.claims} for group in groups_of(whole.scorecard)}
    for statement in STATEMENTS:
        assert all(replace(statement, keys=(key,)).claims(whole.scorecard) for key in statement.keys)
        mine = {claim.key for claim, _ in statement.claims(whole.scorecard)}
        assert mine & groups[statement.anchor]
        assert mine <= keys
        keys -= mine  # no claim stands under two statements
    table = table_in(report, "scorecard")
    assert [row[0] for row in rows_of(table)] == [plain(s.text).translate(INVISIBLE) for s in STATEMENTS]


def test_what_the_issue_names_first_is_among_the_main_statements(whole):
    named_first = (
        *("ambient.lowest.flda_3", "ambient.ber.flda_3", "ambient.gain", "luminance.lowest.flda_3"),
        *("luminance.gain", "distance.rises.flda_3", "distance.gain", "contrast.range.low"),
        *("contrast.valley.flda_3", "contrast.ber.flda_3", "contrast.gain", "contrast.gain.average"),
        *("contrast.order", "time.flda_3", "features.agr_alone.average_greyscale", "features.ngr_alone"),
    )
    covered = {claim.key for s in STATEMENTS for claim, _ in s.claims(whole.scorecard)}
    assert set(named_first) <= covered


def test_a_statement_shows_how_many_of_its_claims_agree(report, whole):
    truth = next(r for r in whole.scorecard.readings if (r.focal_length_mm, r.locator) == (25.0, "truth"))
    table = table_in(report, "scorecard")
    for statement, row, cells in zip(STATEMENTS, rows_of(table), table.cells, strict=True):
        for reading, text in ((None, row[2]), (truth, row[3])):
            claims = statement.claims(whole.scorecard, reading)
            if text:
                agree = sum(judged.verdict == "agree" for _, judged in claims)
                assert text.startswith(f"{agree} of {len(claims)}")
        claims = statement.claims(whole.scorecard)
        assert cells[1] == Cell(outcome(claims), OUTCOME_TONES[outcome(claims)])
        assert bool(row[4]) == any(judged.verdict != "agree" for _, judged in claims)


VERDICT = st.sampled_from(VERDICTS)


def judged(verdicts):
    rule = Judgement("agree", "").because
    return [(Claim(f"a.{n}", "IV", "text", "", rule), Judgement(v, "")) for n, v in enumerate(verdicts)]


@given(st.lists(VERDICT))
def test_an_outcome_is_no_better_and_no_worse_than_its_claims(verdicts):
    found = outcome(judged(verdicts))
    agree, differ = verdicts.count("agree"), verdicts.count("differ")
    assert (found == "does not hold") == (differ > 0 and not agree)
    assert (found == "holds in part") == (differ > 0 and agree > 0)
    assert (found == "holds") == (not differ and agree > verdicts.count("cannot say"))
    assert found in OUTCOME_TONES


@given(st.lists(VERDICT, min_size=1))
def test_a_tally_in_words_adds_up(verdicts):
    text = tally_text(judged(verdicts))
    if len(verdicts) == 1:
        assert text == f"the claim {'agrees' if verdicts == ['agree'] else 'does not agree'}"
        return
    numbers = [int(number) for number in re.findall(r"(\d+) (?:of|differ|cannot)", text)]
    assert sum(numbers) == len(verdicts) == int(re.search(r"of (\d+)", text)[1])


def test_summary_names_every_statement_under_its_outcome(report, whole):
    bullets = next(
        block
        for block in sections(report)["summary"].blocks
        if hasattr(block, "items") and isinstance(block.items[0], str)
    )
    heads = {
        "Holds": "holds",
        "Holds in part": "holds in part",
        "Does not hold": "does not hold",
        "Cannot be decided": "cannot say",
    }
    told = {heads[visible(item).partition(":")[0]]: visible(item) for item in bullets.items}
    for statement in STATEMENTS:
        found = outcome(statement.claims(whole.scorecard))
        assert plain(statement.text).translate(INVISIBLE) in told[found]
    # Located errors are three times those that the paper quotes: nothing else is wrong in this made-up world.
    assert told["does not hold"] == "Does not hold: the four quoted error rates, 3.9e-4 to 6.6e-4."


def test_location_is_the_cause_where_true_corners_agree(whole):
    found = {cause.text: cause.claims for cause in causes(whole.scorecard, whole.scorecard.details())}
    assert found["with true corners it agrees"] == 4
    at = {(s.experiment, s.receiver, s.value): s for s in whole.location}
    quoted = [(q, at[q.experiment, q.receiver, q.value]) for q in QUOTED_BERS]
    between = [split for q, split in quoted if split.truth.ber < q.ber < split.located.ber]
    assert 0 < len(between) < len(quoted)
    text = "the quoted rate lies between those with the panel located and with true corners"
    assert found[text] == len(between)
    assert all(count <= whole.scorecard.tally()["differ"] for count in found.values())


def test_no_cause_is_told_where_nothing_differs(whole):
    agreeing = [one for one in whole.scorecard.details() if one[1].verdict == "agree"]
    assert causes(whole.scorecard, agreeing) == ()


def test_preambles_and_low_contrast_are_causes_where_the_measurements_say_so():
    """The centre greyscale is made the best of all, and FLDA the worst at low contrast."""
    measured = experiments(1.0)
    rates = readings.paper_rates("contrast")
    rates["center_greyscale"] = dict.fromkeys(rates["flda_3"], 1e-5)
    rates["flda_3"] = {**rates["flda_3"], 0.09: 0.2}
    rates["flda_2"] = {**rates["flda_2"], 0.09: 0.2}
    measured["contrast"] = readings.of_rates("contrast", rates)
    scorecard = card({25.0: measured})
    told = " ".join(cause.text for cause in causes(scorecard, scorecard.details()))
    assert "preambles of the very same scene" in told
    assert "at low contrast one linear rule" in told


# Readings


def test_every_reading_has_a_column_and_a_line(report, whole):
    names = [f"{mm} mm lens, {where}" for mm in (18, 25) for where in ("panel located", "true corners")]
    fit, statements, matrix = (table_in(report, "readings", number) for number in range(3))
    assert [row[0] for row in rows_of(fit)] == names
    for table in (statements, matrix):
        assert [visible(name) for name in table.header[1:]] == names
    assert matrix.folded
    expected = [verdicts for claim, verdicts in whole.scorecard.matrix() if claim.basis == "curves"]
    assert [tuple(cell.text for cell in row[1:]) for row in matrix.cells] == expected
    assert all(cell.tone == TONES[cell.text] for row in matrix.cells for cell in row[1:])


def test_fits_are_written_as_they_were_computed(whole):
    head, *rows = fit_rows(whole.scorecard)
    assert head == FIT_COLUMNS
    for fit, row in zip(fits(whole.scorecard), rows, strict=True):
        assert row[0] == fit.reading
        assert [int(cell) for cell in row[1:4]] == [fit.tally[verdict] for verdict in VERDICTS]
        assert row[4].startswith(f"{fit.rates.decades:.2f} decades")
        assert row[5] == f"{fit.gain_points:.0f} points over {fit.gains}"


def test_the_nearest_reading_is_the_scorecards(whole):
    best = best_reading(fits(whole.scorecard)).reading
    reading = next(one for one in whole.scorecard.readings if one.name == best)
    text = visible(best_text(whole.scorecard))
    where = {"paper": "panel located", "truth": "true corners"}[reading.locator]
    assert f"is {reading.focal_length_mm:g} mm lens, {where}:" in text
    most = max(fit.tally["agree"] for fit in fits(whole.scorecard))
    assert f"Most claims, {most} of the" in text
    leaders = [fit.reading.partition(" ")[0] for fit in fits(whole.scorecard) if fit.tally["agree"] == most]
    assert re.findall(r"(\d+) mm lens", text.partition("agree under")[2]) == leaders
    assert len(leaders) < len(whole.scorecard.readings)


# Location


def test_location_tables_show_the_splits(report, whole):
    totals, points = (table_in(report, "location", number) for number in range(2))
    assert (totals.folded, points.folded) == (False, True)
    shown = [split for split in whole.location if split.receiver in PAPER_RECEIVERS]
    for table, some in (
        (totals, [split for split in shown if split.value is None]),
        (points, [split for split in shown if split.value is not None]),
    ):
        for split, row in zip(some, rows_of(table), strict=True):
            assert row[2].startswith(rate(split.located.ber))
            assert row[3].startswith(rate(split.truth.ber))
            assert row[4].startswith(f"{100 * split.share.value:.0f} % [")
    assert [row[0] for row in rows_of(totals)][::4] == [
        "contrast",
        "ambient light",
        "LED luminance",
        "distance",
    ]
    assert "ambient light, 8000 lx" in [row[0] for row in rows_of(points)]


def test_the_summary_says_how_much_is_location(report, whole):
    shares = {s.experiment: s.share for s in whole.location if s.value is None and s.receiver == "flda_3"}
    text = " ".join(
        visible(block.text) for block in sections(report)["summary"].blocks if hasattr(block, "text")
    )
    for name, words_of in (("contrast", "contrast"), ("luminance", "LED luminance")):
        share = shares[name]
        assert (
            f"{100 * share.value:.0f} % [{100 * share.low:.0f}, {100 * share.high:.0f}] over {words_of}"
            in text
        )


def split_of(experiment, receiver, located, truth, share=None, value=None):
    def counts(wrong):
        return Counts(2000, 128_000, 2 * wrong, 8 * wrong, (wrong + 1) // 2)

    return LocationSplit(experiment, "distance_m", value, receiver, counts(located), counts(truth), share)


def test_location_figure_shows_both_rates_in_the_receivers_colour(whole):
    figure = location_figure(whole.location, "Location")
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "Contrast",
        "Ambient light",
        "LED luminance",
        "Distance",
    ]
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    assert {axes.get_xscale() for axes in figure.axes} == {"log"}
    totals = [s for s in whole.location if s.value is None and s.receiver in PAPER_RECEIVERS]
    styles = receiver_styles(PAPER_RECEIVERS)
    at = {}
    for axes, name in zip(figure.axes, readings.TWO, strict=True):
        for line in axes.lines:
            if line.get_marker() != "None":
                hollow = to_hex(line.get_markerfacecolor()) == "#ffffff"
                at[name, int(line.get_ydata()[0]), hollow] = (line.get_xdata()[0], to_hex(line.get_color()))
        texts = [text.get_text() for text in axes.texts]
        shares = [s.share.value for s in totals if s.experiment == name]
        assert texts == [f"{100 * share:.0f} %" for share in shares]
    for split in totals:
        row = PAPER_RECEIVERS.index(split.receiver)
        colour = styles[split.receiver].colour.lower()
        assert at[split.experiment, row, False] == (split.located.ber, colour)
        assert at[split.experiment, row, True] == (split.truth.ber, colour)


def test_location_figure_draws_a_limit_where_there_was_no_error():
    split = split_of("distance", "flda_3", 400, 0)
    (axes,) = location_figure([split], "Location").axes
    limit = split.intervals()[1].high
    assert limit in [line.get_xdata()[0] for line in axes.lines if line.get_marker() != "None"]
    (arrow,) = [text for text in axes.texts if text.arrow_patch is not None]
    assert arrow.xy[0] == limit
    assert arrow.get_position()[0] < 0  # its other end, in points: to lower rates


def test_location_figure_may_help_or_have_one_experiment_or_one_receiver():
    helped = location_split({"distance": experiments(0.5)["distance"]})
    figure = location_figure(helped, "Location")
    assert all(text.get_text().startswith("\N{MINUS SIGN}") for text in figure.axes[0].texts)
    three = location_figure(
        [split_of(name, "flda_2", 40, 4) for name in ("contrast", "ambient", "distance")], "L"
    )
    canvas = FigureCanvasAgg(three)
    canvas.draw()
    boxes = [axes.get_tightbbox(canvas.get_renderer()) for axes in three.axes]
    assert all(box.x0 >= 0 and box.x1 <= three.bbox.x1 for box in boxes)


@pytest.mark.parametrize(
    "splits", [[], [split_of("d", "flda_3", 4, 2, value=50.0)], [split_of("d", "flda_agr", 4, 2)]]
)
def test_a_location_figure_of_nothing_is_refused(splits):
    with pytest.raises(VoccError, match="no total of any of the paper's receivers"):
        location_figure(splits, "Location")


# Figures


def test_figures_say_how_their_claims_were_judged(report, whole):
    for anchor, section in sections(report).items():
        if not anchor.startswith("fig") or anchor == "figures":
            continue
        claims = on_figure(whole.scorecard, anchor.replace("-", "_"))
        told = [visible(block.text) for block in section.blocks if hasattr(block, "text")]
        assert told[0].startswith(f"Measured here: {tally_text(claims)} (scorecard: ") if claims else not told


def test_claims_belong_to_the_figures_they_name(whole):
    keys = {name: {claim.key for claim, _ in on_figure(whole.scorecard, name)} for name in (*RATES, *OTHERS)}
    assert keys["fig04"] == {"figures.grey_overlap"}
    assert keys["fig05_06"] == {"figures.misread_off"}
    assert "contrast.example.6" in keys["fig20"]
    assert keys["fig20"].isdisjoint(keys["fig21"])
    assert {key.partition(".")[0] for key in keys["fig22"]} == {"ambient"}
    assert "figures.agr_and_gri" in keys["fig10"]


def test_numbers_are_those_of_the_findings(report, whole):
    for figure in whole.figures:
        if not figure.findings or figure.name == "fig25":
            continue
        rows = rows_of(table_in(report, figure.name.replace("_", "-")))
        for (name, value), (_, text) in zip(figure.findings.items(), rows, strict=True):
            if name.startswith("separable_"):
                assert text == ("yes" if value else "no")
                continue
            shown = float(re.match(r"-?[\d.e]+", text)[0]) / (100 if "%" in text else 1)
            assert shown == pytest.approx(value, rel=5e-3), name


@pytest.mark.parametrize(
    "name", sorted({*chain(*readings.FINDINGS.values())} - {*readings.FINDINGS["fig25"]})
)
def test_every_number_has_a_name_for_people(name):
    label, _ = named(name, 0.5)
    assert "_" not in label
    assert label != name.replace("_", " ") or name == "threshold"


def test_numbers_that_nobody_foresaw_keep_their_words():
    assert named("new_number", 2.0) == ("new number", "2")
    assert named("auc_agr+gri", 0.9999885)[1] == "0.9999885"
    assert visible(named("gri", -17.36)[1]) == "-17.36"


def test_times_are_laid_out_by_stage():
    table = numbers_table("Fig. 25: time", {**readings.FINDINGS["fig25"], "threads": 2.0})
    assert [visible(name) for name in table.header] == [
        "stage",
        "whole frames, one at a time",
        "crops, one at a time",
    ]
    rows = {row[0]: row[1:] for row in rows_of(table)}
    assert rows["panel detection"] == ["10 ms", ""]
    assert rows["AGR + GRI + NGR"] == ["1.4 ms, 14 %", "500 %"]
    assert rows["NGR adds to two features"] == ["17 %", ""]
    assert rows["NGR adds to all image processing"] == ["1.78 %", ""]
    assert "threads 2" in visible(table.caption)


# Dimming, and how it was made


def test_dimming_tables_show_the_best_ranges(report, whole):
    names = {row[0]: row for row in rows_of(table_in(report, "dimming", 0))}
    for name, style in receiver_styles(PAPER_RECEIVERS).items():
        best = best_luminance(whole.grids["paper"], name)
        assert names[style.label][1:] == [one.candidates_text for one in best]
    assert "true corners" in table_in(report, "dimming", 1).caption


def test_the_whole_configuration_is_there_by_key(report):
    rows = rows_of(table_in(report, "making", 1))
    assert rows == [
        ["seed", "0"],
        ["scene.distance_m", "[uniform,40,60.5]"],
        ["input", "null"],
        ["effects", "{}"],
    ]


def test_times_add_up_and_a_resumed_run_says_so(whole):
    table = next(block for block in making(whole).blocks if isinstance(block, Table))
    assert rows_of(table) == [["training", "61.5"], ["report", "1.5"], ["all", "63.0"]]
    for resumed in (False, True):
        page = as_markdown(paper_report(Contents((), None, (), {}, facts(resumed))), Path())
        assert (
            "1.1 min, going on from what an earlier run had counted" in page.translate(INVISIBLE)
        ) == resumed
        assert ("1.1 min: 2000 test frames" in page.translate(INVISIBLE)) != resumed
        assert ("took no time in this one" in page) == resumed


# What was not measured is left out


def left_out(whole, **parts):
    """The anchors of a report without some of its parts, written both ways."""
    report = paper_report(replace(whole, **parts))
    return report, {section.anchor for section in report.sections}


def test_without_a_scorecard(whole, report, folder):
    smaller, anchors = left_out(whole, scorecard=None)
    gone = set(sections(report)) - anchors
    assert gone == {anchor for anchor in sections(report) if anchor.startswith("score")} | {"readings"}
    assert "Measured here" not in as_html(smaller, folder)
    assert not re.search(r"#score", as_html(smaller, folder))


def test_without_location(whole, report, folder):
    smaller, anchors = left_out(whole, location=())
    assert set(sections(report)) - anchors == {"location"}
    assert "#location" not in as_html(smaller, folder)


def test_without_the_picture_of_location_its_tables_stay(whole):
    few = tuple(figure for figure in whole.figures if figure.name != "location")
    smaller, anchors = left_out(whole, figures=few)
    assert "location" in anchors
    assert len([block for at, block in blocks(smaller, Table) if at == "location"]) == 2


def test_without_grids(whole, report):
    few = tuple(figure for figure in whole.figures if figure.name != "dimming")
    assert set(sections(report)) - left_out(whole, figures=few, grids={})[1] == {"dimming"}


@pytest.mark.parametrize(("names", "gone"), [(RATES, "figures"), (OTHERS, "rates")])
def test_without_some_figures(whole, tmp_path, names, gone):
    smaller, anchors = left_out(whole, figures=figures(tmp_path, names))
    assert gone not in anchors
    assert {name.replace("_", "-") for name in names} <= anchors
    write_report(smaller, tmp_path)


def test_nothing_but_the_facts(tmp_path):
    report = paper_report(Contents((), None, (), {}, facts()))
    assert [section.anchor for section in report.sections] == ["summary", "making"]
    write_report(report, tmp_path)
    assert "vocc-torch task=figures" in (tmp_path / "report.md").read_text()


@pytest.mark.parametrize("locator", ["paper", "truth"])
def test_one_reading(tmp_path, locator):
    """One lens and one locator: nothing is compared with true corners, and nothing crashes."""
    scorecard = card({25.0: only(experiments(), locator)}, (25.0, locator), (locator,))
    report = paper_report(Contents(figures(tmp_path), scorecard, (), {}, facts()))
    write_report(report, tmp_path)
    where = {"paper": "panel located", "truth": "true corners"}[locator]
    header = [visible(name) for name in table_in(report, "scorecard").header]
    assert header == ["the paper says", "here", "claims that agree", "why not"]
    assert [row[0] for row in rows_of(table_in(report, "readings"))] == [f"25 mm lens, {where}"]
    text = (tmp_path / "report.md").read_text().translate(INVISIBLE)
    assert f"The report's own reading is **25 mm lens, {where}**" in text
    assert ("Table 1's focal length, and" in text) == (locator == "paper")
    assert "Of the other" not in text
    assert "Every other reading" not in text
    assert not [cause for cause in causes(scorecard, scorecard.details()) if "true corners" in cause.text]


def test_true_corners_as_the_own_reading_are_not_compared_with_themselves(tmp_path):
    scorecard = card({25.0: experiments()}, (25.0, "truth"))
    table = table_in(paper_report(Contents((), scorecard, (), {}, facts())), "scorecard")
    assert "with true corners" not in table.header


def test_a_scorecard_without_any_experiment_or_figure(tmp_path):
    """Nothing was measured: everything that needs a measurement cannot be said."""
    from vocc_torch.studies.paper.scorecard import readings_of, score

    scorecard = score(readings_of({25.0: {}}, {}), (25.0, "paper"))
    report = paper_report(Contents((), scorecard, (), {}, facts()))
    write_report(report, tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "No quoted error rate was measured under any reading." in text
    assert "**Cannot be decided:**" in text


def test_claims_of_a_new_kind_are_not_lost(tmp_path):
    from vocc_torch.studies.paper.scorecard import readings_of, score

    new = Claim("novel.thing", "VI", "something new", "yes", lambda _: Judgement("differ", "no", "so it is"))
    scorecard = score(readings_of({25.0: {}}, {}), (25.0, "paper"), (new,))
    report = paper_report(Contents((), scorecard, (), {}, facts()))
    write_report(report, tmp_path)
    assert rows_of(table_in(report, "score-others"))[0][2] == "differ"


# Words


@given(st.floats(1e-9, 1), st.floats(0, 1), st.floats(0, 1))
def test_rates_keep_their_digits(ber, down, up):
    low, high = ber * down, ber + (1 - ber) * up
    text = rate_interval(ber, low, high).translate(INVISIBLE)
    assert text == f"{rate(ber)} [{rate(low)}, {rate(high)}]"


@given(st.text("0123456789 .,-e%[]mlxcd/²AGRIN"))
def test_spacing_changes_no_visible_sign(text):
    """Only blanks become no-break blanks, and word joiners take no room."""
    given_text = text.replace("\N{NO-BREAK SPACE}", " ")
    assert spaced(given_text).translate(INVISIBLE) == given_text


@pytest.mark.parametrize(
    ("raw", "read"),
    [
        ("flda_3's 6.1e-3, 100 % vanish", "AGR + GRI + NGR's 6.1e-3, 100 % vanish"),
        ("average_greyscale 5.2e-2 and flda_agr_ngr 5.8e-2", "average greyscale 5.2e-2 and AGR + NGR 5.8e-2"),
        ("area of agr+gri+ngr 0.9999999, area of agr 1", "area of AGR + GRI + NGR 0.9999999, area of AGR 1"),
        ("-3 % [-7, -0]", "-3 % [-7, 0]"),
        ("GRI = -0.2", "GRI = -0.2"),
        ("grey with blooming 179.3953", "grey with blooming 179.4"),
        ("0.99318", "0.99318"),
        ("negative in 55% of Off LEDs", "negative in 55 % of Off LEDs"),
        ("0.72 decades [0.44, inf]", "0.72 decades [0.44, ∞]"),
        ("IV-D-2, Fig. 22; III-B", "IV-D-2, Fig. 22; III-B"),
        ("at 8000 cd/m2", "at 8000 cd/m²"),
    ],
)
def test_words_of_the_scorecard_for_people(raw, read):
    assert plain(raw).translate(INVISIBLE) == read


def test_every_receiver_has_a_name(whole):
    assert set(RECEIVERS) == {*PAPER_RECEIVERS, "flda_agr", "flda_gri", "flda_ngr", "flda_agr_ngr"}
    assert len(set(RECEIVERS.values())) == len(RECEIVERS)


def test_ratios_that_are_infinite_are_told_by_what_is_sure():
    inf = float("inf")
    assert ratio_interval(inf, 5.0, inf) == "at least 5"
    assert ratio_interval(2.5, 1.8, inf) == "2.5 [1.8, ∞]"
    assert ratio_interval(2.541, 1.849, 3.144) == "2.54 [1.85, 3.14]"
