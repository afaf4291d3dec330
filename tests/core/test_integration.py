"""Substeps, implicit rules for stiff models, discrete models, and what is refused."""

import functools
import re

import casadi as ca
import numpy as np
import pytest
from oracles import flat
from scipy.integrate import solve_ivp

import rhec
from rhec.core.model import robot_model

MU = 50.0
X_0 = np.array([2.0, 0.0])
INTERVAL_S = 0.5


def van_der_pol(**options):
    """A stiff oscillator: one Runge-Kutta step over half a second is off by 4e5."""

    def f(x, u, p):
        a, b = x
        return [b, p[0] * (1 - a**2) * b - a + u[0]]

    names = dict(states=("a", "b"), inputs=("w",), parameters={"mu": None}, outputs=("a",))
    return rhec.Model(**names, f=f, **options)


def slope(_, x):
    return [x[1], MU * (1 - x[0] ** 2) * x[1] - x[0] + 0.3]


@functools.cache
def exact_end(duration_s):
    """Where the oscillator is after so long."""
    accuracy = dict(method="Radau", rtol=1e-12, atol=1e-13)
    return solve_ivp(slope, (0, duration_s), X_0, **accuracy).y[:, -1]


def end_of(model, x=X_0, dt_s=INTERVAL_S):
    return flat(robot_model.interval(model).step([*x, MU], [0.3], dt_s))[:2]


@pytest.mark.parametrize("rule, order", [("rk4", 4), ("radau3", 3), ("radau5", 5)])
def test_a_rule_has_its_order_where_the_model_is_smooth(rule, order):
    """Twice the substeps divide the error of an interval by 2^order, or more."""
    exact = exact_end(0.04)
    few = dict(rk4=8, radau3=4, radau5=2)[rule]
    errors = [
        np.linalg.norm(end_of(van_der_pol(rule=rule, steps=k), dt_s=0.04) - exact)
        for k in (few, 2 * few)
    ]
    assert errors[0] / errors[1] > 0.8 * 2**order
    assert errors[1] > 1e-12  # not yet rounding


@pytest.mark.parametrize("rule", ["radau3", "radau5"])
def test_an_implicit_rule_takes_a_stiff_interval_in_one_step(rule):
    exact = exact_end(INTERVAL_S)
    np.testing.assert_allclose(end_of(van_der_pol(rule=rule)), exact, atol=5e-4)
    assert np.linalg.norm(end_of(van_der_pol()) - exact) > 1e3


@pytest.mark.parametrize(
    "options", [dict(steps=3), dict(rule="radau3", steps=2), dict(rule="radau5")]
)
def test_derivatives_are_the_finite_differences(options):
    interval = robot_model.interval(van_der_pol(**options))
    s, v, h = np.array([*X_0, MU]), np.array([0.3]), 1e-5
    dt_s = 0.05

    def step(w):
        return flat(interval.step(w[:3], w[3:], dt_s))

    w = np.array([*s, *v])
    differences = np.array([(step(w + h * e) - step(w - h * e)) / (2 * h) for e in np.eye(4)]).T
    _, D, B = (np.array(each) for each in interval.linearised(s, v, dt_s))
    np.testing.assert_allclose(np.hstack([np.array(interval.A_0) + D, B]), differences, atol=1e-6)


def motor(**options):
    """A motor that follows its set point within 10 ms."""
    names = dict(states="angle", inputs="set", parameters={}, outputs=("angle", "set"))
    return rhec.Model(**names, f=lambda x, u, p: 100 * (u - x), **options)


def motor_of(k, **options):
    """A motor that follows its set point within 1/k s, with the bounds of k."""
    names = dict(states="x", inputs="u", outputs=("x", "u"), parameters=dict(k=k))
    return rhec.Model(**names, f=lambda x, u, p: p[0] * (u - x), **options)


NOISE = dict(sigma_v=(0.1, 0.1), sigma_w=(0.1,), guess=(0.0,), sigma_guess=(1.0,))
NOISE_OF_K = dict(sigma_v=(0.1, 0.1), sigma_w=(0, 0), guess=(0, 1))
TENTH = dict(dt=0.1, horizon=5)


def mhe_of_k(model, sigma=30):
    return rhec.RHE(model=model, sigma_guess=(1, sigma), **NOISE_OF_K, **TENTH)


def first_command(model):
    """The first sample of a controller; without an input it knows no better parameters."""
    p = np.ones(len(model.parameters))
    return rhec.RHC(model=model, q=[1], r=[1], **TENTH).step([0.0], p)


