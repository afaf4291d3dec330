"""The screen of the explorer as a widget: the kernel sends pictures as data, the browser draws."""

from pathlib import Path

import anywidget
import traitlets

_FOLDER = Path(__file__).parent


def _text(*files):
    return "\n".join((_FOLDER / file).read_text(encoding="utf-8") for file in files)


CSS = _text("explorer.css", "view.css")


class Screen(anywidget.AnyWidget):
    """Status, pictures and metrics; `picture` and `numbers` are the results of `panels.packed`."""

    _esm = _text("plot.js", "view.js", "screen.js")
    _css = CSS
    status, status_kind, line, table = (traitlets.Unicode().tag(sync=True) for _ in range(4))
    picture = traitlets.Dict().tag(sync=True)
    numbers = traitlets.Bytes().tag(sync=True)
