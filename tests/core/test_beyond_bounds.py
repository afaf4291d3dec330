"""Controllers whose bounds cannot be kept, or are just kept, do the best that physics allows."""

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler

import rhec

INF = np.inf


def controller(model, **options):
    with no_compiler():
        return rhec.RHC(model=model, **options)


def drive(model, mpc, x, samples, dt, **references):
    """States (samples + 1, n_x), commands, and `ok` of each sample."""
    states, commands, ok = [np.array(x, float)], [], []
    for _ in range(samples):
        commands.append(mpc.step(states[-1], **references))
        ok.append(mpc.ok)
        states.append(model.simulate(states[-1], [commands[-1]], dt=dt)[-1])
    return np.array(states), np.array(commands), np.array(ok)


MASS = rhec.Model(states=("x", "v"), inputs="force", f=lambda x, u, p: [x[1], u[0]])
MASS_OPTIONS = dict(q=(1.0, 0.1), r=(0.1,), dt=0.1, horizon=20)


def mass(**options):
    bounds = dict(force=(-1, 1)) | options.pop("bounds", {})
    return controller(MASS, **MASS_OPTIONS, bounds=bounds, **options)


# Bounds that the state is beyond


@pytest.mark.parametrize("speed", [1.5, -0.9])
def test_beyond_a_hard_bound_it_brakes_at_once_and_says_so(speed):
    """With all its force until the bound is kept; `ok` is False exactly as long as it cannot be."""
    mpc = mass(bounds=dict(v=(-0.5, 0.5)))
    states, commands, ok = drive(MASS, mpc, (0.0, speed), 40, 0.1)
    # The state of the next sample is the first that a command moves.
    beyond = np.abs(states[:-1, 1]) - 0.1 > 0.5 + 1e-6
    assert beyond.sum() >= 3
    np.testing.assert_allclose(commands[beyond, 0], -np.sign(speed), atol=1e-6)
    np.testing.assert_array_equal(ok, ~beyond)
    assert np.all(np.abs(states[np.argmin(beyond) + 1 :, 1]) <= 0.5 + 1e-6)
    assert mpc.ok and mpc.status == ""
    mpc.restart()
    mpc.step((0.0, speed))
    assert not mpc.ok and not mpc.converged and np.isfinite(mpc.kkt)
    by = f"{abs(speed) - 0.1 - 0.5:.1g}"  # after the one sample that no command can change
    assert mpc.status == f"the bounds of 'v' cannot be kept; the plan exceeds them by {by}"


# Bounds at which it rests


# A bound that moves


def bicycle(x, u, p):
    return [
        x[3] * ca.cos(x[2]), x[3] * ca.sin(x[2]), x[3] * ca.tan(x[4]) / 2.7, u[0], u[1], u[2]
    ]  # fmt: skip


ROAD = rhec.Model(
    states=("x", "y", "yaw", "v", "steer", "ahead"),
    inputs=("pull", "turn", "speed_ahead"),
    f=bicycle,
)


def overtake(y_0, price, samples=60):
    """Drives at 10 m/s up to an ellipse of 6 by 2.5 m that is 30 m ahead and drives at 5 m/s.

    Returns the clearance, 1 at the ellipse, the last state, and `ok` by sample.
    """
    away = lambda x, u, p: ca.sqrt(((x[0] - x[5]) / 6) ** 2 + (x[1] / 2.5) ** 2 + 1e-6)  # noqa: E731
    mpc = rhec.RHC(
        model=ROAD, command=("pull", "turn"), dt=0.1, horizon=30, outputs=dict(away=away),
        q=(0, 0.5, 1, 0.5, 0.1, 0), r=(0.1, 1.0),
        bounds=dict(
            away=rhec.Bound(1, INF, linear=price),
            pull=(-5, 3), turn=(-0.5, 0.5), steer=(-0.5, 0.5),
        ),
    )  # fmt: skip
    x, clear, ok = np.array([0, y_0, 0, 10, 0, 30.0]), [], []
    for _ in range(samples):
        u = mpc.step(x, x_ref=(0, 0, 0, 10, 0, 0), u_ref=(0, 0, 5))
        ok.append(mpc.ok)
        x = ROAD.simulate(x, [[u[0], u[1], 5]], dt=0.1)[-1]
        clear.append(np.hypot((x[0] - x[5]) / 6, x[1] / 2.5))
    return np.array(clear), x, np.array(ok)


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("y_0", [0.05, 0.0, 0.3, -0.2])
@pytest.mark.parametrize("price", [None, 10.0, 1e4])
def test_it_drives_around_a_slower_obstacle_or_behind_it(price, y_0):
    """On its axis, where no side is nearer, it slows down."""
    clear, x, ok = overtake(y_0, price)
    assert np.all(ok) and clear.min() >= 0.99
    if y_0:
        assert abs(x[1]) > 2 and x[3] > 10
    else:
        assert x[0] < x[5] and x[3] < 7


# The command before


def test_changes_are_counted_from_the_command_that_was_applied():
    mpc = mass(bounds=dict(force=(-5, 5)), delta_bounds=dict(force=(-0.1, 0.1)))
    far = dict(x_ref=(100.0, 0.0))
    mpc.restart(u_before=[3.0])
    assert mpc.step((0, 0), **far) == pytest.approx(3.1)
    assert mpc.step((0, 0), **far) == pytest.approx(3.2)
    assert mpc.step((0, 0), **far, u_before=(-1.0,)) == pytest.approx(-0.9)  # overridden
    assert mpc.step((0, 0), **far, u_before=(np.nan,)) == pytest.approx(-0.8)  # unknown
    assert mpc.solve((0, 0), **far, u_before=(2.0,)) == pytest.approx(2.1)
    mpc.restart()
    assert mpc.step((0, 0), **far) == pytest.approx(0.1)


def test_a_command_before_that_is_far_beyond_its_bounds_comes_back_at_once():
    mpc = mass(delta_bounds=dict(force=(-0.1, 0.1)))
    assert mpc.step((0, 0), x_ref=(9, 0), u_before=[3.0]) == pytest.approx(1.0)
    assert not mpc.ok
    assert mpc.status.startswith("the bounds of the change of 'force' cannot be kept; ")
    assert mpc.step((0, 0), x_ref=(9, 0), u_before=[1.0]) == pytest.approx(1.0) and mpc.ok


# Bounds of the model


def test_bounds_of_the_model_hold_in_its_controller():
    """Unless `bounds` say other ones."""
    model = rhec.Model(
        states=("x", "v"), inputs="force", f=MASS.f, state_bounds=dict(v=(-0.2, 0.3))
    )
    narrow = controller(model, **MASS_OPTIONS)
    wide = controller(model, **MASS_OPTIONS, bounds=dict(v=(-INF, INF)))
    free = controller(MASS, **MASS_OPTIONS)
    for mpc in (narrow, wide, free):
        mpc.solve((3.0, 0.0))
    assert narrow.ok and narrow.x_plan[1].min() == pytest.approx(-0.2)
    np.testing.assert_allclose(wide.u_plan, free.u_plan, rtol=0, atol=1e-7)
    assert free.x_plan[1].min() < -0.5