# What a rule amplifies: (how it is told, what asks for it, a model that does it, and what the
# sentence proposes)
BY_291 = "multiplies an error of the state by 291 ", ("steps", 4)
BY_5510 = "by 5.51e+03 at k = 200, its bound, ", ("steps", 8)
# A parameter without bounds may well be two standard deviations away from its first guess.
BY_304 = "by 304 at k = 101, ", ("steps", 4)
AMPLIFIED = [
    (*BY_291, motor, lambda model: rhec.RHE(model=model, **NOISE, **TENTH)),
    (*BY_291, motor, first_command),
    (*BY_5510, functools.partial(motor_of, (0.1, 200.0)), mhe_of_k),
    (*BY_304, functools.partial(motor_of, None), lambda model: mhe_of_k(model, 50)),
    (*BY_291, motor, lambda model: rhec.EKF(model=model, **NOISE, dt=0.1)),
]


@pytest.mark.parametrize("said, proposed, make, use", AMPLIFIED)
def test_what_the_rule_amplifies_is_refused_and_the_sentence_helps(
    virtual_machine, said, proposed, make, use
):
    """R(-10) = 291; the substeps that the sentence proposes, and the implicit rule are taken."""
    name, steps = proposed
    with pytest.raises(ValueError, match=re.escape(said) + rf".*{name}={steps} or .*'radau3'"):
        use(make())
    for accepted in (dict(steps=steps), dict(rule="radau3")):
        use(make(**accepted))


def test_what_no_rule_amplifies_is_taken(virtual_machine):
    """Shorter intervals, likely and narrow parameters; and a pendulum that stands, which falls."""
    rhec.RHE(model=motor(), dt=0.02, horizon=5, **NOISE)
    mhe_of_k(motor_of((0.1, 25.0)))
    mhe_of_k(motor_of(None), 10)
    names = dict(states=("angle", "rate"), inputs=("torque",), parameters={}, outputs=("angle",))
    model = rhec.Model(**names, f=lambda x, u, p: [x[1], 40 * ca.sin(x[0]) + u[0]])
    noise = dict(sigma_v=(0.1,), sigma_w=(0.1, 0.1), guess=(0.0, 0.0), sigma_guess=(1.0, 1.0))
    rhec.RHE(model=model, dt=0.3, horizon=5, **noise)


def test_an_estimate_at_which_the_rule_grows_is_not_ok_and_does_not_stay(virtual_machine):
    """A motor that is twice as fast as any that one Runge-Kutta step follows."""
    rhe = mhe_of_k(motor_of(None), 10)
    exact = motor_of(None, steps=8)
    rng = np.random.default_rng(0)
    x = [0.0]
    grown = []
    for k in range(60):
        u = [(-1.0) ** (k // 3)]
        x = exact.simulate(x, [u], [60.0], dt=0.1)[-1]
        z = -0.1 * rhe.step(np.array([*x, *u]) + 0.02 * rng.normal(size=2)).p[0]
        growth = abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)
        grown.append(growth > 1.2)
        assert not (grown[-1] and rhe.ok)
        assert not all(grown[-2:]) or len(grown) < 2
    assert sum(grown) >= 5 and rhe.ok


def test_a_column_of_casadi_is_a_measurement(virtual_machine):
    estimates = []
    for z in ([0.3, 0.5], np.array([[0.3], [0.5]]), ca.DM([0.3, 0.5])):
        rhe = rhec.RHE(model=motor(steps=4), dt=0.1, horizon=5, **NOISE)
        rhe.prepare()
        estimates.append(rhe.feedback(z).x[0])
    assert len(set(estimates)) == 1


def test_a_simulation_is_that_of_the_rule():
    model = van_der_pol(rule="radau5", steps=4)
    x = model.simulate(X_0, np.full((3, 1), 0.3), [MU], dt=INTERVAL_S / 3)
    assert x.shape == (4, 2)
    np.testing.assert_array_equal(x[0], X_0)
    np.testing.assert_allclose(x[-1], exact_end(INTERVAL_S), atol=1e-7)
    for wrong in (dict(x=[1.0]), dict(u=np.zeros((3, 2))), dict(p=[])):
        name = next(iter(wrong))
        with pytest.raises(ValueError, match=f"^{name} had shape"):
            model.simulate(**(dict(x=X_0, u=np.zeros((3, 1)), p=[MU]) | wrong), dt=0.1)
