"""What is wrong with the texts of a figure: text over text, text beyond the figure or its box, text
that is too small in print.
"""

import itertools
import re
import zlib
from unittest import mock

import numpy as np
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from rhec.style import SMALL_PT

SLACK_PT = 0.6  # of a text on each side: boxes of texts are a little larger than their ink
MARGIN_PT = 0.5  # that a text keeps from the edges of its box
LARGEST_BOX = 0.6  # a rectangle wider than this share of its axes marks a range, it holds no text


def drawn_texts(figure):
    """The texts that the figure draws; labels of ticks beyond an axis, for example, are not."""
    found = []
    draw = Text.draw

    def record(text, renderer, *args, **kwargs):
        if text.get_visible() and text.get_text().strip() and text not in found:
            found.append(text)
        return draw(text, renderer, *args, **kwargs)

    with mock.patch.object(Text, "draw", record):
        figure.draw_without_rendering()
    return found


def corners(text, slack):
    """The four corners [pixels] of the turned box of a text, `slack` nearer to its middle."""
    turned = text.get_window_extent()
    angle = text.get_rotation()
    text.set_rotation(0)
    box = text.get_window_extent()
    text.set_rotation(angle)
    # A turned rectangle and the box around it have one centre.
    centre = np.array([turned.x0 + turned.x1, turned.y0 + turned.y1]) / 2
    half = np.maximum(np.array([box.width, box.height]) / 2 - slack, 0.1)
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn = np.array([[cosine, -sine], [sine, cosine]])
    return centre + (half * [[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ turn.T


def overlap(one, other):
    """Whether two convex polygons (n, 2) overlap: no edge of either separates them."""
    for polygon in (one, other):
        edges = np.roll(polygon, -1, axis=0) - polygon
        for normal in np.column_stack([-edges[:, 1], edges[:, 0]]):
            a, b = one @ normal, other @ normal
            if a.max() <= b.min() or b.max() <= a.min():
                return False
    return True


def boxes_of(axes):
    """Extents [pixels] of the filled rectangles of the axes that may hold a text."""
    for patch in axes.patches:
        if isinstance(patch, Rectangle) and patch.get_fill() and patch.get_visible():
            extent = patch.get_window_extent()
            if extent.width < LARGEST_BOX * axes.bbox.width and extent.height > 0:
                yield extent


def is_cut_by(box, points):
    """Whether a text has its middle in the box and sticks out of it."""
    x, y = points.mean(axis=0)
    inside = box.x0 <= x <= box.x1 and box.y0 <= y <= box.y1
    above_lower = (points.min(axis=0) >= (box.x0, box.y0)).all()
    below_upper = (points.max(axis=0) <= (box.x1, box.y1)).all()
    return inside and not (above_lower and below_upper)


def text_defects(figure):
    """Sentences that name each text over another, beyond the figure, out of its box, or small."""
    slack = SLACK_PT * figure.dpi / 72
    texts = drawn_texts(figure)
    places = [corners(text, slack) for text in texts]
    names = [text.get_text() for text in texts]
    defects = []
    for text in texts:
        if text.get_fontsize() < SMALL_PT:
            defects.append(f"{text.get_text()!r} has {text.get_fontsize():g} pt")
    for name, points in zip(names, places):
        low, high = points.min(axis=0), points.max(axis=0)
        if (low < 0).any() or (high > figure.bbox.size).any():
            defects.append(f"{name!r} leaves the figure")
    for (name, points), (other, others) in itertools.combinations(zip(names, places), 2):
        if overlap(points, others):
            defects.append(f"{name!r} lies over {other!r}")
    for text in texts:
        if text.axes is not None:
            points = corners(text, -MARGIN_PT * figure.dpi / 72)
            cut = [box for box in boxes_of(text.axes) if is_cut_by(box, points)]
            defects += [f"{text.get_text()!r} sticks out of its box" for _ in cut]
    return defects


def sizes_in_print(pdf):
    """The sizes [pt] of the texts of a figure in a PDF that Matplotlib wrote.

    A text with indices, which are smaller, counts by its largest letters.
    """
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf.read_bytes(), re.DOTALL)
    sizes = []
    for stream in streams:
        try:
            drawn = zlib.decompress(stream)
        except zlib.error:  # of a font, for example
            continue
        for block in re.findall(rb"\bBT\b(.*?)\bET\b", drawn, re.DOTALL):
            found = re.findall(rb"/[\w-]+ ([\d.]+) Tf", block)
            sizes.append(max(map(float, found), default=np.inf))
    return sizes
