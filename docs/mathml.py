"""MkDocs hook: formulae as MathML, which browsers draw by themselves."""

import re
from html import unescape

from latex2mathml.converter import convert

FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL
)


def on_page_content(html: str, **_: object) -> str:
    """Turn each formula that the Markdown extension has marked into MathML."""

    def drawn(found: re.Match[str]) -> str:
        return convert(
            unescape(found[3]).strip(), display="block" if found[2] == "[" else "inline"
        )

    return FORMULA.sub(drawn, html)
