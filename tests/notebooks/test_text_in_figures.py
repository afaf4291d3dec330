"""No text of a figure lies over another, leaves the figure or sticks out of its box. Figures of
other tests are checked where they are drawn; those that no other test draws are drawn here.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from text_boxes import text_defects

from notebooks.further import your_robot
from notebooks.plots import interpretations
from rhec import style

RNG = np.random.default_rng(0)
TIME_S = np.arange(100) * 0.2


def parameters():
    values = 0.5 + 0.1 * RNG.normal(size=(100, 2))
    bounds = {"left slip": (0.0, 1.0), "right slip": None}
    return your_robot.parameters_and_bounds(
        TIME_S, values, np.full((100, 2), 0.1), np.full((100, 2), 0.5), bounds
    )


def commands():
    bounds = {"left track [m/s]": (-1.0, 1.0), "right track [m/s]": (-1.0, 1.0)}
    return your_robot.commands_and_bounds(TIME_S, RNG.normal(size=(100, 2)), bounds)


def positions():
    track = np.column_stack([TIME_S, np.sin(TIME_S)])
    names = ("reference", "truth", "measured", "RHE")
    return your_robot.positions(dict.fromkeys(names, track))


def tolerances():
    names = ("one iteration", "iterated")
    over_time = {name: 10.0 ** RNG.uniform(-8, 1, 100) for name in names}
    iterated = {name: 10.0 ** -np.arange(8.0) for name in names}
    return your_robot.solver_tolerances(TIME_S, over_time, iterated)


def ekf_yaw():
    sigma_x_m = np.geomspace(1e-3, 20, 9)
    analysis = interpretations_table(sigma_x_m)
    sweep = pd.DataFrame(
        dict(sigma=sigma, seed=seed, rms_yaw_rad=0.1 * (1 + seed + sigma))
        for sigma in (0.02, 10.0)
        for seed in range(3)
    )
    log = dict(t_s=TIME_S, theta_hat_rad=0.1 * RNG.normal(size=100), theta_rad=0 * TIME_S)
    runs = dict.fromkeys((10.0, 1.0, 0.02), type("Run", (), dict(columns=log)))
    return interpretations.ekf_yaw(analysis, sweep, runs, printed=10.0, likelihood=0.02)


def interpretations_table(sigma_x_m):
    gains = dict(gain_position=sigma_x_m / 20, gain_yaw_radpm=1 / sigma_x_m)
    return pd.DataFrame(dict(sigma_x_m=sigma_x_m, **gains, sigma_yaw_rad=0.1 / sigma_x_m))


DRAWN = (positions, parameters, commands, tolerances, ekf_yaw)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("draw", DRAWN, ids=lambda draw: draw.__name__)
def test_texts_of_a_figure_are_whole_and_apart(draw):
    assert text_defects(draw()) == []


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
        (canvas((0.5, 0.5, "alone"), (0.5, 0.8, "far above it")), []),
        (canvas((0.5, 0.5, "below"), (0.55, 0.53, "above")), ["'below' lies over 'above'"]),
        (canvas((0.0, 0.5, "much too long for this place" * 2)), ["leaves the figure"]),
        (canvas((0.06, 0.5, "wider than its bar"), bar=0.12), ["sticks out of its box"]),
        (canvas((0.15, 0.5, "in it"), bar=0.3), []),
        # The boxes around these turned texts overlap, the texts do not.
        (canvas((0.4, 0.5, "one label", 45), (0.52, 0.5, "another one", 45)), []),
        (canvas((0.4, 0.5, "one label", 45), (0.42, 0.5, "another one", 45)), ["lies over"]),
        (canvas((0.5, 1.5, "title far above the axes")), ["leaves the figure"]),
    ],
    ids=["apart", "over", "left", "bar", "in the bar", "turned", "turned over", "top"],
)
def test_what_is_wrong_with_a_figure_is_told(figure, expected):
    found = text_defects(figure)
    assert bool(found) == bool(expected), found
    assert all(any(words in text for text in found) for words in expected), found
