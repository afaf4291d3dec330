"""The notebook of one's own robot: its table and its pictures are those of its log."""

import numpy as np
import pytest

import rhec
from notebooks.further import your_robot

PATH = rhec.Path.from_segments([(20.0, 0.0)])
BOUNDS = {"left": (0.0, 0.7), "right": None}
N = 40
TIME_S = 0.2 * np.arange(N)
# Half of the samples count: the second half of each half of the drive.
COUNTS = np.repeat([False, True, False, True], N // 4)


@pytest.fixture
def log():
    """0.3 m beside the path, estimated 0.05 m off and slips by 0.02 and 0.04; else 1 more."""
    early = np.where(COUNTS, 0.0, 1.0)[:, None]
    x = np.column_stack([np.linspace(0, 10, N), np.full(N, -0.3), np.zeros(N)])
    x[:, 1:2] -= early
    slips = np.tile([0.1, 0.2], (N, 1))
    u = np.full((N, 2), 0.5)
    u[:3, 0], u[3, 1] = 0.7, 0.0
    return dict(
        x=x,
        z=np.hstack([x, u]) + 0.1,
        u=u,
        x_hat=x + (0.03, -0.04, 0.0) + early,
        p_hat=slips + (0.02, -0.04) + early,
        sigma=np.tile([9.0, 9.0, 9.0, 0.1, 0.2], (N, 1)),  # of the pose, then of the slips
        slips=slips,
    )


def test_the_table_counts_where_the_slips_have_converged(log):
    values = your_robot.errors(log, PATH, 0.7).set_index("quantity")["value"]
    assert [*values] == pytest.approx([0.3, 0.05, 0.02, 0.04, 4 / N])
    assert [name.split()[-1] for name in values.index[2:4]] == ["slip_left", "slip_right"]


def test_positions_are_those_of_the_log_beside_the_way_driven(log):
    (axes,) = your_robot.positions(log, PATH).axes
    drawn = {line.get_label(): line.get_xydata() for line in axes.lines}
    for name, column in dict(truth="x", RHE="x_hat", measured="z").items():
        np.testing.assert_array_equal(drawn[name], log[column][:, :2])
    np.testing.assert_allclose(drawn["reference"], log["x"][:, :2] * (1, 0), atol=1e-9)
    assert axes.get_aspect() == 1.0


def test_estimates_have_two_sigma_within_their_bounds_and_commands_are_held(log):
    limits = dict.fromkeys(BOUNDS, (0.0, 0.7))
    figure = your_robot.parameters_and_commands(TIME_S, log, BOUNDS, limits)
    for k, (axes, limits_) in enumerate(zip(figure.axes, BOUNDS.values())):
        true, middle, *bounds = axes.lines
        np.testing.assert_array_equal(true.get_ydata(), log["slips"][:, k])
        np.testing.assert_array_equal(middle.get_ydata(), log["p_hat"][:, k])
        assert [line.get_ydata()[0] for line in bounds] == [*(limits_ or ())]
        band = axes.collections[0].get_paths()[0].vertices[:, 1]
        ends = log["p_hat"][:, k] + 2 * log["sigma"][:, 3 + k] * [[-1], [1]]
        low, high = np.clip(ends, *limits_ or (None, None))
        assert (band.min(), band.max()) == pytest.approx((low.min(), high.max()))
    assert [text.get_text() for text in figure.legends[0].texts] == ["2 σ", "truth", "RHE"]
    for k, axes in enumerate(figure.axes[2:]):
        command, *bounds = axes.lines
        np.testing.assert_array_equal(command.get_ydata(), log["u"][:, k])
        assert command.get_drawstyle() == "steps-post"
        assert [line.get_ydata()[0] for line in bounds] == [0.0, 0.7]
    assert [axes.get_title("left") for axes in figure.axes] == ["left", "right"] * 2
