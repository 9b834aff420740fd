"""A report says the same in Markdown and in HTML, and both are what their readers and browsers expect."""

import base64
import errno
import io
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.show.canvas import new_figure, save_figure
from vocc_torch.show.report import (
    Bullets,
    Cell,
    Code,
    Highlight,
    Highlights,
    Paragraph,
    Picture,
    Pictures,
    Report,
    Section,
    Table,
    as_html,
    as_markdown,
    literal,
    write_report,
)
from vocc_torch.show.report.pictures import read_png
from vocc_torch.show.report.stylesheet import STYLESHEET

MARKDOWN = MarkdownIt("commonmark").enable(["table", "strikethrough"])
VOID = {"meta", "img", "br", "hr", "input", "link"}
NASTY = "a < b & c > d | e \"quoted\" 'so' `open and &amp; **open __x__ [y] $z$ ~~w~~ {0} # 1. \\"


class Page(HTMLParser):
    """What a page holds: its elements with their attributes and texts; refuses tags that do not match."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.links = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        names = [name for name, _ in attributes]
        assert len(names) == len(set(names)), f"{tag} has an attribute twice"
        element = {
            "tag": tag,
            "attributes": dict(attributes),
            "text": "",
            "inside": [e["tag"] for e in self.open],
        }
        self.elements.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_startendtag(self, tag, attributes):
        assert tag in VOID
        self.handle_starttag(tag, attributes)

    def handle_endtag(self, tag):
        assert tag not in VOID
        assert self.open.pop()["tag"] == tag

    def handle_data(self, data):
        for element in self.open:
            element["text"] += data

    def all(self, *tags):
        return [element for element in self.elements if element["tag"] in tags]

    def texts(self, tag):
        return [element["text"] for element in self.all(tag)]

    def attributes(self, tag, name):
        return [element["attributes"].get(name) for element in self.all(tag)]


def made_picture(path, mode="RGBA", seed=0):
    """A PNG file of 60 x 40 random pixels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.random.default_rng(seed).integers(0, 256, (40, 60, 4), dtype=np.uint8)
    if mode == "RGBA":
        values[..., 3] = 255
    if mode == "I;16":
        Image.fromarray(values[..., 0].astype(np.uint16) * 257).save(path)
    else:
        Image.fromarray(values).convert(mode if mode != "see-through" else "RGBA").save(path)
    return path


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b b", "c"):
        made_picture(tmp_path / "figures" / f"{name}.png", seed=ord(name[0]))
        (tmp_path / "figures" / f"{name}.csv").write_text("x,y\n1,2\n")
    return tmp_path


def picture(name="a", caption="A **curve**"):
    return Picture(Path(f"figures/{name}.png"), caption, f"picture {name}", Path(f"figures/{name}.csv"))


@pytest.fixture
def report():
    table = Table(
        ("Claim", "Paper", "Verdict"),
        (
            ("BER at 8000 lx falls | rises, a claim of many words", "6.6e-4", Cell("agree", "agree")),
            ("`a|b`", "24 %", Cell("differ", "differ")),
            ("**NGR** \\| alone", Cell("none"), Cell("cannot say", "unsure")),
        ),
        ("left", "right", "center"),
        "Claims & numbers",
    )
    return Report(
        "Evidence & <score>",
        "Of [the paper](https://example.org/a_b?c=1&d=2)",
        (
            Section(
                "Summary", "summary", (Highlights((Highlight("17", "agree", "agree"), Highlight("2", "n"))),)
            ),
            Section("Scorecard", "scorecard", (Paragraph("See [Fig. 22](#fig-22)."), table)),
            Section(
                "Fig. 22", "fig-22", (picture(), Pictures((picture("a"), picture("b b"), picture("c")))), 3
            ),
            Section("Points", "points", (Table(("x",), (("1",),), caption="All *points*", folded=True),), 4),
            Section("Method", "method", (Bullets(("- one", "1. two")), Code("a ``` b | <c>\n  d"))),
        ),
    )


def one_paragraph(text, base=Path()):
    """A paragraph's HTML, as we write it and as a Markdown reader makes it of ours."""
    report = Report("T", "", (Section("S", "s", (Paragraph(text),)),))
    ours = as_html(report, base).split("<h2", 1)[1].split("</h2>\n", 1)[1].rsplit("\n</section>", 1)[0]
    return ours, MARKDOWN.render(as_markdown(report, base)).split("</h2>\n")[-1].rstrip("\n")


