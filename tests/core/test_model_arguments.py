"""What a Model may leave out, and what is then the default."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest

import rhec
from rhec.core.model.robot_model import MotionNoise, interval


def model_with(**changed):
    arguments = dict(
        states=("x_m",),
        inputs=("v_mps",),
        parameters=dict(slip=(0.1, 1.0)),
        outputs=("x_m", "v_mps"),
        f=lambda x, u, p: p[0] * u,
    )
    return rhec.Model(**(arguments | changed))


NAMED = dict(
    states=["x_m", "v_mps"],
    inputs="force",
    parameters=dict(mass=(0.1, 1.0)),
    outputs=("x_m", "tip"),
    known="wind",
    f=lambda x, u, p, d: [x[1], u[0] / p[0] + d[0]],
    h=lambda x, u, p, d: [2 * x[0]],
)
NOISE = MotionNoise({}, lambda u, R, c: (u, R), lambda u, W, dt_s, c: 2 * W * dt_s)
CHANGED = dict(
    states=("x_m", "w_mps"),
    inputs="push",
    parameters=dict(mass=(0.1, 2.0)),
    outputs=("v_mps", "tip"),
    known="gust",
    f=lambda x, u, p, d: [x[1], u[0] / p[0] - d[0]],
    h=lambda x, u, p, d: [3 * x[0]],
    max_measurement=(1e3, 1e3),
    angles="tip",
    heading="x_m",
    sigma_held=dict(force=2.0),
    motion_noise=NOISE,
    steps=2,
    rule="radau3",
    discrete=True,
    state_bounds=dict(x_m=(-1.0, 1.0)),
)


def test_each_argument_tells_a_model_from_others():
    """What is compiled for one is never taken for another."""
    assert {*CHANGED} == {field.name for field in dataclasses.fields(rhec.Model)}
    changes = [{}, dict(parameters=dict(load=(0.1, 1.0)))]
    changes += [{name: value} for name, value in CHANGED.items()]
    assert len({rhec.Model(**NAMED | change) for change in changes}) == len(changes)
    assert rhec.Model(**NAMED) == rhec.Model(**NAMED)


def test_a_model_that_only_a_controller_sees_needs_no_outputs(virtual_machine):
    """And by default it commands all inputs, to 0, with Q as the terminal weight."""
    f = lambda x, u, p: [x[1], u[0]]  # noqa: E731
    seen = rhec.Model(states=("x", "v"), inputs="force", outputs="x", f=f)
    unseen = rhec.Model(states=("x", "v"), inputs="force", f=f)
    given = dict(q=[1.0, 0.1], r=[0.1], dt=0.1, horizon=10)
    short = rhec.RHC(model=unseen, **given)
    long = rhec.RHC(model=seen, command=("force",), qn=(1.0, 0.1), **given)
    long.prepare()
    expected = long.feedback(x=(1, 0), p=(), x_ref=np.zeros((2, 11)), u_ref=np.zeros((1, 10)))
    assert short.step((1, 0)) == expected


def test_a_held_input_is_that_of_the_last_interval_that_has_a_length():
    """The joint state is (x, held v, slip), with the v by which a wheel's speed is measured."""
    model = model_with(outputs=("x_m", "wheel_radps"), h=lambda x, u, p: p[0] + 2 * u)
    step = interval(model).step
    for dt_s, after in ((0.1, [1.1, 2.0, 0.5]), (0.0, [1.0, 7.0, 0.5])):
        np.testing.assert_allclose(step([1.0, 7.0, 0.5], 2.0, dt_s).full().ravel(), after)


@pytest.mark.parametrize(
    "output, sigma_held",
    [
        (dict(outputs=("x_m", "v_mps")), 10 * 0.05),
        (dict(outputs=("x_m", "wheel_radps"), h=lambda x, u, p: p[0] + 2 * u), 1.0),
    ],
)
def test_an_input_that_is_not_measured_is_the_last_one_and_ten_sigma_or_one(
    virtual_machine, output, sigma_held
):
    """Ten of its own output's; one in its unit where only another output tells of it."""
    noise = dict(sigma_v=[0.02, 0.05], sigma_w=[1e-3, 1e-3], guess=[0, 0.5], sigma_guess=[1, 1])
    silent, told = (
        rhec.EKF(model=model_with(**output, **held), dt=0.1, **noise)
        for held in ({}, dict(sigma_held=dict(v_mps=sigma_held)))
    )
    for z in ([0.0, 0.5], [0.1, np.nan], [np.nan, np.nan]):
        expected = told.step(z)
        found = silent.step(z)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-12)


def test_the_covariance_is_that_of_states_and_parameters(virtual_machine):
    """The held input between them has none, though an output tells of it."""
    model = model_with(outputs=("x_m", "wheel_radps"), h=lambda x, u, p: 2 * u)
    noise = dict(sigma_v=[0.02, 0.05], sigma_w=[0.0, 0.0], guess=[0, 0.5], sigma_guess=[0.3, 0.7])
    found = rhec.EKF(model=model, dt=0.1, **noise).step([np.nan, 1.0])
    np.testing.assert_allclose(found.covariance, np.diag([0.3**2, 0.7**2]), rtol=1e-6)


