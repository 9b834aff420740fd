"""A report's words from a Jinja2 template, and its Markdown as one HTML page."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from urllib.parse import unquote

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, pass_context
from jinja2.runtime import Context
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup
from PIL import Image, UnidentifiedImageError

from vocc_torch.errors import VoccError
from vocc_torch.show.text_table import ends_text, rate_text

SIGNS = {"agree": "\N{CHECK MARK}", "differ": "\N{BALLOT X}", "unsure": "?"}
"""What stands before a toned text, so that no verdict is told by colour alone."""
_MARKS = re.compile(r"([\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])|!$)")
"""What means something to Markdown in a line; an underscore within a word does not, nor does an exclamation
mark, unless a link follows it."""
_LINE_START = re.compile(r"^(\d{1,9}(?=[.)](?: |$))|(?=(?:[+=-]+|#{1,6})(?: |$)))")
"""What means something to Markdown at the start of a line: headings, lists and rules."""
_NOT_WORDS = re.compile(r"[\s\x00-\x1f\x7f-\x9f]+")
_ANCHOR = re.compile(r'<a id="([a-z0-9-]+)"></a>')
_FOLD = re.compile(r"<details>\n<summary>([^<>]*)</summary>")
_WORDY = 40
"""Characters of a cell's text from which a narrow screen shows the rows of its table as cards."""
_PINNED_COLUMNS = 5
"""Most columns of a table of long texts that always fit beside the contents, with its head kept in sight."""


def render(package: str, template: str, **values: object) -> str:
    """Fill in a template. In ``*.md.j2`` every value stands for itself, whatever marks it holds.

    What is Markdown already passes through Jinja's ``safe``; the filters ``md``, ``code`` and ``fence``
    return Markdown. Further filters: ``rate`` ("1.5e-5"), ``interval`` ("1.5e-5 to 1.2e-2", of anything with
    ``low`` and ``high``), ``slug`` (a heading's name in links). In a ``<summary>`` use ``e`` instead.

    Args:
        package: package whose folder has the template; those of ``vocc_torch.show`` can be included too.
        template: the file's name, such as ``report.md.j2``.
        values: what the template may name.

    Raises:
        jinja2.TemplateError: no such template, or it names a value that is not given.
    """
    return _environment(package).get_template(template).render(values)


