"""Known signals of a Model: the Kalman filter of a linear robot whose outputs and forces change by
sample, the least squares of its controller, and what a missing signal is taken to be.
"""

import casadi as ca
import numpy as np
import pytest
from helpers import assert_refused
from in_c import InC
from oracles import kalman

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
DT = 0.2
SIGMA_V, SIGMA_W = (0.05, 0.02), (0.01, 0.03, 0.004)
GUESS, SIGMA_GUESS = (0.3, -0.1, 0.2), (0.5, 0.4, 0.3)
NOISE = dict(sigma_v=SIGMA_V, sigma_w=SIGMA_W, guess=GUESS, sigma_guess=SIGMA_GUESS)
A = np.array([[1, DT, 0], [0, 1, 0], [0, 0, 1]])
PUSH = np.array([DT**2 / 2, DT, 0])


def cart(**changes):
    """A cart that is pushed by a known force, and seen from a known direction besides."""
    return rhec.Model(
        **dict(
            states=("x_m", "v_mps"),
            parameters={"offset": None},
            outputs=("seen", "v_mps"),
            known=("push", "direction"),
            f=lambda x, u, p, d: [x[1], d[0]],
            h=lambda x, u, p, d: [ca.cos(d[1]) * x[0] + ca.sin(d[1]) * p[0]],
        )
        | changes
    )


def drive(rng, n):
    """Measurements (n, 2) of the cart, a fifth of `seen` missing, and its known signals (n, 2)."""
    known = np.column_stack([rng.uniform(-1, 1, n), rng.uniform(-3, 3, n)])
    s = rng.normal(GUESS, SIGMA_GUESS)
    z = np.empty((n, 2))
    for k, (push, direction) in enumerate(known):
        z[k] = (np.cos(direction) * s[0] + np.sin(direction) * s[2], s[1]) + rng.normal(0, SIGMA_V)
        s = A @ s + PUSH * push + rng.normal(0, SIGMA_W)
    z[rng.random(n) < 0.2, 0] = np.nan
    return z, known


def expected(z, known, sigma_w):
    """Means and covariances by the textbook's filter: a force holds until the next sample."""
    samples = []
    for k, (row, (_, direction)) in enumerate(zip(z, known)):
        H = np.array([[np.cos(direction), 0, np.sin(direction)], [0, 1, 0]])
        by = PUSH * known[k - 1, 0]
        samples.append((A, by, np.diag(np.square(sigma_w[k])), H, SIGMA_V, row))
    return kalman(np.array(GUESS), np.diag(np.square(SIGMA_GUESS)), samples)


def by_name(row):
    return dict(zip(("push", "direction"), row))


@pytest.mark.parametrize("horizon, bound", [(None, None), (2, None), (7, None), (3, 60.0)])
def test_on_a_linear_robot_it_is_the_kalman_filter(horizon, bound):
    """At every sample, so that a window has kept the signals and the noise of each of its samples.

    The noise of an RHE changes by sample; of some states and samples there is none. A bound that
    is never near changes nothing but the last digits.
    """
    rng = np.random.default_rng(0)
    z, known = drive(rng, 40)
    made = rhec.EKF(model=cart(), dt=DT, **NOISE)
    sigma_w = np.tile(SIGMA_W, (len(z), 1))
    if horizon:
        bounds = {"x_m": (-bound, bound)} if bound else None
        options = dict(horizon=horizon, noise_in_window=True, **NOISE)
        made = rhec.RHE(model=cart(state_bounds=bounds), dt=DT, **options)
        sigma_w *= rng.uniform(0.3, 3, sigma_w.shape) * (rng.random(sigma_w.shape) < 0.8)
        sigma_w[20:25] = 0
    for row, signals, noise, (m, P, _) in zip(z, known, sigma_w, expected(z, known, sigma_w)):
        changed = dict(sigma_w=noise) if horizon else {}
        found = made.step(row, known=by_name(signals), **changed)
        np.testing.assert_allclose([*found.x, *found.p], m, rtol=0, atol=1e-6 if bound else 1e-9)
        np.testing.assert_allclose(found.covariance, P, rtol=0, atol=1e-9)
    assert made.ok