def tree(html):
    """Elements and texts of a piece of HTML, whatever its escapes are."""
    pieces = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attributes):
            pieces.append(("<", tag, {name: unquote(value) for name, value in attributes}))

        def handle_endtag(self, tag):
            pieces.append((">", tag))

        def handle_data(self, data):
            if pieces and pieces[-1][0] == "text":
                data = pieces.pop()[1] + data
            pieces.append(("text", data))

    reader = Reader(convert_charrefs=True)
    reader.feed(html)
    reader.close()
    return pieces


# ---- HTML


def test_page_is_balanced_and_whole(report, folder):
    page = Page(as_html(report, folder))
    assert page.texts("title") == page.texts("h1") == ["Evidence & <score>"]
    assert page.attributes("html", "lang") == ["en"]
    assert len(page.all("main")) == 1
    assert page.attributes("meta", "charset")[0] == "utf-8"


def test_page_loads_nothing_and_runs_nothing(report, folder):
    text = as_html(report, folder)
    page = Page(text)
    assert page.all("script", "link", "iframe", "object", "base", "form") == []
    for element in page.elements:
        for name, value in element["attributes"].items():
            assert not name.startswith("on")
            if name in ("src", "srcset", "data", "poster", "background"):
                assert value.startswith("data:image/png;base64,")
            if name == "href" and re.match("[a-z]+:|//", value):
                assert element["tag"] == "a"
                assert value == "https://example.org/a_b?c=1&d=2"
    assert not re.search(r"url\(|@import|http", STYLESHEET)
    assert "default-src 'none'" in text


def test_ids_are_unique_and_every_link_within_leads_somewhere(report, folder):
    page = Page(as_html(report, folder))
    ids = [element["attributes"]["id"] for element in page.elements if "id" in element["attributes"]]
    assert len(ids) == len(set(ids))
    targets = [href[1:] for href in page.attributes("a", "href") if href.startswith("#")]
    assert set(targets) <= set(ids)
    assert targets.count("scorecard") == 2  # beside the text, and folded above it


def test_headings_follow_the_levels(report, folder):
    page = Page(as_html(report, folder))
    headings = [(element["tag"], element["text"]) for element in page.all("h1", "h2", "h3", "h4")]
    assert [tag for tag, _ in headings] == ["h1", "h2", "h2", "h3", "h4", "h2"]


def test_tables_have_captions_scopes_and_as_many_cells_as_columns(report, folder):
    page = Page(as_html(report, folder))
    assert [caption.strip() for caption in page.texts("caption")] == ["Claims & numbers", "All *points*"]
    assert {element["attributes"]["scope"] for element in page.all("th")} == {"col", "row"}
    assert len(page.all("td")) == 2 * 3
    assert page.attributes("td", "data-label")[:2] == ["Paper", "Verdict"]


@pytest.mark.parametrize(("tone", "sign"), [("agree", "\u2713"), ("differ", "\u2717"), ("unsure", "?")])
def test_verdicts_are_told_by_a_sign_and_their_words(tone, sign):
    table = Table(("a", "b"), (("x", Cell("words", tone)),), caption="c")
    report = Report("T", "", (Section("S", "s", (table, Highlights((Highlight("7", "n", tone),)))),))
    page = Page(as_html(report, Path()))
    assert page.texts("td") == [f"{sign} words"]
    assert page.texts("strong") == [f"{sign} 7"]
    assert f"| {sign} words |" in as_markdown(report, Path())
    assert f"**{sign} 7** n" in as_markdown(report, Path())


@pytest.mark.parametrize("mode", ["RGBA", "see-through", "RGB", "L", "LA", "P", "1", "I;16"])
def test_embedded_pictures_keep_every_pixel(tmp_path, mode):
    path = made_picture(tmp_path / "a.png", mode)
    report = Report("T", "", (Section("S", "s", (Picture(Path("a.png"), "c", "alt"),)),))
    (source,) = Page(as_html(report, tmp_path)).attributes("img", "src")
    embedded = Image.open(io.BytesIO(base64.b64decode(source.removeprefix("data:image/png;base64,"))))
    original = Image.open(path)
    kind = "I;16" if mode == "I;16" else "RGBA"
    np.testing.assert_array_equal(np.asarray(original.convert(kind)), np.asarray(embedded.convert(kind)))
    assert embedded.format == "PNG"