@lru_cache
def _environment(package: str) -> Environment:
    """Set Jinja up for the templates of a package."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, "") for name in (package, __package__)]),
        # Values of ``*.md.j2`` come here as Markdown already, and stay what they are.
        autoescape=lambda name: name is not None and name.endswith((".md.j2", ".html.j2")),
        finalize=_finalize,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"md": md, "code": code, "fence": fence, "slug": slug, "rate": rate_text}
    environment.filters["interval"] = lambda of: ends_text(of.low, of.high)
    environment.globals["SIGNS"] = SIGNS
    return environment


@pass_context
def _finalize(context: Context, value: object) -> object:
    """Escape a value that a Markdown template writes."""
    markdown = context.name is not None and context.name.endswith(".md.j2")
    return md(value) if markdown and not hasattr(value, "__html__") else value


def md(value: object) -> Markup:
    r"""Write plain words as one line of Markdown that stands for itself.

    Example:
        >>> print(md("**a** [b](c) <script> flda_3"))
        \*\*a\*\* \[b\](c) &lt;script&gt; flda_3
    """
    text = _LINE_START.sub(r"\1\\", _MARKS.sub(r"\\\1", _one_line(str(value))))
    return Markup(text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;"))


def code(value: object) -> Markup:
    """Write words as inline code, between more backticks than they hold in a row.

    Example:
        >>> print(code("a `b`"))
        `` a `b` ``
    """
    text = _one_line(str(value))
    if not text or "|" in text:  # a table is parted at every pipe, and code keeps its backslashes
        return md(text)
    fence = "`" * (1 + _longest_row(text))
    blank = " " if text[0] in "` " or text[-1] in "` " else ""
    return Markup(f"{fence}{blank}{text}{blank}{fence}")


def fence(value: object) -> Markup:
    """Write lines as they are, such as commands, between fences longer than any row of backticks in them."""
    text = str(value).rstrip()
    marks = "`" * max(3, 1 + _longest_row(text))
    return Markup(f"{marks}text\n{text}\n{marks}")


def slug(heading: str) -> str:
    """Name a heading in links, as GitHub does.

    Example:
        >>> slug("Fig. 22: bit error rates")
        'fig-22-bit-error-rates'
    """
    return re.sub(r"[^\w\- ]", "", _one_line(heading).lower()).replace(" ", "-")


def _one_line(text: str) -> str:
    """Put text on one line: each run of blanks, line ends and control characters becomes one blank."""
    return _NOT_WORDS.sub(" ", text).strip(" ")


def _longest_row(text: str) -> int:
    """Count the backticks in the longest row of them."""
    return max(map(len, re.findall("`+", text)), default=0)


def html(markdown: str, title: str, folder: str | Path) -> str:
    r"""Write Markdown as one HTML page that needs nothing else: style and pictures are inside.

    No HTML in the text gets through, but for lines that are an anchor (``<a id="fig-22"></a>``) or fold what
    follows (``<details>``, with ``<summary>``). Headings without an anchor take their :func:`slug`. The list
    under a heading "Contents" goes beside the text. A paragraph that begins with a picture is a figure with
    its caption. A list of asterisks is a summary's numbers. Cells and items that begin with a sign of
    ``SIGNS`` are coloured.

    Args:
        markdown: the text, with tables as GitHub has them.
        title: the page's title.
        folder: where the page will lie; pictures are relative to it.

    Raises:
        VoccError: a picture is not in the folder or is no PNG file.

    Example:
        >>> page = html("# Evidence\n\n## Results\n\na < b <script>", "Evidence", ".")
        >>> '<h2 id="results">Results</h2>' in page, "<p>a &lt; b &lt;script&gt;</p>" in page
        (True, True)
    """
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(markdown)
    _allow_marks(tokens)
    _name_headings(tokens)
    _pictures(tokens, Path(folder))
    _tables(tokens)
    _highlights(tokens)
    head, contents, body = _parts(tokens)
    texts = {
        name: Markup(reader.renderer.render(part, reader.options, {}))
        for name, part in {"header": head, "contents": contents, "body": body}.items()
    }
    style = Markup(files(__package__).joinpath("page.css").read_text("utf-8"))
    return render(__package__, "page.html.j2", title=_one_line(title), style=style, **texts)


def _allow_marks(tokens: list[Token]) -> None:
    """Let lines through that are an anchor, or begin or end what is folded."""
    for place, token in enumerate(tokens):
        if token.type != "inline" or tokens[place - 1].type != "paragraph_open":
            continue
        if _ANCHOR.fullmatch(token.content) or token.content == "</details>":
            allowed = token.content
        elif folded := _FOLD.fullmatch(token.content):
            allowed = f'<details class="folded">\n<summary>{folded[1]}</summary>'
        else:
            continue
        tokens[place] = Token("html_block", "", 0, content=f"{allowed}\n")
        # A paragraph of nothing: hidden tokens write nothing.
        tokens[place - 1].hidden = tokens[place + 1].hidden = True


def _name_headings(tokens: Sequence[Token]) -> None:
    """Give headings their names in links, where no anchor stands before them."""
    taken: set[str] = set()
    for place, token in enumerate(tokens):
        if token.type == "html_block" and (anchor := _ANCHOR.match(token.content)):
            taken.add(anchor[1])
        elif token.type == "heading_open" and not _anchored(tokens, place):
            name = base = slug(_words(tokens[place + 1]))
            number = 0
            while name in taken:
                number += 1
                name = f"{base}-{number}"
            taken.add(name)
            token.attrSet("id", name)


def _anchored(tokens: Sequence[Token], place: int) -> bool:
    """Say whether an anchor stands before the heading: a paragraph's open and close lie around it."""
    return place >= 3 and _ANCHOR.match(tokens[place - 2].content) is not None


def _words(inline: Token) -> str:
    """Join the words of a line, whatever they are."""
    return "".join(" " if child.type == "softbreak" else child.content for child in inline.children or ())


def _pictures(tokens: Sequence[Token], folder: Path) -> None:
    """Put pictures into the page, as figures with the captions that follow them."""
    for place, token in enumerate(tokens):
        children = token.children or []
        for child in children:
            if child.type == "image":
                _put_in(child, folder)
        if not children or children[0].type != "image":
            continue
        tokens[place - 1].tag = tokens[place + 1].tag = "figure"
        caption = children[1:]
        if caption and caption[0].type == "softbreak":
            caption = caption[1:]
        marks = [Token("html_inline", "", 0, content=mark) for mark in ("\n<figcaption>", "</figcaption>")]
        token.children = [children[0], marks[0], *caption, marks[1]] if caption else children


