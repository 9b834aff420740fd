"""Reports as templates: hostile words stay words, and a page needs nothing beside it."""

import base64
import io
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.report.page import html, render


class Tags(HTMLParser):
    """Collects tags with their attributes, and the words between them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.words.append(data)

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture
def package(tmp_path, monkeypatch, request):
    """A package with room for templates."""
    folder = tmp_path / f"study_{abs(hash(request.node.name))}"
    folder.mkdir()
    (folder / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    sys.modules.pop(folder.name, None)


HOSTILE = [
    "<script>alert(1)</script>",
    "`</code><img src=x onerror=alert(1)>`",
    "``` \n<b>x</b>",
    "[x](javascript:alert(1)) ![y](http://elsewhere/y.png)",
    '<a id="x"></a>',
    "a | b **c** ~~d~~ &lt;e&gt; \\",
    "# 1. - heading",
    "-",
]


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_names_stay_words(package, words):
    template = "# {{ name }}\n\n{{ name }}\n\n| a |\n|---|\n| {{ name }} |\n\n- {{ name }} and {{ name|code }}\n"
    (package / "page.md.j2").write_text(template)
    markdown = render(package.name, "page.md.j2", name=words)
    tags = Tags(html(markdown, words, package))
    assert not {name for name, _ in tags.tags} & {"script", "b", "img"}
    assert not any(
        key.startswith("on") for _, attributes in tags.tags for key in attributes
    )
    assert not tags.named("a")
    shown = "".join(tags.words)
    assert shown.count(" ".join(words.split())) >= 4


REPORT = """# Evidence

What was measured.

## Contents

- [Summary](#summary)

## Summary

* **\N{CHECK MARK} 12** claims
* **\N{BALLOT X} 3** differ

## Numbers

| receiver | BER |
|:---|---:|
| FLDA | \N{BALLOT X} 0.1 |

![Rates that fall](figures/fig%2022.png)
The caption. [Data (CSV)](fig22.csv)
"""


def test_a_page_holds_everything(tmp_path):
    (tmp_path / "figures").mkdir()
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    Image.fromarray(pixels).save(tmp_path / "figures" / "fig 22.png")
    tags = Tags(html(REPORT, "Evidence", tmp_path))
    (image,) = tags.named("img")
    assert (image["alt"], image["width"], image["height"]) == (
        "Rates that fall",
        "4",
        "2",
    )
    content = base64.b64decode(image["src"].removeprefix("data:image/png;base64,"))
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(content))), pixels)
    assert not tags.named("script") + tags.named("link")
    assert [heading["id"] for heading in tags.named("h2")] == [
        "contents",
        "summary",
        "numbers",
    ]
    tones = [tag.get("class") for name in ("li", "td") for tag in tags.named(name)]
    assert tones == [None, "agree", "differ", None, "differ"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("no.png", "picture .*no.png cannot be read: No such file"),
        ("../a.png", "leads out"),
        ("text.png", "not a PNG"),
    ],
)
def test_a_picture_that_cannot_be_shown_is_refused(tmp_path, name, reason):
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(VoccError, match=reason):
        html(f"![alt]({name})", "a", tmp_path)
