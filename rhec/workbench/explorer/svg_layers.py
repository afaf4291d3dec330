"""A figure as SVG in a page, fast enough to follow a slider: unchanged parts are not drawn again.

Artists that move are marked `animated`; axes and legend are layers, each kept until its key
changes. Black becomes the page's own text colour, to suit light and dark pages.
"""

import io

import matplotlib as mpl
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure

from rhec.plots.style import BLACK, BLUE, RC

__all__ = ["LayeredFigure"]

_MAX_LAYERS = 64  # of a figure
# blue is too dark for a dark page: some of the page's text colour makes it lighter there
_LIGHTER_BLUE = f"color-mix(in srgb, {BLUE} 78%, currentColor)"
_PAGE_COLOURS = {BLACK: "currentColor", BLUE.lower(): _LIGHTER_BLUE}


class LayeredFigure:
    """A figure whose axes and legend are kept as layers of SVG, with moving artists on top.

    A subclass sets `axes` by name in `_build`, the first of them without a grid, and lists its
    moving artists in `_moving`; `keys` has what each of the axes shows.

    Args:
        size_in: width and height [in].
        name: unique in the page, because an SVG's references are looked up in the whole page.
        label: describes the picture to readers who do not see it.
    """

    def __init__(self, size_in, name, label):
        self.name, self.label, self.keys, self.kept = name, label, {}, {}
        with mpl.rc_context(RC | {"figure.constrained_layout.use": False}):
            self.figure = Figure(figsize=size_in)
            self.figure.patch.set_visible(False)
            self._build()
            for place, axes in enumerate(self.axes.values()):
                axes.patch.set_visible(False)
                axes.grid(visible=False)
                if place > 0:
                    axes.grid(axis="y", color=BLACK, alpha=0.12)
            self.figure.draw_without_rendering()  # ticks take their style when first drawn
        self.figure.set_dpi(72)  # SVG's unit is the point

    def _limit(self, panel, xlim, ylim):
        """Limits of a panel that shows nothing else but moving artists."""
        if self.keys.get(panel) != (xlim, ylim):
            self.axes[panel].set(xlim=xlim, ylim=ylim)
            self.keys[panel] = xlim, ylim

    def _show_bounds(self, run):
        """The bounds of a run's yaw rate, on the lines `bounds`. Returns limits around them."""
        bound = run.scenario.omega_max_radps
        for line, value in zip(self.bounds, (-bound, bound)):
            line.set_ydata([value, value])
        return -1.25 * bound, 1.25 * bound

    def _show_legend(self, key, handles):
        """One line above the axes; it stays while its key does."""
        if self.keys.get("legend") == key:
            return
        for old in list(self.figure.legends):
            old.remove()
        spacing = dict(borderaxespad=0.1, handlelength=1.6, columnspacing=1.2)
        with mpl.rc_context(RC):
            self.figure.legend(handles=handles, loc="upper right", ncols=len(handles), **spacing)
        self.keys["legend"] = key

    def _kept_layer(self, name, key, *artists):
        """The layer of these artists, drawn only if none of this name is known for this key."""
        known = self.kept.pop((name, key), None)
        self.kept[name, key] = self.draw_layer(*artists) if known is None else known  # newest last
        while len(self.kept) > _MAX_LAYERS:
            del self.kept[next(iter(self.kept))]
        return self.kept[name, key]

    def draw_layer(self, *artists):
        """These artists as SVG elements."""
        text = io.StringIO()
        with mpl.rc_context({"svg.hashsalt": self.name, "svg.fonttype": "path"}):
            renderer = RendererSVG(*self.figure.get_size_inches() * 72, text)
            for artist in artists:
                artist.draw(renderer)
            renderer.finalize()
        # without the head, whose style would be the whole page's
        elements = text.getvalue().partition("</defs>")[2].rpartition("</svg>")[0]
        for colour, page_colour in _PAGE_COLOURS.items():
            elements = elements.replace(colour, page_colour)
        return elements

    def svg(self):
        """The picture as an SVG element, as wide as the page lets it be."""
        parts = {name: [axes] for name, axes in self.axes.items()} | {"legend": self.figure.legends}
        still = [self._kept_layer(name, self.keys[name], *part) for name, part in parts.items()]
        width, height = self.figure.get_size_inches() * 72
        return (
            f'<svg class="rhec-picture" role="img" aria-label="{self.label}" '
            f'viewBox="0 0 {width:g} {height:g}" '
            'style="fill: currentColor; stroke-linejoin: round; stroke-linecap: butt">'
            f"{''.join(still)}{self.draw_layer(*self._moving())}</svg>"
        )

    def whole_figure(self):
        """The matplotlib figure with every artist in it, to be shown or saved."""
        for artist in self.figure.findobj(lambda artist: artist.get_animated()):
            artist.set_animated(False)
        self.figure.set_dpi(100)
        return self.figure