def test_figures_take_less_room_than_their_files(tmp_path):
    """Matplotlib writes a channel that says nothing but that the figure is opaque."""
    figure = new_figure(6, 4)
    figure.add_subplot().scatter(*np.random.default_rng(0).normal(size=(2, 500)), s=4)
    save_figure(figure, tmp_path / "a.png")
    packed = read_png(tmp_path / "a.png")
    assert (packed.width_px, packed.height_px) == (720, 480)
    assert len(packed.content) < 0.95 * (tmp_path / "a.png").stat().st_size
    assert Image.open(io.BytesIO(packed.content)).mode == "RGB"


def test_pictures_that_name_one_colour_as_clear_keep_it(tmp_path):
    made_picture(tmp_path / "a.png", "RGB")
    with Image.open(tmp_path / "a.png") as plain:
        plain.load()
    plain.save(tmp_path / "a.png", transparency=plain.getpixel((3, 5)))
    report = Report("T", "", (Section("S", "s", (Picture(Path("a.png"), "c", "alt"),)),))
    (source,) = Page(as_html(report, tmp_path)).attributes("img", "src")
    embedded = Image.open(io.BytesIO(base64.b64decode(source.split(",")[1]))).convert("RGBA")
    assert embedded.getpixel((3, 5))[3] == 0
    assert np.asarray(embedded)[..., 3].any()


def test_pictures_have_size_words_and_links_to_their_files(report, folder):
    page = Page(as_html(report, folder))
    assert page.attributes("img", "alt") == ["picture a", "picture a", "picture b b", "picture c"]
    assert set(page.attributes("img", "width")) == {"60"}
    assert set(page.attributes("img", "height")) == {"40"}
    files = [href for href in page.attributes("a", "href") if href.startswith("figures")]
    assert {"figures/a.png", "figures/a.csv", "figures/b%20b.csv"} <= set(files)
    for href in files:
        assert (folder / unquote(href)).is_file()


def relative_luminance(colour):
    """WCAG 2.2, relative luminance."""
    channels = (int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5))
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


@pytest.mark.parametrize("scheme", [0, 1])
def test_colours_contrast_as_wcag_aa_asks(scheme):
    light, dark = (
        dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", block))
        for block in re.findall(r":root \{(.*?)\}", STYLESHEET, re.DOTALL)
    )
    assert light.keys() == dark.keys()
    colours = (light, dark)[scheme]
    pairs = [(ink, back) for ink in ("ink", "quiet", "link") for back in ("page", "raised")]
    pairs += [(ink, f"{tone}-back") for tone in ("agree", "differ", "unsure") for ink in (tone, "ink")]
    for ink, back in pairs:
        low, high = sorted(relative_luminance(colours[name]) for name in (ink, back))
        assert (high + 0.05) / (low + 0.05) >= 4.5, (ink, back)


# ---- Markdown


def test_markdown_tables_have_the_columns_of_their_header(report, folder):
    tokens = MARKDOWN.parse(as_markdown(report, folder))
    kinds = "".join({"tr_open": "|", "th_open": "h", "td_open": "d"}.get(token.type, "") for token in tokens)
    assert kinds.split("|")[1:] == ["hhh", "ddd", "ddd", "ddd", "hh", "dd", "dd", "dd", "h", "d"]
    read = Page(MARKDOWN.render(as_markdown(report, folder)))
    assert "a|b" in read.texts("code")
    assert [a for a in read.attributes("td", "style")[:3]] == [
        f"text-align:{a}" for a in ("left", "right", "center")
    ]


def test_markdown_reads_as_the_page(report, folder):
    page = Page(as_html(report, folder))
    read = Page(MARKDOWN.render(as_markdown(report, folder)))
    for tag in ("h1", "h3", "h4", "pre"):
        assert [text.strip() for text in read.texts(tag)] == [text.strip() for text in page.texts(tag)]
    assert [text for text in read.texts("h2") if text != "Contents"] == page.texts("h2")
    cells = [element["text"] for element in page.all("th", "td")]
    assert set(cells) <= {element["text"] for element in read.all("th", "td")}
    assert read.attributes("img", "src") == [f"figures/{name}.png" for name in ("a", "a", "b%20b", "c")]
    assert read.attributes("img", "alt") == page.attributes("img", "alt")
    assert {"- one", "1. two"} <= set(read.texts("li"))


