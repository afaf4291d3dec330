"""Controllers whose bounds cannot be kept, or are just kept, do the best that physics allows."""

import casadi as ca
import numpy as np
import pytest

import rhec

INF = np.inf
pytestmark = pytest.mark.usefixtures("virtual_machine")
MASS = rhec.Model(states=("x", "v"), inputs="force", f=lambda x, u, p: [x[1], u[0]])


def mass(model=MASS, **options):
    options["bounds"] = dict(force=(-1, 1)) | options.get("bounds", {})
    return rhec.RHC(model=model, q=(1.0, 0.1), r=(0.1,), dt=0.1, horizon=20, **options)


@pytest.mark.parametrize("speed", [1.5, -0.9])
def test_beyond_a_hard_bound_it_brakes_at_once_and_says_so(speed):
    """With all its force until the bound is kept; `ok` is False exactly as long as it cannot be."""
    mpc = mass(bounds=dict(v=(-0.5, 0.5)))
    x = np.array([0.0, speed])
    n_beyond = 0
    for _ in range(40):
        command = mpc.step(x)
        # The state of the next sample is the first that a command moves.
        excess = abs(x[1]) - 0.1 - 0.5
        is_beyond = excess > 1e-6
        assert mpc.ok == (mpc.status == "") == (not is_beyond)
        if is_beyond:
            assert command == pytest.approx(-np.sign(speed), abs=1e-6)
            assert not mpc.converged and np.isfinite(mpc.kkt)
            of = "the bounds of 'v' cannot be kept; the plan exceeds them by"
            assert mpc.status == f"{of} {excess:.3g}"
        x = MASS.simulate(x, [command], dt=0.1)[-1]
        assert is_beyond or abs(x[1]) <= 0.5 + 1e-6
        n_beyond += is_beyond
    assert n_beyond >= 3


PRICES = [dict(linear=price) for price in (1e2, 1e3, 1e4, 1e6)]
PRICES += [dict(quadratic=price) for price in (1e3, 1e6)]


@pytest.mark.parametrize("price", PRICES, ids=str)
@pytest.mark.parametrize("hard", ["change", "state"])
def test_a_hard_bound_that_can_be_kept_is_kept(hard, price):
    """A row without a price is dearer than all rows with one, whatever these cost."""
    changes = {"force": (-0.05, 0.05)} if hard == "change" else {}
    bounds = {"v": (-0.3, 0.3)} if hard == "state" else {}
    soft = {"x": rhec.Bound(-INF, 0.5, **price)}
    mpc = mass(bounds=bounds | soft, delta_bounds=changes)
    mpc.step((1.0, 0.0))
    assert mpc.ok, mpc.status
    if hard == "change":
        assert np.abs(np.diff(np.ravel(mpc.u_plan), prepend=0)).max() < 0.05 + 1e-6
    else:
        assert np.abs(mpc.x_plan[1]).max() < 0.3 + 1e-6


@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-7])
def test_a_command_in_a_narrow_band_away_from_the_first_plan(width):
    """The QP is solved; whatever the state does, the command is in its band."""
    mpc = mass(bounds={"force": (0.3, 0.3 + width), "v": (-5.0, 5.0)})
    mpc.step((1.0, 0.0))
    assert mpc.ok, mpc.status
    np.testing.assert_allclose(mpc.u_plan, 0.3, rtol=0, atol=1.01 * width)


def pole_on_a_cart(x, u, p):
    sine = ca.sin(x[2])
    cosine = ca.cos(x[2])
    force = u[0] + 0.1 * sine * (0.5 * x[3] ** 2 - 9.81 * cosine)
    acceleration = force / (1 + 0.1 * sine**2)
    return [x[1], acceleration, x[3], (9.81 * sine - acceleration * cosine) / 0.5]


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("seed", range(4))
def test_a_loop_of_an_unstable_plant_stays_within_a_hard_bound(seed):
    """Also while a step is not solved, and the plan before goes on."""
    states = ("pos", "vel", "angle", "rate")
    model = rhec.Model(states=states, inputs="force", f=pole_on_a_cart)
    rail_m = 0.6
    bounds = dict(force=(-12, 12), pos=(-rail_m, rail_m))
    weights = dict(q=(1.0, 0.1, 10.0, 0.1), r=(0.01,))
    mpc = rhec.RHC(model=model, dt=0.04, horizon=40, bounds=bounds, **weights)
    x = np.random.default_rng(seed).uniform((-0.3, -0.5, -1, -0.5), (0.3, 0.5, 1, 0.5))
    x[2] = 0.7 * np.sign(x[2])
    n_ok = 0
    for _ in range(80):
        u = mpc.step(x)
        n_ok += mpc.ok
        x = model.simulate(x, [u], dt=0.04)[-1]
        assert abs(x[0]) < rail_m + 0.01
    assert n_ok > 0.85 * 80


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


def test_bounds_of_the_model_hold_in_its_controller():
    """Unless `bounds` say other ones."""
    model = rhec.Model(
        states=("x", "v"), inputs="force", f=MASS.f, state_bounds=dict(v=(-0.2, 0.3))
    )
    force = dict(force=(-INF, INF))
    narrow = mass(model, bounds=force)
    wide = mass(model, bounds=force | dict(v=(-INF, INF)))
    free = mass(bounds=force)
    for mpc in (narrow, wide, free):
        mpc.solve((3.0, 0.0))
    assert narrow.ok and narrow.x_plan[1].min() == pytest.approx(-0.2)
    np.testing.assert_allclose(wide.u_plan, free.u_plan, rtol=0, atol=1e-7)
    assert free.x_plan[1].min() < -0.5
