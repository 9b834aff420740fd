"""A report's words from a Jinja2 template, and its Markdown as one HTML page."""

import base64
import io
import re
import textwrap
from functools import lru_cache
from html import escape
from pathlib import Path
from urllib.parse import unquote

import jinja2
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup
from PIL import Image, UnidentifiedImageError

from vocc_torch.errors import VoccError
from vocc_torch.files import read_file
from vocc_torch.report.styles import rate_text

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


def render(package: str, template: str, **values: object) -> str:
    """Fill in a template. In ``*.md.j2`` Markdown marks in values are escaped.

    What is Markdown already passes through Jinja's ``safe``; the filters ``md``, ``code`` and ``block``
    return Markdown. A further filter is ``rate`` ("1.5e-5").

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
        is_markdown = str(context.name).endswith(".md.j2")
        return md(value) if is_markdown and not hasattr(value, "__html__") else value

    filled = jinja2.Environment(
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        finalize=escaped,
        # Values of ``*.md.j2`` come here as Markdown already, and stay what they are.
        autoescape=lambda name: str(name).endswith((".md.j2", ".html.j2")),
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader(name, "") for name in (package, __package__)]
        ),
    )
    filled.filters |= {"md": md, "code": code, "block": block, "rate": rate_text}
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
    return Markup(escape(text, quote=False))


def code(value: object) -> Markup:
    r"""Write words as inline code, or as plain words where they hold what would end it.

    Example:
        >>> print(code("a b"), code("a `b`"))
        `a b` a \`b\`
    """
    text = _one_line(str(value))
    # A table is parted at every pipe, and code keeps its backslashes.
    return md(text) if not text or {*"|`"} & {*text} else Markup(f"`{text}`")


def block(value: object) -> Markup:
    """Write lines as they are, such as commands, each behind four blanks."""
    return Markup(textwrap.indent(str(value).rstrip(), "    ", lambda _: True))


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

    No HTML in the text gets through. Headings have their :func:`slug` for links. Cells and items that begin
    with a sign of ``SIGNS`` are coloured.

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
    for place, token in enumerate(tokens):
        if token.type != "inline":
            continue
        for picture in token.children or ():
            if picture.type == "image":
                embed(picture, Path(folder))
        # A short item's words stand in a paragraph that is not shown.
        parent = tokens[place - 1 - tokens[place - 1].hidden]
        if parent.type == "heading_open":
            parent.attrSet("id", slug(token.content))
        for tone, sign in SIGNS.items():
            if token.content.lstrip("*").startswith(f"{sign} "):
                parent.attrSet("class", tone)
    body = Markup(reader.renderer.render(tokens, reader.options, {}))
    return render(__package__, "page.html.j2", title=_one_line(title), body=body)


def embed(picture: Token, folder: Path) -> None:
    """Put a PNG file's content in the place of its name.

    Raises:
        VoccError: the picture is not in the folder, cannot be read or is no PNG file.
    """
    name = unquote(str(picture.attrs["src"]))
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise VoccError(
            f"{name} leads out of the report's folder: give a path inside it, such as fig22.png"
        )
    content = read_file(folder / name, "picture")
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as shown:
            size = {"width": shown.width, "height": shown.height}
    except UnidentifiedImageError as error:
        raise VoccError(f"{name} is not a PNG picture: {error}") from error
    source = f"data:image/png;base64,{base64.b64encode(content).decode()}"
    picture.attrs |= {"src": source, **size}
