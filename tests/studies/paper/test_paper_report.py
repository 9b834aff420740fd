"""The report on the paper: what was measured is shown as it was measured, what was not is left out."""

import re
from html import unescape

import numpy as np
import pytest
from made_up_readings import FINDINGS, TWO, card_of, grid_of, located_experiments, paper_experiments
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from PIL import Image

from vocc_torch.measure.config import Experiment, Settings
from vocc_torch.measure.curve import Measured
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.grid import best_luminance
from vocc_torch.report.styles import receiver_styles
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.figures import (
    PAPER_RECEIVERS,
    LocationSplit,
    PaperPlan,
    location_figure,
    location_split,
)
from vocc_torch.studies.paper.run import Report
from vocc_torch.studies.paper.scorecard import CLAIMS, PARTS, STATEMENTS, causes, outcome, part_of, tally
from vocc_torch.studies.paper.words import number_table, plain

RATES = ("fig21", "fig22", "fig23", "fig24")
OTHERS = ("fig04", "fig05_06", "fig08", "fig09", "fig10", "fig12", "fig17", "fig19", "fig20", "fig25")
INVISIBLE = str.maketrans({"\N{NO-BREAK SPACE}": " ", "\N{WORD JOINER}": None, "\N{MINUS SIGN}": "-"})


def figures(folder, names=(*RATES, *OTHERS, "dimming", "location")):
    """Written figures with a tiny picture and a table each; the rates have two pictures."""
    (folder / "figures").mkdir(exist_ok=True)
    shown = {}
    for name in names:
        stems = (name, f"{name}_readings")[: 2 if name in RATES else 1]
        for stem in stems:
            picture = Image.fromarray(np.full((4, 6), len(shown), dtype=np.uint8))
            picture.save(folder / "figures" / f"{stem}.png")
        pictures = [(f"figures/{stem}.png", "Side by side." if stem != name else "") for stem in stems]
        title = "A title" if name in ("dimming", "location") else f"Fig. {name[3:].lstrip('0')}: a title"
        table, findings = f"figures/{name}.csv", FINDINGS.get(name, {})
        shown[name] = {"name": name, "title": title, "caption": f"Caption of {name}.", "pictures": pictures}
        shown[name] |= {"table": table, "findings": findings}
    return shown


class Page:
    """A written report, as a reader sees it."""

    def __init__(self, folder, resumed=False, **parts):
        plan = PaperPlan(FiguresConfig([], [25.0], ["paper"], {}), ("fig22",), {})
        rest = {"experiment": Experiment("ambient", "ambient_lx", (8000.0,))}
        settings = Settings("figures", "whole", 7, "cpu", "float32", "crop", 64, 0, False, **rest)
        Report(folder, plan, **parts).write(settings, {"training": 61.5, "report": 1.5}, resumed)
        self.markdown = (folder / "report.md").read_text(encoding="utf-8")
        self.html = (folder / "report.html").read_text(encoding="utf-8")
        self.anchors = re.findall(r'^<a id="([\w-]+)"></a>$', self.markdown, flags=re.MULTILINE)
        self.text = self._seen(self.markdown)

    @staticmethod
    def _seen(markdown):
        """Markdown without its marks."""
        text = re.sub(r"\[([^\]\\]*)\]\([^)]*\)", r"\1", markdown)
        return unescape(re.sub(r"\\(.)", r"\1", text.replace("**", "").replace("`", ""))).translate(INVISIBLE)

    def section(self, anchor):
        """What stands between an anchor and the next."""
        _, _, rest = self.markdown.partition(f'<a id="{anchor}"></a>')
        return self._seen(re.split(r'^<a id="', rest, flags=re.MULTILINE)[0])

    def tables(self, anchor):
        """The rows of a section's tables, heads and all."""
        found, open_table = [], False
        for line in self.section(anchor).splitlines():
            if line.startswith("|"):
                if not open_table:
                    found.append([])
                found[-1].append([cell.strip() for cell in line.strip("|").split("|")])
            open_table = line.startswith("|")
        return [[head, *rows] for head, _, *rows in found]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def contents(place):
    """Everything that a report can show."""
    by_focal_mm = {25.0: located_experiments(), 18.0: located_experiments(8.0)}
    grids = {
        name: grid_of({1e3: 1e3, 8e3: 4e3, 32e3: 16e3}, PAPER_RECEIVERS, frames)
        for name, frames in (("paper", 2000), ("truth", 500))
    }
    return {
        "shown": figures(place),
        "measured": by_focal_mm,
        "card": card_of(by_focal_mm, grids=grids),
        "location": location_split(by_focal_mm[25.0]),
        "grids": grids,
    }


