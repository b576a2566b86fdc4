"""Configuration of the site. `python -m sphinx -W docs docs/_build` builds it; `generate.py` writes the generated pages."""

import re
import sys
from collections.abc import Mapping
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
exclude_patterns = ["_build", "examples"]
html_theme = "furo"
html_title = "Roadproof"
html_static_path = ["_static"]
html_css_files = ["pictures.css"]
html_math_renderer = "mathml"  # browsers display MathML without scripts or network
html_show_sourcelink = False
html_use_index = False  # the search and the pages of the Python API list the same names
html_domain_indices = False
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["ref.python"]  # two classes of different packages may share a name
autodoc_typehints = "none"  # docstrings have shapes and units
autodoc_member_order = "bysource"
napoleon_use_ivar = True
napoleon_attr_annotations = False  # as for arguments
toc_object_entries = False


def mathml(translator: SphinxTranslator, node: nodes.math | nodes.math_block) -> None:
    """Writes a formula as MathML. A displayed formula has a margin, because the theme clips its overhang."""
    block = isinstance(node, nodes.math_block)
    try:
        formula = tex2mathml(node.astext(), as_block=block)
        translator.body.append(f'<div class="math" style="padding: 0.6em 0">{formula}</div>' if block else formula)
    except MathError as error:
        raise ValueError(f"formula {node.astext()!r}: {error}") from error
    raise nodes.SkipNode


def escape_bars(app: Sphinx, what: str, name: str, owner: object, options: object, lines: list[str]) -> None:
    """Escapes the bars of |K| in docstrings, which reStructuredText reads as a substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def shorten_deprecated(app: Sphinx, what: str, name: str, owner: object, options: object, lines: list[str]) -> None:
    """Reduces the docstring of a deprecated function or class to its first paragraph, which gives the replacement."""
    if lines and re.search("Deprecated|Obsolete", lines[0]):
        del lines[lines.index("") :]


def tidy_signature(
    app: Sphinx, what: str, name: str, owner: object, options: object, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Replaces default values that are objects, which have no Python text, by "..."."""
    pattern = r"<[^<>]*>|PosixPath\('/[^']*'\)"
    return (signature and re.sub(pattern, "...", signature), returned)


def omit_summaries(app: Sphinx, name: str, source: list[str]) -> None:
    """Omits the table of summaries from the pages of the Python API, because each docstring on these pages repeats its summary.

    The pages in the repository keep this table: GitHub shows no docstrings.
    """
    if "```{eval-rst}\n.. auto" in source[0]:
        source[0] = re.sub(r"\n\| name \| summary \|\n(?:\|.*\n)+", "\n", source[0])


def write_pages(app: Sphinx) -> None:
    """Writes the generated pages and drawings next to the handwritten pages."""
    pages = generate.pages() | {"reference/logs": generate.log_page()}
    write(HERE, {f"{name}.md": text for name, text in pages.items()} | generate.drawings())


def write_redirects(app: Sphinx, error: Exception | None) -> None:
    """Writes a redirect at every old address of the built site."""
    if error is None and app.builder.format == "html":
        write(Path(app.outdir), generate.redirects())


def write(folder: Path, files: Mapping[str, str]) -> None:
    """Writes files below a folder. An unchanged file keeps its time, so that Sphinx does not read it again."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8", newline="\n")


def setup(app: Sphinx) -> None:
    """Connects the formulas, the generated pages and the redirects."""
    app.add_html_math_renderer("mathml", inline_renderers=(mathml, None), block_renderers=(mathml, None))
    app.connect("builder-inited", write_pages)
    app.connect("source-read", omit_summaries)
    app.connect("build-finished", write_redirects)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("autodoc-process-docstring", shorten_deprecated)
    app.connect("autodoc-process-signature", tidy_signature)
