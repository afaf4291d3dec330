"""A figure as vector graphics within a page, fast enough to follow a slider: what stays as it was
is not drawn again.

Artists that move are marked `animated`, as for matplotlib's blitting; all others belong to layers,
which are kept until their key changes. What is drawn in black takes the page's own text colour, so
that one picture suits a light and a dark page.
"""

import io

import matplotlib as mpl
from matplotlib.backends.backend_svg import RendererSVG

from rhec.plots.style import BLUE

KEPT = 64  # layers of a figure
INK = "#000000"
# The paper's blue is too dark for a dark page; a little of the page's ink there makes it lighter,
# and hardly changes it on a light page.
FOR_THE_PAGE = {INK: "currentColor", BLUE.lower(): f"color-mix(in srgb, {BLUE} 78%, currentColor)"}


class Layers:
    """The drawn layers of one figure. `name` is unique in the page, because what an SVG refers to
    is sought in the whole page.
    """

    def __init__(self, figure, name):
        self.figure, self.name = figure, name
        figure.set_dpi(72)  # SVG's unit is the point
        self.width, self.height = figure.get_size_inches() * 72
        self.kept = {}

    def kept_layer(self, name, key, *artists):
        """The layer of these artists, drawn only if none of this name is known for this key."""
        known = self.kept.pop((name, key), None)
        self.kept[name, key] = self.layer(*artists) if known is None else known  # the newest last
        while len(self.kept) > KEPT:
            del self.kept[next(iter(self.kept))]
        return self.kept[name, key]

    def layer(self, *artists):
        """These artists as SVG elements."""
        written = io.StringIO()
        with mpl.rc_context({"svg.hashsalt": self.name, "svg.fonttype": "path"}):
            renderer = RendererSVG(self.width, self.height, written)
            for artist in artists:
                artist.draw(renderer)
            renderer.finalize()
        # without the head, whose style would be the whole page's
        elements = written.getvalue().partition("</defs>")[2].rpartition("</svg>")[0]
        for colour, here in FOR_THE_PAGE.items():
            elements = elements.replace(colour, here)
        return elements

    def svg(self, *layers, label=""):
        """The layers on one another as an SVG element as wide as the page lets it be; label: for
        readers who do not see it.
        """
        return (
            f'<svg class="rhec-picture" role="img" aria-label="{label}" viewBox="0 0 {self.width:g} {self.height:g}" '
            f'style="fill: currentColor; stroke-linejoin: round; stroke-linecap: butt">{"".join(layers)}</svg>'
        )