def test_markdown_contents_lead_to_anchors(report, folder):
    text = as_markdown(report, folder)
    linked = re.findall(r"^ *- \[.*\]\(#(.*)\)$", text, re.MULTILINE)
    assert linked == re.findall(r'^<a id="(.*)"></a>$', text, re.MULTILINE)
    assert linked == ["summary", "scorecard", "fig-22", "points", "method"]
    assert "\n    - [Points](#points)\n" in text


def test_lists_next_to_each_other_stay_two():
    blocks = (Highlights((Highlight("17", "agree"),)), Bullets(("one", "two")))
    report = Report("T", "", (Section("S", "s", blocks),))
    assert (
        len(Page(MARKDOWN.render(as_markdown(report, Path()))).all("ul")) == 1 + 2
    )  # the contents, and these


# ---- inline text


@pytest.mark.parametrize(
    ("text", "html"),
    [
        (
            "a **b** `c|d` [e](https://x.org)",
            '<p>a <strong>b</strong> <code>c|d</code> <a href="https://x.org">e</a></p>',
        ),
        ("**`x` and [y](#z)**", '<p><strong><code>x</code> and <a href="#z">y</a></strong></p>'),
        ("`` a`b ``", "<p><code>a`b</code></p>"),
        ("`**a** [b](c) <d> &amp;`", "<p><code>**a** [b](c) &lt;d&gt; &amp;amp;</code></p>"),
        ("2 ** 3, `open, [a] (b)", "<p>2 ** 3, `open, [a] (b)</p>"),
        (r"\**a\** \`b\` \[c](d) \e", r"<p>**a** `b` [c](d) \e</p>"),
        ("[a](figures/b(1).csv)", '<p><a href="figures/b(1).csv">a</a></p>'),
        ('[a](https://x.org/"<>|)', '<p><a href="https://x.org/%22%3C%3E%7C">a</a></p>'),
        ("flda_3 and _this_ and <b>", "<p>flda_3 and _this_ and &lt;b&gt;</p>"),
        ("see![a](#b)", '<p>see!<a href="#b">a</a></p>'),
        ("a\n\n  b\tc\x00", "<p>a b c</p>"),
        ("20\u2009000\u00a0lx", "<p>20\u2009000\u00a0lx</p>"),
    ],
)
def test_inline_markup(text, html):
    ours, theirs = one_paragraph(text)
    assert ours == html
    assert tree(theirs) == tree(html)


@pytest.mark.parametrize(
    "start",
    [
        "# a",
        "- a",
        "+ a",
        "1. a",
        "12) a",
        "> a",
        "---",
        "===",
        "***",
        "~~~",
        "```",
        "    a",
        "|a|",
        "[a]: b",
    ],
)
def test_lines_that_look_like_markdown_are_words(start):
    ours, theirs = one_paragraph(literal(start))
    assert tree(theirs) == tree(ours)


def test_a_number_is_left_legible():
    report = Report("T", "", (Section("S", "s", (Paragraph("5.0e-4 of flda_3, 24 % (1.2 to 3)"),)),))
    assert "\n5.0e-4 of flda_3, 24 % (1.2 to 3)\n" in as_markdown(report, Path())


@pytest.mark.parametrize(
    "url",
    [
        "javascript:alert",
        "data:text/html,x",
        "//x.org",
        "/etc/passwd",
        "file:///a",
        "JavaScript:x",
        "vbscript:x",
    ],
)
def test_links_to_elsewhere_are_refused(url):
    report = Report("T", "", (Section("S", "s", (Paragraph(f"[a]({url})"),)),))
    for write in (as_html, as_markdown):
        with pytest.raises(VoccError, match=r"^link .* must be http, https, #anchor or a relative path$"):
            write(report, Path())


PLAIN = st.text(st.sampled_from("ab1 é<>&;|`*_[]()!#~$\\\"'-+.:/%{}\u2009\u2013"), max_size=14)


