"""Sphinx configuration. Build with: uv run --group docs sphinx-build -W docs docs/_build."""

import re
import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

import signorini_fenicsx

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
import pages

project = "signorini_fenicsx"
author = "The signorini_fenicsx developers"
version = release = signorini_fenicsx.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", ".jupyter_cache", "jupyter_execute", "paper.md"]  # myst-nb makes two of them here
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
add_module_names = False
default_role = "code"
napoleon_google_docstring = True
napoleon_use_ivar = True

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["formulae.css"]
html_title = f"signorini_fenicsx {version}"
html_copy_source = False
html_show_sourcelink = False
html_math_renderer = "mathml"
nitpicky = False


def inline_math(translator: HTML5Translator, node: nodes.math) -> None:
    """Formulae are MathML, which browsers draw by themselves: no script, no font, no network."""
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def display_math(translator: HTML5Translator, node: nodes.math_block) -> None:
    """The same for a formula on a line of its own, with its number if it has one."""
    number = get_node_equation_number(translator, node) if node.get("number") else None
    translator.body.append('<div class="math">' if number is None else f'<div class="math" id="{node["ids"][0]}">')
    if number is not None:
        translator.body.append(f'<span class="eqno">({number})</span>')
    translator.body.append(tex2mathml(node.astext(), as_block=True) + "</div>")
    raise nodes.SkipNode


def keep_signs(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """In docstrings |u| and [p]_- are mathematics, not markup; what stands between backticks is code."""
    for number, line in enumerate(lines):
        pieces = re.split("(`[^`]*`)", line)
        pieces[::2] = [re.sub(r"\||(?<=\])_", r"\\\g<0>", piece) for piece in pieces[::2]]
        lines[number] = "".join(pieces)


def link_to_notebook(app: Sphinx, name: str, source: list[str]) -> None:
    """Below the title of a tutorial there is a link to its notebook."""
    if name.startswith("tutorials/"):
        link = f'<a href="../notebooks/{Path(name).name}.ipynb" download>This page as a notebook</a>'
        source[0] = re.sub(r"(?m)^(# .*)$", rf"\1\n\n{link}", source[0], count=1)


def write_notebooks(app: Sphinx, failure: Exception | None) -> None:
    """The notebooks of the tutorials, beside the pages."""
    if failure is None and app.builder.format == "html":
        pages.notebooks(Path(app.outdir) / "notebooks")


def setup(app: Sphinx) -> None:
    """Register the renderer of formulae, notebooks, and what is done to docstrings before napoleon reads them."""
    app.connect("source-read", link_to_notebook)
    app.connect("build-finished", write_notebooks)
    app.connect("autodoc-process-docstring", keep_signs, priority=400)
    app.add_html_math_renderer("mathml", (inline_math, None), (display_math, None))