@pytest.fixture(scope="module")
def page(place, contents):
    return Page(place, **contents)


# Everything is there


def test_sections_come_in_order_with_every_picture(page, contents):
    groups = [part.anchor for part in PARTS[:-1]]
    shown = [name.replace("_", "-") for name in (*RATES, "figures", *OTHERS)]
    assert page.anchors == [
        *("summary", "scorecard", *groups, "readings", "location", "rates"),
        *(*shown, "dimming", "making"),
    ]
    pictures = re.findall(
        r"^!\[[^]]+\]\(([^)]+)\)\n.* \[Data \(CSV\)\]\([^)]+\)$", page.markdown, re.MULTILINE
    )
    expected = [path for one in contents["shown"].values() for path, _ in one["pictures"]]
    assert sorted(pictures) == sorted(expected)
    assert page.html.count("data:image/png;base64,") == len(expected)
    targets = set(re.findall(r'href="#([\w-]+)"', page.html))
    assert {part.anchor for part in PARTS[:-1]} <= targets <= set(re.findall(r'id="([\w-]+)"', page.html))


def test_the_page_reads_well(page):
    """No leftover markup, no names as the code has them, no line end between a number and its unit."""
    html = re.sub(r"<style>.*?</style>|<pre>.*?</pre>|<code>.*?</code>", "", page.html, flags=re.DOTALL)
    text = unescape(re.sub(r"<[^>]+>", " ", html))
    assert not re.search(r"[*`\\{|]|\bnan\b|\bNone\b", text)
    assert not re.search(r"\b(flda|auc|share|ms|wrong)_|_greyscale|\d mm, (paper|truth)|[a-z]\+[a-z]", text)
    assert not re.search(r"\d (?:lx|cd/m|mm|ms|min|%)(?![a-z])|cd/m2", text)
    assert not re.search(r"[a-z],[a-z0-9]|[a-z]\.\.", text)


# The scorecard


def test_every_claim_stands_once_with_its_verdict_and_numbers(page, contents):
    rows = {part.anchor: iter(page.tables(part.anchor)[0][1:]) for part in PARTS[:-1]}
    signs = {"agree": "✓", "differ": "✗", "cannot say": "?"}
    for claim, judged in contents["card"].judged():
        text, measured, verdict, why = next(rows[part_of(claim).anchor])
        assert text.lower().startswith(plain(claim.text).translate(INVISIBLE).lower())
        assert f"Paper ({claim.where}): {plain(claim.paper)}".translate(INVISIBLE) in text
        assert measured == plain(judged.measured).translate(INVISIBLE)
        assert verdict == f"{signs[judged.verdict]} {judged.verdict}"
        assert bool(why) == bool(judged.reason)
    assert not [row for left in rows.values() for row in left]


def test_counts_are_those_of_the_scorecard(page, contents):
    counts = tally(contents["card"].judged())
    assert [int(n) for n in re.findall(r"^\* \S (\d+) ", page.section("summary"), re.MULTILINE)] == list(
        counts.values()
    )
    _, *groups, total = page.tables("scorecard")[1]
    numbers = np.array([[int(cell) for cell in row[1:]] for row in groups])
    assert numbers.sum(0).tolist() == [int(cell) for cell in total[1:]] == [len(CLAIMS), *counts.values()]
    assert (numbers[:, 0] == numbers[:, 1:].sum(1)).all()


def test_a_statement_shows_how_many_of_its_claims_agree(page, contents):
    card = contents["card"]
    head, *rows = page.tables("scorecard")[0]
    assert head == ["the paper says", "here", "claims that agree", "with true corners", "why not"]
    for statement, (text, here, own, truth, why) in zip(STATEMENTS, rows, strict=True):
        assert text == plain(statement.text).translate(INVISIBLE)
        assert here.endswith(outcome(card.judged(statement)))
        for reading, told in ((None, own), (card.at_truth(), truth)):
            claims = card.judged(statement, reading)
            assert not told or told.startswith(f"{tally(claims)['agree']} of {len(claims)}")
        assert bool(why) == any(judged.verdict != "agree" for _, judged in card.judged(statement))