@pytest.mark.parametrize(
    "bounds, noise_in_window", [(None, True), (dict(x=(0.0, 5.0)), False)], ids=str
)
def test_an_estimator_of_a_model_without_inputs(virtual_machine, bounds, noise_in_window):
    """Decay with an unknown rate: as the EKF finds it, within the noise."""
    model = rhec.Model(
        states="x", parameters=dict(k=(0.0, 2.0)), outputs="x", f=lambda x, u, p: -p[0] * x[0],
        state_bounds=bounds,
    )  # fmt: skip
    noise = dict(sigma_v=[0.01], sigma_w=[1e-4, 1e-4], guess=[1, 0.5], sigma_guess=[1, 1], dt=0.1)
    rhe = rhec.RHE(model=model, horizon=8, noise_in_window=noise_in_window, **noise)
    ekf = rhec.EKF(model=model, **noise)
    rng = np.random.default_rng(0)
    for k in range(30):
        z = [np.exp(-0.1 * k) + 0.01 * rng.normal()]
        estimates = rhe.step(z), ekf.step(z)
        assert rhe.ok and ekf.ok
    assert rhe.u_window.shape == (0, 8) and rhe.x_window.shape == (1, 9)
    for estimate in estimates:
        assert estimate.p[0] == pytest.approx(1.0, abs=3 * np.sqrt(estimate.covariance[1, 1]))
    assert estimates[0].p[0] == pytest.approx(estimates[1].p[0], abs=0.01)


@pytest.mark.parametrize("kind, options", [(rhec.EKF, {}), (rhec.RHE, dict(horizon=3))])
def test_an_estimate_whose_variance_no_state_may_have_is_not_ok(virtual_machine, kind, options):
    model = rhec.Model(states="x", outputs="x", f=lambda x, u, p: 5 * x)
    noise = dict(sigma_v=[1], sigma_w=[1], guess=[0], sigma_guess=[1])
    live = kind(model=model, dt=1.0, **noise, **options)
    before = live.status
    assert not live.ok and "sample" in before
    live.step([0.0])
    assert live.ok and live.status == ""
    for _ in range(12):
        live.step([np.nan])
    assert not live.ok and live.status not in ("", before)
    live.restart()
    assert not live.ok and live.status == before


@pytest.mark.parametrize("bounds", [(-np.inf, np.inf), (-np.inf, 5.0), (0.0, np.inf)])
def test_an_infinite_bound_is_none(virtual_machine, bounds):
    options = dict(dt=0.2, sigma_v=(0.1, 0.1), sigma_w=(0.0, 0.01))
    options |= dict(guess=(0.0, 0.5), sigma_guess=(1.0, 1.0), horizon=5)
    estimates = []
    for slip in (bounds, None):
        estimator = rhec.RHE(model=model_with(parameters=dict(slip=slip)), **options)
        for k in range(10):
            estimate = estimator.step([0.1 * k, 0.6])
        assert estimator.kkt >= 0
        estimates.append([*estimate.x, *estimate.p])
    np.testing.assert_allclose(*estimates, rtol=1e-9)


@pytest.mark.parametrize("still", [0, 0.0, np.float64(0), np.zeros(1), ca.DM(0)])
def test_an_entry_of_f_may_be_a_number(still):
    """A state that does not change by itself, whatever its slope is made of."""
    model = rhec.Model(states=("x", "y"), inputs="v", f=lambda x, u, p: [u[0], still])
    np.testing.assert_allclose(model.simulate((1, 2), [[3.0]] * 2, dt=0.1)[-1], (1.6, 2))
    at_rest = rhec.Model(states=("x", "y"), f=lambda x, u, p: [still, still])
    np.testing.assert_array_equal(at_rest.simulate((1, 2), np.zeros((3, 0)), dt=0.1)[-1], (1, 2))


def test_functions_of_numpy_are_those_of_casadi_without_a_warning():
    by_numpy, by_casadi = (
        rhec.Model(states="x", f=lambda x, u, p, sine=sine: [sine(x[0])])
        for sine in (np.sin, ca.sin)
    )
    assert by_numpy == by_casadi


@pytest.mark.parametrize(
    ("slope", "helps"),
    [
        (lambda x: math.sin(x), "ca.sin"),
        (lambda x: x if x > 0 else -x, "ca.if_else"),
        (lambda x: x * (x > 0 and x < 1), "ca.logic_and"),
        (lambda x: max(x, 0), "ca.fmax"),
        (lambda x: None, "one expression or a list"),
        (lambda x: ca.vertcat(x)[3], "not\\); x has 1, u has 0, p has 0 entries"),
        (lambda x: ca.vertcat(x)[-2], "not\\); x has 1, u has 0, p has 0 entries"),
    ],
)
def test_what_python_cannot_do_with_symbols_is_refused_with_what_helps(slope, helps):
    with pytest.raises(ValueError, match=helps) as refusal:
        rhec.Model(states="x", f=lambda x, u, p: slope(x[0]))
    assert "casadi" not in str(refusal.value) and "\n" not in str(refusal.value)
