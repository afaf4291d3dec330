"""Sphinx's configuration of the report; `docs.site.report` calls it."""

from pathlib import Path
from types import SimpleNamespace
from typing import get_type_hints

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

import rhec

project = "rhec"
release = rhec.__version__
copyright = "the rhec authors, MIT licence"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["figures"]
templates_path = [str(Path(__file__).parent / "_templates")]

html_theme = "furo"
html_title = f"rhec {release}"
html_static_path = ["_static"]
html_css_files = ["custom.css", "claims.css"]
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/live.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
html_copy_source = False
html_use_index = False
# A page opened from the disk may not read other pages, which the excerpts would be taken from.
html_show_search_summary = False
html_math_renderer = "mathml"

# The notebooks were executed by make; nothing runs here.
nb_execution_mode = "off"
nb_output_stderr = "remove"
nb_merge_streams = True
nb_render_markdown_format = "gfm"  # outputs have tables
nb_code_prompt_show = "Code"
nb_code_prompt_hide = "Code"
nb_ipywidgets_js = {}
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath", "html_image"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88


def setup(app):
    """Typeset formulas without scripts, and show types without how they are validated."""
    inline = (_visit_inline_formula, None)
    display = (_visit_formula, None)
    app.add_html_math_renderer("mathml", inline, display)
    app.connect("autodoc-before-process-signature", _show_plain_types)
    app.connect("html-page-context", _finish_page, priority=900)  # after the theme


def _visit_inline_formula(translator, node):
    translator.body.append(convert(node.astext()))
    raise SkipNode


def _visit_formula(translator, node):
    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div class="math" tabindex="0">{formula}</div>')
    raise SkipNode


def _show_plain_types(app, thing, is_bound):
    """Leave of each annotation the type alone: `float` of `Annotated[float, Ge(0)]`."""
    hints = getattr(thing, "__annotations__", {})
    # Text stands for what is imported where types are checked alone.
    known = {name: hint for name, hint in hints.items() if not isinstance(hint, str)}
    hints.update(get_type_hints(SimpleNamespace(__annotations__=known)))


# What Sphinx, myst-nb and furo write, and what it lacks for readers who use no mouse or no eyes.
_ACCESSIBLE = {
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
    '<div class="cell_output': '<div tabindex="0" class="cell_output',
    "<pre>": '<pre tabindex="0">',
    '<summary aria-label="Toggle hidden content">': "<summary>",
    '<dl>\n<dd><em class="sig-param">': '<dl role="list">\n<dd><em class="sig-param">',
    '<dd><em class="sig-param">': '<dd role="listitem"><em class="sig-param">',
    'role="heading"': 'role="heading" aria-level="2"',
}


def _finish_page(app, page, template, context, doctree):
    """Mend what assistive technology stumbles over, and tell the frame of the live page."""
    for part in ("body", "furo_navigation_tree"):
        for written, better in _ACCESSIBLE.items():
            context[part] = context.get(part, "").replace(written, better)
    context["live"] = app.tags.has("live")
