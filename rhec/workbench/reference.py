"""The reference of the public face, made by pdoc from its docstrings and annotations."""

import inspect
from types import SimpleNamespace
from typing import get_type_hints

import pdoc
from bs4 import BeautifulSoup

import rhec

__all__ = ["of_the_face"]


def of_the_face():
    """What the report shows of the public face.

    Returns:
        Its contents as pairs (id, name), and its body as HTML, without scripts.
    """
    modules = []
    for name in rhec.__all__:
        shown = getattr(rhec, name)
        setattr(rhec, name, shown)  # pdoc asks for no name that is loaded on first use
        members = vars(shown).values() if inspect.isclass(shown) else ()
        if inspect.ismodule(shown):
            modules.append(name)
            members = map(vars(shown).get, shown.__all__)
        for each in (shown, *members):
            _show_plain_types(getattr(each, "__func__", each))
    pdoc.render.configure(docformat="google", show_source=False)
    body = _page(rhec)
    for name in modules:
        for member in _page(getattr(rhec, name)).select("section[id]"):
            member["id"] = f"{name}.{member['id']}"
            body.append(member)
    for extra in body.select("h1, input, .headerlink, .view-value-button, .inherited, .decorator"):
        extra.decompose()
    for member in body.select(".classattr:not(:has(.docstring))"):
        if not member["id"].endswith(".__init__"):
            member.decompose()
    for link in body.select("a[href^='#']"):
        if not body.find(id=link["href"][1:]):  # what is not shown
            link.unwrap()
    contents = [(section["id"], section["id"]) for section in body.select("section[id]")]
    return contents, body.decode_contents()


def _page(module):
    """A module's contents as pdoc shows them."""
    shown = pdoc.doc.Module(module)
    page = pdoc.render.html_module(shown, {module.__name__: shown})
    return BeautifulSoup(page, "html.parser").select_one("main")


def _show_plain_types(thing):
    """Leave of each annotation the type alone, without how it is validated."""
    hints = getattr(thing, "__annotations__", {})
    known = {name: hint for name, hint in hints.items() if hint and type(hint) is not str}
    if known:
        hints.update(get_type_hints(SimpleNamespace(__annotations__=known)))
