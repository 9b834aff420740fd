"""Examples of the gallery run and draw a picture; the site's build runs all of them, too."""

import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

GALLERY = Path(__file__).resolve().parent.parent / "examples/gallery"
QUICK = (
    "effects/i_rolling_shutter",
    "effects/g_fog",
    "bits/b_flda_alone",
    "plug_ins/a_effect",
)
MOST_LINES = 40

EXAMPLES = [
    pytest.param(path, marks=[] if name in QUICK else pytest.mark.slow, id=name)
    for path in sorted(GALLERY.rglob("*.py"))
    for name in [str(path.relative_to(GALLERY).with_suffix(""))]
]


@pytest.mark.parametrize("path", EXAMPLES)
def test_examples_draw_a_picture(path, monkeypatch):
    pytest.importorskip("sklearn")
    monkeypatch.chdir(path.parent)  # and back, where an example goes elsewhere
    plt.switch_backend("agg")
    plt.close("all")
    runpy.run_path(str(path))
    figures = [plt.figure(number) for number in plt.get_fignums()]
    plt.close("all")
    assert figures
    assert all(ax.has_data() for figure in figures for ax in figure.axes)


def test_examples_are_short():
    lines = {path: path.read_text().count("\n") for path in GALLERY.rglob("*.py")}
    assert len(lines) >= 24
    assert max(lines.values()) <= MOST_LINES, max(lines, key=lines.get)
