"""A report's words from a Jinja2 template, and its Markdown as one HTML page."""

import base64
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

import jinja2
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup
from PIL import Image, UnidentifiedImageError

from vocc_torch.errors import VoccError
from vocc_torch.report.styles import ends_text, rate_text

SIGNS = {"agree": "\N{CHECK MARK}", "differ": "\N{BALLOT X}", "unsure": "?"}
"""What stands before a toned text, so that no verdict is told by colour alone."""
_MARKS = re.compile(r"([\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])|!$)")
"""What means something to Markdown in a line; an underscore within a word does not, nor does an exclamation
mark, unless a link follows it."""
_LINE_START = re.compile(
    r"^( ?(?:\d{1,9}(?=[.)](?: |$))|(?=(?:[+=-]+|#{1,6})(?: |$))))"
)
"""What means something to Markdown at the start of a line: headings, lists and rules."""
_NOT_WORDS = re.compile(r"(?:[^\S\N{NO-BREAK SPACE}]|[\x00-\x1f\x7f-\x9f])+")
_ANCHOR = re.compile(r'<a id="([a-z0-9-]+)"></a>')
_FOLD = re.compile(r"</details>|<details>\n<summary>[^<>]*</summary>")


def render(package: str, template: str, **values: object) -> str:
    """Fill in a template. In ``*.md.j2`` every value stands for itself, whatever marks it holds.

    What is Markdown already passes through Jinja's ``safe``; the filters ``md``, ``code`` and ``fence``
    return Markdown. Further filters: ``rate`` ("1.5e-5"), ``interval`` ("1.5e-5 to 1.2e-2", of anything with
    ``low`` and ``high``), ``slug`` (a heading's name in links). In a ``<summary>`` use ``e`` instead.

    Args:
        package: package whose folder has the template; those of ``vocc_torch.report`` can be included too.
        template: the file's name, such as ``report.md.j2``.
        values: what the template may name.

    Raises:
        jinja2.TemplateError: no such template, or it names a value that is not given.
    """
    return environment(package).get_template(template).render(values)


@lru_cache
def environment(package: str) -> jinja2.Environment:
    """Set Jinja up for the templates of a package, as :func:`render` says."""

    @jinja2.pass_context
    def escaped(context: jinja2.runtime.Context, value: object) -> object:
        markdown = context.name is not None and context.name.endswith(".md.j2")
        return md(value) if markdown and not hasattr(value, "__html__") else value

    filled = jinja2.Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    filled.undefined, filled.finalize = jinja2.StrictUndefined, escaped
    filled.loader = jinja2.ChoiceLoader(
        [jinja2.PackageLoader(name, "") for name in (package, __package__)]
    )
    # Values of ``*.md.j2`` come here as Markdown already, and stay what they are.
    filled.autoescape = lambda name: (
        name is not None and name.endswith((".md.j2", ".html.j2"))
    )
    filled.filters |= {
        "md": md,
        "code": code,
        "fence": fence,
        "slug": slug,
        "rate": rate_text,
    }
    filled.filters["interval"] = lambda of: ends_text(of.low, of.high)
    filled.globals["SIGNS"] = SIGNS
    return filled


