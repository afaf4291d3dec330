"""An RHE of many states, whose matrices are loops in the code: exact, and small to compile."""

import casadi as ca
import numpy as np
from oracles import kalman

import rhec
from rhec.core._casadi import compiled
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.core.estimator.rhe import Window, build_solvable
from rhec.core.model.integration import growth_function

DT = 0.1


def masses(n, cubic=0.1, damping=0.1, **options):
    """A chain of n masses between hardening springs, of 2 n states; a force acts on either end."""

    def f(x, u, p):
        place = ca.vertcat(0, x[:n], x[n - 1])
        longer = place[1:] - place[:-1]
        spring = longer + cubic * longer**3
        force = ca.vertcat(u[0], ca.DM.zeros(n - 2), u[1])
        return ca.vertcat(x[n:], spring[1:] - spring[:-1] - damping * x[n:] + force)

    places = tuple(f"q{i}" for i in range(n))
    speeds = tuple(f"v{i}" for i in range(n))
    inputs = ("left", "right")
    outputs = (*places, *inputs)
    return rhec.Model(states=places + speeds, inputs=inputs, outputs=outputs, f=f, **options)


def test_of_a_linear_chain_it_is_the_kalman_filter():
    """At every sample, a third of the places missing, compiled."""
    n = 11
    model = masses(n, cubic=0.0)
    sigma_v = np.array([0.01] * n + [0.02] * 2)
    noise = dict(sigma_v=sigma_v, sigma_w=[0.01] * 2 * n, noise_in_window=True)
    guess = dict(guess=[0.0] * 2 * n, sigma_guess=[0.3] * 2 * n)
    rhe = rhec.RHE(model=model, dt=DT, horizon=3, outliers=False, **noise, **guess)
    unit = np.eye(2 * n)
    A = np.column_stack([model.simulate(x, [[0, 0]], dt=DT)[-1] for x in unit])
    B = np.column_stack([model.simulate(0 * unit[0], [u], dt=DT)[-1] for u in np.eye(2)])
    rng = np.random.default_rng(n)
    z = rng.normal(0, 0.3, (12, n + 2))
    z[:, :n][rng.random((12, n)) < 1 / 3] = np.nan
    Q = B @ np.diag(np.square(sigma_v[n:])) @ B.T + 0.01**2 * np.eye(2 * n)
    samples = [(A, B @ row[n:], Q, unit[:n], sigma_v[:n], row[:n]) for row in z]
    for row, (m, P, _) in zip(z, kalman(np.zeros(2 * n), 0.3**2 * unit, samples)):
        found = rhe.step(row)
        assert rhe.ok
        np.testing.assert_allclose(found.x, m, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.covariance, P, rtol=0, atol=1e-9)


def test_its_code_grows_with_the_square_of_its_states():
    """That of a product of matrices as scalars would grow with the cube."""
    n_lines = []
    for n in (6, 12):
        window = Window(masses(n), DT, 10, judge=InnovationGate())
        _, text = compiled.library_text(build_solvable(window))
        n_lines.append(text.count("\n"))
    assert n_lines[1] < 2.5 * n_lines[0]


def test_that_the_rule_lets_grow_what_the_model_damps_is_seen_in_loops():
    """As the eigenvalues say, with 12 states that depend on each other."""
    rng = np.random.default_rng(0)
    model = masses(6, cubic=1.0, damping=0.5)
    grows = growth_function(model, DT)
    seen = []
    for size in np.geomspace(1, 100, 30):
        x = size * rng.standard_normal(12)
        modes = np.linalg.eigvals(np.array(model.slopes(x, [0, 0], []))) * DT
        growth = max(abs(1 + modes + modes**2 / 2 + modes**3 / 6 + modes**4 / 24))
        if abs(growth - 1) > 0.5 or growth < 1.001:  # others are grown or damped by little
            expected = growth > 1.5 * max(1, np.exp(max(modes.real)))
            seen.append((bool(grows(x, [0, 0], [])), expected))
    assert len(set(seen)) == 2 and all(found == expected for found, expected in seen)
