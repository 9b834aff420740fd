"""Inline text: code, bold and links in a line of words, and nothing else."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal
from urllib.parse import quote

from vocc_torch.errors import VoccError

_MARKUP = re.compile(
    r"""
      \\(?P<literal>[\\`*\[\]])
    | (?P<fence>`+) (?P<code>.+?) (?<!`)(?P=fence)(?!`)
    | \*\* (?P<bold>(?=\S) (?:\\.|`[^`]*`|\*(?!\*)|[^*\\])+? (?<=\S)) \*\*
    | \[ (?P<label>(?=[^\]]*[^\]\s]) (?:\\.|`[^`]*`|[^\]\\])+) \] \( (?P<url>(?:[^()\s]|\([^()\s]*\))+) \)
    """,
    re.VERBOSE,
)
_NOT_WORDS = re.compile(r"[\x00-\x20\x7f]+")
"""Blanks, line ends and control characters; thin and no-break spaces stay as they are."""
_ADDRESS = re.compile(r"https?://[^/]|#[a-z]|[\w.%~-]+(/|[?#]|$)", re.IGNORECASE)
"""How a web address, an anchor of the report or a relative path begins."""
_URL_SAFE = ":/?#[]@!$&'()*+,;=%"


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of inline text.

    Args:
        kind: what it is.
        text: the words of a text or a code; empty for the other kinds.
        parts: what stands in a bold or a link.
        url: where a link leads, with everything percent-encoded that an address must not hold.
    """

    kind: Literal["text", "code", "bold", "link"]
    text: str = ""
    parts: tuple[Span, ...] = ()
    url: str = ""


def spans(text: str) -> tuple[Span, ...]:
    r"""Take inline text apart.

    Markup that is not closed stands for itself; so does a backslash, backtick, asterisk or square bracket
    after a backslash. A code that holds backticks stands between longer rows of them. Runs of blanks and line
    ends become single blanks.

    Args:
        text: the text.

    Raises:
        VoccError: a link that leads neither to http, https, an anchor nor a relative path.

    Example:
        >>> [(span.kind, span.text) for span in spans("the `flda_3` receiver")]
        [('text', 'the '), ('code', 'flda_3'), ('text', ' receiver')]
        >>> spans("**[paper](https://example.org)**")[0].parts[0].url
        'https://example.org'
        >>> spans("[x](javascript:alert)")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: link 'javascript:alert' must be http, https, #anchor or a relative path
    """
    text = one_line(text)
    found: list[Span] = []
    end = 0
    for match in _MARKUP.finditer(text):
        if match.start() > end:
            found.append(Span("text", text[end : match.start()]))
        found.append(_span(match))
        end = match.end()
    if end < len(text):
        found.append(Span("text", text[end:]))
    return _joined(found)


def words(text: str) -> str:
    """Give inline text without its markup, for places that hold plain text alone.

    Example:
        >>> words("**BER** of [`flda_3`](#flda-3)")
        'BER of flda_3'
    """
    return _words(spans(text))


def one_line(text: str) -> str:
    r"""Put text on one line: each run of blanks, line ends and control characters becomes one blank.

    Example:
        >>> one_line(" a\n  b ")
        'a b'
    """
    return _NOT_WORDS.sub(" ", text).strip(" ")


def literal(text: str) -> str:
    r"""Write words of any origin, such as a file's name, as inline text that stands for itself.

    Example:
        >>> print(literal("**a** [b](c)"))
        \*\*a\*\* \[b\](c)
    """
    return re.sub(r"([\\`*\[\]])", r"\\\1", text)


def _words(pieces: tuple[Span, ...]) -> str:
    """Join the words of pieces, whatever they are."""
    return "".join(piece.text + _words(piece.parts) for piece in pieces)


def _span(match: re.Match[str]) -> Span:
    """Make the piece that a match stands for."""
    if match["literal"]:
        return Span("text", match["literal"])
    if match["code"]:
        return Span("code", _code(match["code"]))
    if match["bold"]:
        return Span("bold", parts=spans(match["bold"]))
    if not _ADDRESS.match(match["url"]):
        raise VoccError(f"link {match['url']!r} must be http, https, #anchor or a relative path")
    return Span("link", parts=spans(match["label"]), url=quote(match["url"], safe=_URL_SAFE))


def _code(text: str) -> str:
    """Leave out the blanks that part a code's backticks from those around it, as Markdown does."""
    padded = text.startswith(" ") and text.endswith(" ") and text.strip(" ")
    return text[1:-1] if padded else text


def _joined(pieces: list[Span]) -> tuple[Span, ...]:
    """Join neighbouring texts."""
    joined: list[Span] = []
    for piece in pieces:
        if joined and piece.kind == "text" == joined[-1].kind:
            joined[-1] = Span("text", joined[-1].text + piece.text)
        else:
            joined.append(piece)
    return tuple(joined)