def test_every_reading_has_its_column_and_its_fit(page, contents):
    card = contents["card"]
    names = [f"{mm} mm lens, {where}" for mm in (18, 25) for where in ("panel located", "true corners")]
    fits, statements, matrix = page.tables("readings")
    assert [row[0] for row in fits[1:]] == statements[0][1:] == matrix[0][1:] == names
    for row, reading in zip(fits[1:], card.readings, strict=True):
        of_curves = [one for one in card.judged(reading=reading) if one[0].basis == "curves"]
        assert [int(cell) for cell in row[1:4]] == list(tally(of_curves).values())
    for row, claim in zip(matrix[1:], [claim for claim in CLAIMS if claim.basis == "curves"], strict=True):
        verdicts = [card.judgements[claim.claim, reading.name].verdict for reading in card.readings]
        assert [cell[2:] for cell in row[1:]] == verdicts
    nearest = r"Nearest to the paper's four quoted error rates is \d+ mm lens, true corners"
    assert re.search(nearest, page.section("readings"))


def test_figures_say_how_the_claims_that_name_them_were_judged(page, contents):
    ambient = tally(one for one in contents["card"].judged() if one[0].claim.startswith("ambient."))
    told = f"Measured here: {ambient['agree']} of {sum(ambient.values())} claims agree"
    assert told in page.section("fig22")
    assert "(scorecard: Ambient light)" in page.section("fig22")
    assert "Measured here: the claim agrees (scorecard: Greys, blooming and location)." in page.section(
        "fig04"
    )
    assert "Measured here" not in page.section("dimming")


# Numbers


def test_numbers_are_those_of_the_findings(page):
    for figure in OTHERS[:-1]:
        _, *rows = page.tables(figure.replace("_", "-"))[0]
        for (name, value), (label, text) in zip(FINDINGS[figure].items(), rows, strict=True):
            assert "_" not in label
            if name.startswith("separable_"):
                assert text == ("yes" if value else "no")
                continue
            shown = float(re.match(r"-?[\d.e]+", text)[0]) / (100 if "%" in text else 1)
            assert shown == pytest.approx(value, rel=5e-3), name


def test_times_are_laid_out_by_stage():
    head, rows = number_table({**FINDINGS["fig25"], "threads": 2.0})
    assert head[1:] == ["whole frames, one at a time", "crops, one at a time"]
    cells = {row[0]: [cell.translate(INVISIBLE) for cell in row[1:]] for row in rows}
    assert cells == {
        "centre greyscale": ["5 %, 0.5 ms", ""],
        "average greyscale": ["7 %, 0.7 ms", ""],
        "AGR + GRI": ["12 %, 1.2 ms", ""],
        "AGR + GRI + NGR": ["14 %, 1.4 ms", "500 %"],
        "panel detection": ["10 ms", ""],
        "NGR adds to two features": ["17 %", ""],
        "NGR adds to all image processing": ["1.78 %", ""],
        "threads": ["2", ""],
    }


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


# Location, dimming, and how it was made


def test_location_figure_draws_a_limit_where_there_was_no_error_and_keeps_inside_the_picture():
    rates = Estimate(4e-3, 2e-3, 8e-3), Estimate(0.0, 0.0, 1e-5)
    splits = [
        LocationSplit(name, "distance_m", None, "flda_3", 2000, *rates, None)
        for name in ("contrast", "ambient", "distance")
    ]
    figure = location_figure(splits, 25.0)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    for axes in figure.axes:
        assert 1e-5 in [line.get_xdata()[0] for line in axes.lines if line.get_marker() != "None"]
        (arrow,) = [text for text in axes.texts if text.arrow_patch is not None]
        assert (arrow.xy[0], arrow.get_position()[0] < 0) == (1e-5, True)  # to lower rates
        box = axes.get_tightbbox(canvas.get_renderer())
        assert 0 <= box.x0 <= box.x1 <= figure.bbox.x1


