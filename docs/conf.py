"""Settings of the documentation site: ``sphinx-build -W docs site``."""

from docutils.nodes import Element, SkipNode
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

project = "vocc_torch"
author = "The vocc_torch authors"
GALLERY = ["effects", "locators", "bits", "measure", "plug_ins", "extras"]
extensions = ["myst_parser", "sphinx_copybutton", "sphinx_gallery.gen_gallery"]
html_theme = "furo"
html_title = "vocc_torch"
html_show_copyright = False
html_show_sphinx = False
html_css_files = ["site.css"]
html_static_path = ["static"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
copybutton_prompt_text = ">>> "
sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "subsection_order": ["../examples/gallery/" + name for name in GALLERY],
    "within_subsection_order": "FileNameSortKey",
    "filename_pattern": r"\.py$",
    "capture_repr": (),
    "abort_on_example_error": True,
}
NAVIGATION = """

```{toctree}
:hidden:
:caption: Learn
concepts
tutorials/measure
tutorials/decode
tutorials/plug-in
tutorials/network
tutorials/question
gallery/index
```
```{toctree}
:hidden:
:caption: How-to
scenes
locators
classifiers
sweeps
cluster
export
live
dashboards
trouble
```
```{toctree}
:hidden:
:caption: Reference
reference/keys
reference/columns
reference/effects
reference/api
glossary
```
```{toctree}
:hidden:
:caption: Explanation
paper
assumptions
statistics
detector
architecture
numerics
performance
measurements
```
```{toctree}
:hidden:
:caption: Extras
messages
calibration
rare
```
```{toctree}
:hidden:
:caption: Project
contributing
```
"""


def navigation(app: Sphinx, page: str, source: list[str]) -> None:
    """Append the tables of contents to the home page, which stays plain Markdown."""
    if page == app.config.root_doc:
        source[0] += NAVIGATION


def formula(translator: object, node: Element) -> None:
    """Write a formula as MathML, which browsers draw by themselves."""
    block = node.tagname == "math_block"
    text = tex2mathml(node.astext(), as_block=block)
    translator.body.append(f'<div class="math">{text}</div>' if block else text)
    raise SkipNode


def setup(app: Sphinx) -> None:
    """Register the navigation and the formulae."""
    app.connect("source-read", navigation)
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