@settings(max_examples=300, deadline=None)
@given(PLAIN)
def test_words_of_any_kind_come_through_both(text):
    words = re.sub(" +", " ", text).strip(" ")
    ours, theirs = one_paragraph(f"x {literal(text)} x")
    expected = f"x {words} x" if words else "x x"
    assert tree(ours) == tree(theirs) == [("<", "p", {}), ("text", expected), (">", "p")]


@settings(max_examples=300, deadline=None)
@given(PLAIN, PLAIN)
def test_cells_of_any_words_stay_cells(first, second):
    code = second.replace("`", "")
    table = Table(
        (literal(first), "b"), ((literal(second), f"`x{code}x` **{literal(first)}x**"),), caption="c"
    )
    report = Report("T", "", (Section("S", "s", (table,)),))
    ours = Page(as_html(report, Path()))
    read = Page(MARKDOWN.render(as_markdown(report, Path())))
    # A Markdown reader may cut thin spaces at a cell's ends.
    texts = [[e["text"].strip() for e in page.all("th", "td")] for page in (ours, read)]
    assert texts[0] == texts[1]
    assert ours.texts("code") == read.texts("code") == [re.sub(" +", " ", f"x{code}x")]


PIECES = st.one_of(
    PLAIN.map(literal),
    st.sampled_from(
        ["`a`", "`` b`c ``", "`d|e`", "`\\`", "**f**", "**`g`**", "**h!**", "[i](#j)", "[**k**](l.csv)", "!"]
    ),
    st.sampled_from(["[m](https://n.org/?o=1&lt;=2)", "**[p](q/r.csv)**", "[`s|t`](u.csv)", " ", "v"]),
)


@settings(max_examples=400, deadline=None)
@given(st.lists(PIECES, max_size=6).map("".join))
def test_any_inline_text_is_the_same_in_both(text):
    ours, theirs = one_paragraph(f"x {text} x")
    assert tree(theirs) == tree(ours)


@pytest.mark.parametrize("write", [as_html, as_markdown])
def test_nasty_words_are_escaped_everywhere(folder, write):
    nasty = literal(NASTY)
    blocks = (
        Paragraph(nasty),
        Bullets((nasty,)),
        Highlights((Highlight(NASTY, nasty),)),
        Table((nasty, nasty), ((nasty, Cell(nasty, "agree")),), caption=nasty),
        Table((nasty,), ((nasty,),), caption=nasty, folded=True),
        Picture(Path("figures/a.png"), nasty, NASTY),
        Pictures((Picture(Path("figures/a.png"), nasty, NASTY),), 1),
        Code(NASTY),
    )
    text = write(Report(NASTY, nasty, (Section(NASTY, "s", blocks),)), folder)
    page = Page(text if write is as_html else MARKDOWN.render(text))
    for tag in ("h1", "h2", "p", "li", "th", "td", "strong", "pre"):
        assert any(NASTY in words for words in page.texts(tag)), tag
    assert page.attributes("img", "alt") == [NASTY, NASTY]
    assert page.all("em", "s", "b") == []
    assert any(NASTY in words for words in page.texts("summary"))


# ---- what is refused