def _put_in(image: Token, folder: Path) -> None:
    """Put a PNG file's content in the place of its name."""
    name = unquote(str(image.attrs["src"]))
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise VoccError(f"{name} leads out of the report's folder: give a path inside it, such as fig22.png")
    if not path.is_file():
        raise VoccError(f"{name} is not in {folder}: write it before the report")
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            width_px, height_px = picture.size
        content = base64.b64encode(path.read_bytes()).decode("ascii")
    except (UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise VoccError(f"{name} is not a PNG picture: {error}") from error
    except OSError as error:
        raise VoccError(f"cannot read {path}: {error.strerror or error}") from error
    image.attrs |= {"src": f"data:image/png;base64,{content}", "width": width_px, "height": height_px}


def _tables(tokens: list[Token]) -> None:
    """Name rows by their first cells, colour what a sign stands before, and say how narrow screens go on."""
    header: list[str] = []
    opened, column, wordy = tokens[:1], 0, False
    for place, token in enumerate(tokens):
        if token.type == "table_open":
            opened, header, wordy = [token], [], False
        elif token.type == "tr_open":
            column = 0
        elif token.type in ("th_open", "td_open"):
            _set_align(token)
        if token.type == "th_open":
            header.append(_words(tokens[place + 1]))
            token.attrSet("scope", "col")
        elif token.type == "td_open":
            cell = tokens[place + 1]
            wordy |= len(_words(cell)) >= _WORDY
            if column == 0:
                token.tag = tokens[place + 2].tag = "th"
                token.attrSet("scope", "row")
            else:
                token.attrSet("data-label", header[column])
            if tone := _tone(_words(cell)):
                marks = (f'<span class="tone {tone}">', "</span>")
                begin, end = (Token("html_inline", "", 0, content=mark) for mark in marks)
                cell.children = [begin, *(cell.children or ()), end]
            column += 1
        elif token.type == "table_close":
            kind = "table wordy" if wordy else "table"
            opened[0].meta["kind"] = f"{kind} pinned" if wordy and len(header) <= _PINNED_COLUMNS else kind
    _wrap_tables(tokens)


def _set_align(cell: Token) -> None:
    """Say a cell's alignment as a class, which the style may overrule on narrow screens."""
    if align := str(cell.attrs.pop("style", "")).removeprefix("text-align:"):
        cell.attrSet("class", align)


def _wrap_tables(tokens: list[Token]) -> None:
    """Put each table into a box that scrolls where the screen is narrow."""
    for place in reversed(range(len(tokens))):
        if tokens[place].type == "table_close":
            tokens.insert(place + 1, Token("html_block", "", 0, content="</div>\n"))
        elif tokens[place].type == "table_open":
            opened = f'<div class="{tokens[place].meta["kind"]}" tabindex="0">\n'
            tokens.insert(place, Token("html_block", "", 0, content=opened))


def _tone(text: str) -> str | None:
    """Find the tone of a text by the sign before it."""
    return next((tone for tone, sign in SIGNS.items() if text.startswith(f"{sign} ")), None)


def _highlights(tokens: Sequence[Token]) -> None:
    """Show a list of asterisks as a summary's numbers; lists of hyphens stay lists."""
    for place, token in enumerate(tokens):
        if token.markup != "*":
            continue
        if token.type == "bullet_list_open":
            token.attrSet("class", "highlights")
        # An item, its paragraph, and the paragraph's line.
        elif token.type == "list_item_open" and (tone := _tone(_words(tokens[place + 2]))):
            token.attrSet("class", tone)


def _parts(tokens: Sequence[Token]) -> tuple[Sequence[Token], Sequence[Token], Sequence[Token]]:
    """Part the title with what stands under it, the list of contents, and the text."""
    chapters = [
        place for place, token in enumerate(tokens) if token.type == "heading_open" and token.tag == "h2"
    ]
    if not chapters:
        return tokens[:3], (), tokens[3:]
    first = chapters[0]
    if tokens[first + 1].content == "Contents":
        # The heading is three tokens; its list ends where nesting comes back to the top.
        end = next(
            place
            for place in range(first + 3, len(tokens))
            if tokens[place].type == "bullet_list_close" and tokens[place].level == 0
        )
        return tokens[:first], tokens[first + 3 : end + 1], tokens[end + 1 :]
    start = first - 3 if _anchored(tokens, first) else first
    return tokens[:start], (), tokens[start:]