def test_location_figure_shows_both_rates_in_the_receivers_colour(contents):
    figure = location_figure(contents["location"], 25.0)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["Contrast", "Ambient light", "LED luminance", "Distance"]
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    totals = [s for s in contents["location"] if s.value is None and s.receiver in PAPER_RECEIVERS]
    styles, drawn = receiver_styles(PAPER_RECEIVERS), {}
    for axes, name in zip(figure.axes, TWO, strict=True):
        for line in axes.lines:
            if line.get_marker() != "None":
                hollow = to_hex(line.get_markerfacecolor()) == "#ffffff"
                drawn[name, int(line.get_ydata()[0]), hollow] = line.get_xdata()[0], to_hex(line.get_color())
        shares = [f"{100 * s.share.value:.0f} %" for s in totals if s.experiment == name]
        assert [text.get_text() for text in axes.texts] == shares
    for split in totals:
        at = split.experiment, PAPER_RECEIVERS.index(split.receiver)
        colour = styles[split.receiver].colour.lower()
        assert drawn[*at, False] == (split.located.value, colour)
        assert drawn[*at, True] == (split.truth.value, colour)


def test_dimming_shows_the_best_luminances_by_ambient_light(page, contents):
    tables = page.tables("dimming")
    assert tables[0][0] == ["receiver", "1000 lx", "8000 lx", "32000 lx"]
    for table, grid in zip(tables, contents["grids"].values(), strict=True):
        for row, name in zip(table[1:], PAPER_RECEIVERS, strict=True):
            assert row[1:] == [best.candidates_text for best in best_luminance(grid, name)]
    assert "true corners" in page.section("dimming")


@pytest.mark.parametrize("resumed", [False, True])
def test_times_add_up_and_a_resumed_run_says_so(tmp_path, resumed):
    """Without anything measured only the summary and the facts are left."""
    page = Page(tmp_path, resumed)
    assert page.anchors == ["summary", "making"]
    assert page.tables("making")[0][1:] == [["training", "61.5"], ["report", "1.5"], ["all", "63.0"]]
    assert ("1.1 min, going on from what an earlier run had counted" in page.text) == resumed
    assert ("took no time in this one" in page.text) == resumed
    assert "```text\ntask: figures\nname: whole\nseed: 7\n" in page.markdown
    assert "vocc-torch task=figures name=whole" in page.section("making")
    assert "1000 training frames, 1024 test frames a point, all-On" in page.section("making")


# What was not measured is left out


@pytest.mark.parametrize(
    ("without", "gone"),
    [
        ({"card": None}, {"scorecard", "readings", *(part.anchor for part in PARTS[:-1])}),
        ({"location": ()}, {"location"}),
        (
            {"names": (*RATES, "location")},
            {"figures", "dimming", *(name.replace("_", "-") for name in OTHERS)},
        ),
        ({"names": (*OTHERS, "dimming")}, {"rates", *RATES}),
    ],
)
def test_what_was_not_measured_is_left_out(tmp_path, page, contents, without, gone):
    parts = {
        **contents,
        "shown": figures(tmp_path, *([without.pop("names")] if "names" in without else [])),
    }
    smaller = Page(tmp_path, **parts | without)
    assert set(page.anchors) - set(smaller.anchors) == gone
    assert not set(re.findall(r'href="#([\w-]+)"', smaller.html)) & gone


@pytest.mark.parametrize("locator", ["paper", "truth"])
def test_one_reading_is_compared_with_none(tmp_path, locator):
    measured = paper_experiments(2000)
    alone = {name: Measured({locator: one.curves[locator]}, {}) for name, one in measured.items()}
    card = card_of({25.0: alone}, (25.0, locator), (locator,))
    page = Page(tmp_path, card=card, measured={25.0: alone})
    where = {"paper": "panel located", "truth": "true corners"}[locator]
    assert page.tables("scorecard")[0][0] == ["the paper says", "here", "claims that agree", "why not"]
    assert f"The report's own reading is 25 mm lens, {where}" in page.text
    assert ("Table 1's focal length, and" in page.text) == (locator == "paper")
    assert "Of the other" not in page.text
    assert "Every other reading" not in page.text
    assert not [text for text, _ in causes(card, card.judged()) if "true corners" in text]
