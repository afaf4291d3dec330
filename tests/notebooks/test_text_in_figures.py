"""Texts over another, beyond the figure or out of their box are found, and nothing else is."""

import matplotlib.pyplot as plt
import pytest
from text_boxes import text_defects

from rhec import style


@style.styled
def canvas(*texts, bar=None):
    figure, axes = plt.subplots()
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.axhspan(0.2, 0.8)  # a range, which holds no text
    if bar:
        axes.barh(0.5, bar, 0.2)
    for x, y, words, *turned in texts:
        look = dict(ha="center", va="center", rotation=turned[0] if turned else 0)
        axes.text(x, y, words, **look).set_in_layout(False)  # else the axes make room for it
    return figure


@pytest.mark.parametrize(
    "figure, expected",
    [
        (canvas((0.5, 0.5, "below"), (0.55, 0.53, "above")), ["'below' lies over 'above'"]),
        (canvas((0.0, 0.5, "much too long for this place" * 2)), ["leaves the figure"]),
        (canvas((0.06, 0.5, "wider than its bar"), bar=0.12), ["sticks out of its box"]),
        (canvas((0.15, 0.5, "in it"), bar=0.3), []),
        # The boxes around these turned texts overlap, the texts do not.
        (canvas((0.4, 0.5, "one label", 45), (0.52, 0.5, "another one", 45)), []),
    ],
    ids=["over", "left", "bar", "in the bar", "turned"],
)
def test_what_is_wrong_with_a_figure_is_told(figure, expected):
    found = text_defects(figure)
    assert bool(found) == bool(expected), found
    assert all(any(words in text for text in found) for words in expected), found