def test_a_signal_that_stays_the_same_is_a_number_in_the_model():
    """Through an outlier, a restart and iterations, of an output that is not linear."""

    def seen(x, d):
        return [ca.cos(d) * x[0] + 0.1 * ca.sin(d) * x[0] ** 2]

    known, fixed = (
        rhec.RHE(model=cart(known=names, h=h), dt=DT, horizon=5, **NOISE)
        for names, h in (
            (("push", "direction"), lambda x, u, p, d: seen(x, d[1])),
            ("push", lambda x, u, p, d: seen(x, 0.7)),
        )
    )
    z, signals = drive(np.random.default_rng(2), 50)
    z[:, 0] += 5.0 * (np.arange(50) >= 25)
    z[12, 0] = 30.0
    restarted = False
    for k, (row, (push, _)) in enumerate(zip(z, signals)):
        verb = "solve" if k % 11 == 5 else "feedback"
        known.prepare()
        fixed.prepare()
        found = getattr(known, verb)(row, known=dict(push=push, direction=0.7))
        wanted = getattr(fixed, verb)(row, known=dict(push=push))
        np.testing.assert_allclose(np.concatenate(found[:3]), np.concatenate(wanted[:3]))
        np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-6, atol=1e-12)
        assert known.ok == fixed.ok
        restarted |= not known.ok
    assert restarted and known.ok


ESTIMATORS = (
    lambda: rhec.EKF(model=cart(), dt=DT, **NOISE),
    lambda: rhec.RHE(model=cart(), dt=DT, horizon=3, **NOISE),
)


@pytest.mark.parametrize("make", ESTIMATORS)
def test_a_missing_signal_is_the_last_one(make):
    """Left out or NaN."""
    z, known = drive(np.random.default_rng(4), 12)
    known[5:8, 0] = known[4, 0]
    known[6:9, 1] = known[5, 1]
    told = make()
    held = make()
    for k, (row, signals) in enumerate(zip(z, known)):
        given = by_name(signals)
        if 5 <= k < 8:
            given["push"] = np.nan
        if 6 <= k < 9:
            del given["direction"]
        one = told.step(row, known=by_name(signals))
        other = held.step(row, known=given or None)
        np.testing.assert_array_equal(one.x, other.x)


@pytest.mark.parametrize("make", ESTIMATORS)
def test_a_refused_call_keeps_none_of_its_signals(make):
    """Whether they were refused or what came with them, whoever catches the error goes on as if it
    had not been made.
    """
    z, known = drive(np.random.default_rng(7), 8)
    fits = dict(push=9.0, direction=9.0)
    refused = [(row, fits | dict(direction="left")) for row in z[:1]]
    refused += [(bad, fits) for bad in (("one", 2.0), (1.0, 2.0, 3.0))]
    one = make()
    other = make()
    for k, (row, signals) in enumerate(zip(z, known)):
        given = None if k == 4 else by_name(signals)
        for bad, with_it in refused:
            with pytest.raises(ValueError, match="^(known|z)"):
                other.step(bad, known=with_it)
        np.testing.assert_array_equal(one.step(row, known=given).x, other.step(row, known=given).x)


def test_a_controller_holds_signals_and_keeps_none_of_a_refused_call():
    told = pushed_rhc()
    held = pushed_rhc()
    for push in ([0.1] * 8, None, np.nan):
        given = None if push is None else dict(push=push)
        one = told.step((1.0, 0.0), known=dict(push=0.1))
        np.testing.assert_array_equal(one, held.step((1.0, 0.0), known=given))
        for bad in (dict(x=(1.0,)), dict(u_ref=(0.0, 1.0, 2.0)), dict(known=dict(push=9, pull=1))):
            with pytest.raises(ValueError, match="^(x|u_ref|known) had"):
                held.step(**dict(x=(1.0, 0.0), known=dict(push=9.0)) | bad)


def pushed():
    """A cart with a force that is commanded, and one that is known."""
    return rhec.Model(
        states=("x_m", "v_mps"),
        inputs="force",
        outputs=("x_m", "v_mps", "force"),
        known="push",
        f=lambda x, u, p, d: [x[1], u[0] + d[0]],
    )


def pushed_rhc(**options):
    return rhec.RHC(model=pushed(), q=(1.0, 0.1), r=(0.2,), dt=DT, horizon=8, **options)


