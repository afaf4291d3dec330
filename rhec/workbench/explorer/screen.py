"""The screen of the explorer as a widget: the kernel sends pictures as data, the browser draws."""

from pathlib import Path

import anywidget
import traitlets

_WORKBENCH = Path(__file__).parents[1]


def _text(*files):
    return "\n".join((_WORKBENCH / file).read_text(encoding="utf-8") for file in files)


CSS = _text("explorer/explorer.css")


class Screen(anywidget.AnyWidget):
    """Status, pictures and metrics; `picture` and `numbers` are the results of `panels.packed`."""

    _esm = _text("explorer/plot.js", "explorer/robot_view.js", "explorer/screen.js")
    _css = CSS
    status, status_kind, line, table = (traitlets.Unicode().tag(sync=True) for _ in range(4))
    picture = traitlets.Dict().tag(sync=True)
    numbers = traitlets.Bytes().tag(sync=True)
