"""The site: `python -m sphinx -W docs docs/_build` builds it; `generate.py` makes reference, gallery and notebook."""

import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxTranslator

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from docs import generate  # noqa: E402 - the checkout that it documents comes first

project = "Roadproof"
copyright = "the authors of Roadproof; Apache-2.0"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "Roadproof"
html_math_renderer = "mathml"  # which browsers show by themselves: no network, no script
html_show_sourcelink = False
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["ref.python"]  # two classes of different packages may share a name
autodoc_typehints = "none"  # docstrings have shapes and units
autodoc_member_order = "bysource"
napoleon_use_ivar = True
toc_object_entries = False


def mathml(translator: SphinxTranslator, node: nodes.math | nodes.math_block) -> None:
    """Writes a formula as MathML; the theme cuts what overhangs a formula of a line of its own, so that it has a margin."""
    block = isinstance(node, nodes.math_block)
    try:
        formula = tex2mathml(node.astext(), as_block=block)
        translator.body.append(f'<div class="math" style="padding: 0.6em 0">{formula}</div>' if block else formula)
    except MathError as error:
        raise ValueError(f"formula {node.astext()!r}: {error}") from error
    raise nodes.SkipNode


def escape_bars(app: Sphinx, what: str, name: str, owner: object, options: object, lines: list[str]) -> None:
    """Keeps the bars of |K| in docstrings, which would be a substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def write_pages(app: Sphinx) -> None:
    """Writes the generated pages beside the others."""
    for name, text in (*generate.pages().items(), ("reference/logs", generate.log_page())):
        path = HERE / f"{name}.md"
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8", newline="\n")


def setup(app: Sphinx) -> None:
    """Adds the formulas and the generated pages."""
    app.add_html_math_renderer("mathml", inline_renderers=(mathml, None), block_renderers=(mathml, None))
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", escape_bars)