def section(*blocks, anchor="s", level=2):
    return Section("S", anchor, blocks, level)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Cell("a", "good"),
            r"^Cell.tone is 'good': it must be one of None, 'agree', 'differ', 'unsure'$",
        ),
        (lambda: Highlight("1", "a", "good"), r"^Highlight.tone is 'good'"),
        (lambda: Table((), ()), r"^Table.header is empty"),
        (lambda: Table(("a",), ()), r"^Table.caption is empty: the table of 'a'"),
        (
            lambda: Table(("a", "b"), (("1", "2"), ("1",)), caption="c"),
            r"^Table.rows\[1\] has 1 cells: the header has 2$",
        ),
        (lambda: Table(("a", "b"), (), ("left",), "c"), r"^Table.align has 1 entries: the header has 2$"),
        (lambda: Table(("a",), (), ("middle",), "c"), r"^Table.align is 'middle'"),
        (lambda: Picture(Path("a.png"), "c", " "), r"^Picture.alt is empty: say in words what a.png shows$"),
        (lambda: Pictures(()), r"^Pictures.pictures is empty"),
        (lambda: Pictures((picture(),), 5), r"^Pictures.columns is 5: it must be one of 1, 2, 3, 4$"),
        (lambda: Section(" ", "a", ()), r"^Section.title is empty: the section 'a'"),
        (lambda: section(anchor="Fig 22"), r"^Section.anchor is 'Fig 22': use small letters"),
        (lambda: section(anchor="_text"), r"^Section.anchor is '_text'"),
        (lambda: section(level=1), r"^Section.level is 1: it must be one of 2, 3, 4$"),
        (lambda: Report("", "", ()), r"^Report.title is empty"),
        (lambda: Report("T", "", (section(), section())), r"^Report.sections has the anchor 's' twice"),
        (
            lambda: Report("T", "", (section(level=3),)),
            r"^Section.level of 's' is 3 after 1: no level may be skipped$",
        ),
        (
            lambda: Report("T", "", (section(), section(anchor="b", level=4))),
            r"^Section.level of 'b' is 4 after 2",
        ),
    ],
)
def test_what_makes_no_report_is_refused(make, message):
    with pytest.raises(VoccError, match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def with_picture(path, data=None):
    return Report("T", "", (section(Picture(Path(path), "c", "alt", None if data is None else Path(data))),))


@pytest.mark.parametrize(
    ("path", "data", "message"),
    [
        ("figures/none.png", None, r"^figures/none.png is not in .*: write it before the report$"),
        ("figures/a.png", "none.csv", r"^none.csv is not in .*: write it before the report$"),
        ("../a.png", None, r"^../a.png leads out of the report's folder"),
        ("/a.png", None, r"^/a.png leads out of the report's folder"),
        ("figures", None, r"^figures is not in "),
    ],
)
@pytest.mark.parametrize("write", [as_html, as_markdown])
def test_missing_files_are_refused_by_name(folder, path, data, message, write):
    with pytest.raises(VoccError, match=message) as refusal:
        write(with_picture(path, data), folder)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n", None])
def test_what_is_no_png_is_refused_by_name(folder, content):
    path = folder / "figures" / "a.png"
    path.write_bytes(path.read_bytes()[:900] if content is None else content)
    with pytest.raises(VoccError, match=r"a\.png") as refusal:
        as_html(with_picture("figures/a.png"), folder)
    assert "\n" not in str(refusal.value)


# ---- the files


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_both_files_are_written_and_replaced(report, folder):
    for _ in range(2):
        markdown, page = write_report(report, str(folder))
        assert markdown.read_text(encoding="utf-8") == as_markdown(report, folder)
        assert page.read_text(encoding="utf-8") == as_html(report, folder)
    assert names(folder) == ["figures", "report.html", "report.md"]


def test_a_name_that_is_no_unicode_does_not_stop_the_report(tmp_path):
    write_report(Report("T", "\udce9 of a file's name", ()), tmp_path)
    assert "? of a file" in (tmp_path / "report.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("file", ["report.md", "report.html"])
def test_a_full_disk_leaves_the_old_reports_whole(report, folder, monkeypatch, file):
    old = [path.read_bytes() for path in write_report(Report("Old", "", ()), folder)]
    before = Path.write_bytes

    def full(path, content):
        if path.name.startswith(f".{Path(file).stem}.") and path.suffix == Path(file).suffix:
            before(path, content[:10])
            raise OSError(errno.ENOSPC, "No space left on device")
        return before(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(VoccError, match=rf"^cannot write .*{file}: No space left on device$"):
        write_report(report, folder)
    assert [(folder / name).read_bytes() for name in ("report.md", "report.html")] == old
    assert names(folder) == ["figures", "report.html", "report.md"]


def test_a_disk_that_is_full_late_leaves_whole_reports(report, folder, monkeypatch):
    old = [path.read_bytes() for path in write_report(Report("Old", "", ()), folder)]

    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(VoccError, match=r"^cannot write "):
        write_report(report, folder)
    assert [(folder / name).read_bytes() for name in ("report.md", "report.html")] == old


def test_a_missing_picture_leaves_the_old_reports_whole(folder):
    old = [path.read_bytes() for path in write_report(Report("Old", "", ()), folder)]
    with pytest.raises(VoccError, match=r"^none\.png"):
        write_report(with_picture("none.png"), folder)
    assert [(folder / name).read_bytes() for name in ("report.md", "report.html")] == old