def md(value: object) -> Markup:
    r"""Write plain words as one line of Markdown that stands for itself.

    Example:
        >>> print(md("**a** [b](c) <script> flda_3"))
        \*\*a\*\* \[b\](c) &lt;script&gt; flda_3
    """
    text = _MARKS.sub(r"\\\1", _NOT_WORDS.sub(" ", str(value)))
    text = _LINE_START.sub(r"\1\\", text)
    return Markup(text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;"))


def code(value: object) -> Markup:
    """Write words as inline code, between more backticks than they hold in a row.

    Example:
        >>> print(code("a `b`"))
        `` a `b` ``
    """
    text = _one_line(str(value))
    if (
        not text or "|" in text
    ):  # a table is parted at every pipe, and code keeps its backslashes
        return md(text)
    marks = _backticks(text, 1)
    blank = " " if text[0] in "` " or text[-1] in "` " else ""
    return Markup(f"{marks}{blank}{text}{blank}{marks}")


def fence(value: object) -> Markup:
    """Write lines as they are, such as commands, between fences longer than any row of backticks in them."""
    text = str(value).rstrip()
    marks = _backticks(text, 3)
    return Markup(f"{marks}text\n{text}\n{marks}")


def _backticks(text: str, least: int) -> str:
    """Give so many backticks, or one more than the longest row of them in a text."""
    return max(["`" * least, *(f"{row}`" for row in re.findall("`+", text))], key=len)


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
    tokens = list(dressed(reader.parse(markdown), Path(folder)))
    kinds = [(token.type, token.tag) for token in tokens]
    first = end = (
        kinds.index(heading)
        if (heading := ("heading_open", "h2")) in kinds
        else len(tokens)
    )
    if first < len(tokens) and _words(tokens[first + 1]) == "Contents":
        # The heading is three tokens; its list ends where the next heading or its anchor begins.
        ends = (
            at
            for at in range(first, len(tokens))
            if kinds[at][0] == "bullet_list_close"
        )
        end = 1 + next(at for at in ends if not tokens[at].level)
    elif first >= 3 and _ANCHOR.fullmatch(tokens[first - 2].content):
        first = end = first - 3
    parts = {
        "header": tokens[:first],
        "contents": tokens[first + 3 : end],
        "body": tokens[end:],
    }
    texts = {
        name: Markup(reader.renderer.render(part, reader.options, {}))
        for name, part in parts.items()
    }
    style = Markup(Path(__file__).with_name("page.css").read_text("utf-8"))
    return render(
        __package__, "page.html.j2", title=_one_line(title), style=style, **texts
    )


def _words(line: Token) -> str:
    """Join the words of a line, whatever they are."""
    return "".join(
        " " if child.type == "softbreak" else child.content
        for child in line.children or ()
    )


def _tone(line: Token) -> dict[str, str]:
    """Give the class of a line's tone by the sign before it."""
    words = _words(line)
    return next(
        (
            {"class": tone}
            for tone, sign in SIGNS.items()
            if words.startswith(f"{sign} ")
        ),
        {},
    )


def dressed(tokens: Sequence[Token], folder: Path) -> Iterator[Token]:
    """Dress a report's tokens for its page: anchors, folds, figures with captions, links, tones, wide tables.

    Args:
        tokens: of the Markdown text; they are changed.
        folder: where its pictures are.

    Raises:
        VoccError: as :func:`embed`.
    """
    slugs: list[str] = []
    for at, token in enumerate(tokens):
        kind, line = token.type, tokens[min(at + 1, len(tokens) - 1)]
        for picture in (
            child for child in token.children or () if child.type == "image"
        ):
            embed(picture, folder)
        if kind == "paragraph_open" and (
            _ANCHOR.fullmatch(line.content) or _FOLD.fullmatch(line.content)
        ):
            token.hidden = tokens[at + 2].hidden = True
            allowed = line.content.replace("<details>", '<details class="folded">')
            line.children = [Token("html_inline", "", 0, content=f"{allowed}\n")]
        elif (
            kind == "paragraph_open"
            and line.children
            and line.children[0].type == "image"
        ):
            token.tag = tokens[at + 2].tag = "figure"
            line.children.insert(
                1, Token("html_inline", "", 0, content="\n<figcaption>")
            )
            line.children.append(Token("html_inline", "", 0, content="</figcaption>"))
        elif kind == "heading_open" and (
            at < 3 or not _ANCHOR.fullmatch(tokens[at - 2].content)
        ):
            slugs.append(name := slug(_words(line)))
            token.attrSet(
                "id", f"{name}-{slugs.count(name) - 1}" if name in slugs[:-1] else name
            )
        elif kind == "bullet_list_open" and token.markup == "*":
            token.attrSet("class", "highlights")
        elif kind == "list_item_open" and token.markup == "*":
            token.attrs |= _tone(tokens[at + 2])
        elif kind == "td_open":
            token.attrs |= _tone(line)
        elif kind == "tr_open" and line.type == "td_open":
            line.tag = tokens[at + 3].tag = "th"
            line.attrSet("scope", "row")
        elif kind == "table_open":
            yield Token(
                "html_block", "", 0, content='<div class="table" tabindex="0">\n'
            )
        yield token
        if kind == "table_close":
            yield Token("html_block", "", 0, content="</div>\n")


def embed(picture: Token, folder: Path) -> None:
    """Put a PNG file's content in the place of its name.

    Raises:
        VoccError: the picture is not in the folder or is no PNG file.
    """
    name = unquote(str(picture.attrs["src"]))
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise VoccError(
            f"{name} leads out of the report's folder: give a path inside it, such as fig22.png"
        )
    try:
        content = (folder / name).read_bytes()
        with Image.open(folder / name, formats=["PNG"]) as shown:
            size = {"width": shown.width, "height": shown.height}
    except UnidentifiedImageError as error:
        raise VoccError(f"{name} is not a PNG picture: {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise VoccError(
            f"cannot read {folder / name}: {reason}: write it before the report"
        ) from error
    picture.attrs |= {
        "src": f"data:image/png;base64,{base64.b64encode(content).decode()}",
        **size,
    }
