"""Settings of the documentation site: ``sphinx-build -W docs site``."""

import os
import warnings

from docutils.nodes import Element, SkipNode
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

os.environ.setdefault("OMP_NUM_THREADS", "1")
warnings.filterwarnings("ignore", module="torch")

project = "vocc_torch"
author = "The vocc_torch authors"
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
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("matplotlib",),
    "reset_modules": ("matplotlib",),
    "capture_repr": (),
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "min_reported_time": 10,
    "show_memory": False,
}
NAVIGATION = {
    "Learn": [
        "concepts",
        "tutorials/measure",
        "tutorials/decode",
        "tutorials/plug-in",
        "tutorials/network",
        "tutorials/question",
        "gallery/index",
    ],
    "How-to": [
        "scenes",
        "locators",
        "classifiers",
        "sweeps",
        "cluster",
        "export",
        "live",
        "dashboards",
        "trouble",
    ],
    "Reference": [
        "reference/keys",
        "reference/columns",
        "reference/effects",
        "reference/api",
        "glossary",
    ],
    "Explanation": [
        "paper",
        "assumptions",
        "statistics",
        "detector",
        "architecture",
        "numerics",
        "performance",
        "measurements",
    ],
    "Extras": ["messages", "calibration", "rare"],
    "Project": ["contributing"],
}


def navigation(app: Sphinx, page: str, source: list[str]) -> None:
    """Append the tables of contents to the home page, which stays plain Markdown."""
    if page == app.config.root_doc:
        for caption, pages in NAVIGATION.items():
            lines = [":hidden:", f":caption: {caption}", *pages]
            source[0] += "\n".join(["\n\n```{toctree}", *lines, "```"])


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