@pytest.mark.parametrize("options", [{}, dict(outputs={"v": lambda x, u, p, d: x[1] + 0 * d[0]})])
def test_a_plan_counts_on_what_is_known_of_the_horizon(options):
    """From whatever plan it starts, it is the least squares of the horizon, by dense matrices."""
    rng = np.random.default_rng(5)
    rhc = pushed_rhc(**options)
    F, G = A[:2, :2], PUSH[:2]
    for _ in range(5):
        rhc.restart(u_plan=rng.normal(size=1))
        x, push = rng.normal(size=2), rng.normal(size=8)
        by_force, free = np.zeros((16, 8)), []
        for i in range(8):
            x_free = F @ (free[-1] if free else x) + G * push[i]
            free.append(x_free)
            for j in range(i + 1):
                by_force[2 * i : 2 * i + 2, j] = np.linalg.matrix_power(F, i - j) @ G
        W = np.tile([1.0, 0.1], 8)
        H = by_force.T * W @ by_force + 0.2 * np.eye(8)
        plan = np.linalg.solve(H, -by_force.T * W @ np.concatenate(free))
        np.testing.assert_allclose(rhc.step(x, known=dict(push=push)), plan[:1], atol=1e-9)
        np.testing.assert_allclose(rhc.u_plan, [plan], atol=1e-9)


def test_a_simulation_holds_a_signal_over_its_sample():
    one = cart().simulate([1.0, 0.0], np.zeros((2, 0)), [0.0], dt=DT, known=by_name([0.5, 0.0]))
    np.testing.assert_allclose(one[1:], [[1.01, 0.1], [1.04, 0.2]])
    two = dict(push=[0.5, -0.5], direction=0.0)
    found = cart().simulate([1.0, 0.0], np.zeros((2, 0)), [0.0], dt=DT, known=two)
    np.testing.assert_allclose(found[2], [1.02, 0.0], atol=1e-12)


def test_in_exported_c_they_follow_the_outputs_and_the_inputs(tmp_path):
    """Those of one sample after what was measured, those of a horizon as rows of u_ref."""
    rng = np.random.default_rng(6)
    noise = dict(sigma_v=(0.05, 0.02, 0.1), sigma_w=(0.01, 0.03))
    guess = dict(guess=(0.0, 0.0), sigma_guess=(1.0, 1.0))
    mhe = rhec.RHE(model=pushed(), dt=DT, horizon=4, **noise, **guess)
    mpc = pushed_rhc()
    in_c = InC(rhec.export((mhe, mpc), tmp_path / "rhec"))
    for k in range(12):
        z = rng.normal(size=3)
        push = 0.1 * np.arange(8) - 0.05 * k
        in_c.prepare()
        found = mhe.step(z, known=dict(push=push[0]))
        answer, _ = in_c.call("estimate", [*z, push[0]], length=3)
        np.testing.assert_allclose(answer, [*found.x, *found.u], rtol=0, atol=1e-12)
        command = mpc.step(found.x, known=dict(push=push))
        u_ref = [np.zeros(8), push]
        answer, _ = in_c.call("control", found.x, [], np.zeros((2, 9)), u_ref, length=2)
        np.testing.assert_allclose(answer, [*command, push[0]], rtol=0, atol=1e-9)


def test_what_does_not_fit_is_refused_in_a_sentence():
    rhe = rhec.RHE(model=cart(), dt=DT, horizon=3, **NOISE)
    ekf = rhec.EKF(model=cart(), dt=DT, **NOISE)
    z = (0.1, 0.0)
    assert_refused(
        lambda known: (rhe.step(z, known=known), ekf.step(z, known=known)),
        [
            (dict(known=None), "known had no 'push'; the first sample needs a number for it"),
            (dict(known=dict(push=np.nan)), "known had no 'push'"),
            (dict(known=dict(push=1.0)), "known had no 'direction'"),
            (dict(known=dict(pull=1.0)), "known had 'pull'"),
            (dict(known=dict(push=(1.0, 2.0))), "known['push'] had shape (2,)"),
            (dict(known=dict(push="hard")), "known['push'] was 'hard'"),
            (dict(known=0.3), "known was 0.3; it should be a dict"),
        ],
    )
    assert_refused(
        cart,
        [
            (dict(known=("push", "x_m")), "'x_m' was twice in"),
            (dict(known=("push", "seen")), "'seen' was twice in outputs, known"),
            (dict(known=3), "known was 3"),
            (dict(known=()), "f was refused"),
        ],
    )
    with pytest.raises(
        ValueError, match=r"the Model has the known signals \('push', 'direction'\)"
    ):
        rhec.replay(None, model=cart(), dt=DT, horizon=3, **NOISE)
