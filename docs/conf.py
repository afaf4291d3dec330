"""Sphinx's configuration of the report; `rhec.workbench.report` calls it."""

import inspect
from types import SimpleNamespace
from typing import get_type_hints

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

from rhec import __version__

project = "rhec"
release = __version__
copyright = "the rhec authors, MIT licence"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["figures"]
templates_path = ["../rhec/workbench/live"]

html_theme = "furo"
html_title = f"rhec {release}"
html_static_path = ["_static"]
html_css_files = ["custom.css"]
html_show_sourcelink = False
html_copy_source = False
html_use_index = False
# A page opened from the disk may not read other pages, which the excerpts would be taken from.
html_show_search_summary = False
html_math_renderer = "mathml"

# The notebooks were executed by make; nothing runs here.
nb_execution_mode = "off"
nb_output_stderr = "remove"
nb_merge_streams = True
nb_code_prompt_show = "Code"
nb_code_prompt_hide = "Code"
nb_ipywidgets_js = {}
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88
napoleon_google_docstring = True


def setup(app):
    """Typeset formulas without scripts, and show annotations without how they are validated."""
    inline = (_visit_inline_formula, None)
    display = (_visit_formula, None)
    app.add_html_math_renderer("mathml", inline, display)
    app.connect("autodoc-before-process-signature", _show_plain_types)
    app.connect("html-page-context", _let_keyboards_scroll)


def _visit_inline_formula(translator, node):
    translator.body.append(convert(node.astext()))
    raise SkipNode


def _visit_formula(translator, node):
    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div class="math" tabindex="0">{formula}</div>')
    raise SkipNode


def _show_plain_types(app, thing, is_bound):
    """Leave of each annotation the type alone: `float` of `Annotated[float, Ge(0)]`."""
    if inspect.isclass(thing):
        thing = thing.__init__
    hints = getattr(thing, "__annotations__", {})
    known = {name: hint for name, hint in hints.items() if hint and not isinstance(hint, str)}
    if known:
        hints.update(get_type_hints(SimpleNamespace(__annotations__=known)))


def _let_keyboards_scroll(app, page, template, context, doctree):
    """Whoever scrolls by keys must be able to reach what scrolls."""
    body = context.get("body", "")
    for scrolls in ('<div class="table-wrapper', "<pre>"):
        body = body.replace(scrolls, scrolls.replace(" ", ' tabindex="0" ', 1))
    context["body"] = body
