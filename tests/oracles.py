"""Random instances of the window's and the horizon's nonlinear problems of the robots in `robots`,
and their solutions by `notebooks.studies.ipopt`; a Kalman filter for the linear one.

The robots that the instances drive use nothing of `rhec`. The paper's θ is linear in time, so there
one Runge-Kutta step is Simpson's rule.
"""

import functools

import casadi as ca
import numpy as np

import rhec
from notebooks.studies.ipopt import PlanProblem, WindowProblem
from rhec import paper

DT, N = 0.2, 15
V = np.square(paper.SIGMA_V)


def flat(value):
    """A CasADi or NumPy matrix as a plain vector, column by column."""
    return np.array(value).ravel(order="F")


def move(pose, nu, mu, kappa, omega, dt=DT):
    """The pose (x, y, θ) one interval later."""
    x, y, theta = pose[0], pose[1], pose[2]
    turns = [theta, theta + dt / 2 * kappa * omega, theta + dt * kappa * omega]
    simpson = [dt / 6 * mu * nu * weight for weight in (1, 4, 1)]
    return [
        x + sum(w * ca.cos(turn) for w, turn in zip(simpson, turns)),
        y + sum(w * ca.sin(turn) for w, turn in zip(simpson, turns)),
        turns[2],
    ]


def drive(first, omegas, dt=DT):
    """Truth (n+1, 6) of a robot that starts at (x, y, θ, ν, μ, κ) and turns at `omegas` (n,), and
    readings without noise (n+1, 4).

    Reading i holds the yaw rate of the interval that ends at i; the one before the first is taken
    to be 0.
    """
    truth = [np.array(first, dtype=float)]
    for omega in omegas:
        pose, p = truth[-1][:3], truth[-1][3:]
        truth.append(np.array([*move(pose, *p, omega, dt), *p]))
    truth = np.array(truth)
    return truth, np.column_stack([truth[:, :2], truth[:, 3], [0.0, *omegas]])


@functools.cache
def window_problem(model, intervals, noisy=False):
    return WindowProblem(model, intervals, DT, noisy)


# Any robot


def outputs(robot, x, u, p):
    """What the robot's sensors read without noise: (n_z,)."""
    known = dict(zip(robot.states, ca.vertsplit(x))) | dict(zip(robot.inputs, ca.vertsplit(u)))
    known |= zip(robot.parameters, ca.vertsplit(p))
    h = iter(ca.vertsplit(robot.h(x, u, p)) if robot.h else ())
    return ca.vertcat(*(known[name] if name in known else next(h) for name in robot.outputs))


def symbols(robot):
    """x (n_x,), u (n_u,), p (n_p,)."""
    groups = dict(x=robot.states, u=robot.inputs, p=robot.parameters)
    return tuple(ca.SX.sym(name, len(group)) for name, group in groups.items())


@functools.cache
def reads_inputs(robot):
    """Which outputs (n_z,) depend on the inputs: at the oldest node, before which nothing has acted
    yet, they say nothing.
    """
    x, u, p = symbols(robot)
    return np.array([ca.depends_on(z, u) for z in ca.vertsplit(outputs(robot, x, u, p))])


def runge_kutta(robot, x, u, p, dt=DT):
    """The state one interval later, u and p held."""
    slope, total = robot.f(x, u, p), 0
    for weight, ahead in ((1, 1 / 2), (2, 1 / 2), (2, 1), (1, 0)):
        total += weight / 6 * slope
        slope = robot.f(x + ahead * dt * slope, u, p)
    return x + dt * total


@functools.cache
def plant(robot, dt=DT):
    """The Function (x, u, p) -> (x one interval later, what its sensors read without noise)."""
    x, u, p = symbols(robot)
    after = runge_kutta(robot, x, u, p, dt)
    measured = outputs(robot, after, u, p)
    return ca.Function("plant", [x, u, p], [after, measured])


def drive_robot(robot, x, inputs, p, dt=DT):
    """The states (n+1, n_x) from x under the inputs (n, n_u), and measurements without noise (n+1,
    n_z); before the first interval the inputs are the first ones, too.
    """
    step, states = plant(robot, dt), [np.array(x, dtype=float)]
    z = [flat(outputs(robot, ca.DM(x), ca.DM(inputs[0]), ca.DM(p)))]
    for u in inputs:
        after, measured = step(states[-1], u, p)
        states.append(flat(after))
        z.append(flat(measured))
    return np.array(states), np.array(z)


def limits(robot):
    """Lowest and highest values (n_p,) of the parameters, infinite where there is no bound."""
    none = (-np.inf, np.inf)
    bounds = [none if each is None else each for each in robot.parameters.values()]
    return np.reshape(bounds, (-1, 2)).astype(float).T


def draw(robot, rng, intervals=N):
    """A first state, inputs (n, n_u) that stay near a drawn mean, and true parameters."""
    low, high = np.array(robot.u_range)
    mean = rng.uniform(low, high)
    inputs = mean + 0.15 * (high - low) * rng.normal(size=(intervals, len(low)))
    return rng.uniform(*robot.x_range), inputs, rng.uniform(*robot.p_range)


def mhe_instance(robot, rng, intervals=N, missing=0.0):
    """A guess that is off, and noisy measurements (n+1, n_z), a share of which is missing, never
    one that depends on inputs.
    """
    x, inputs, p = draw(robot, rng, intervals)
    _, z = drive_robot(robot, x, inputs, p)
    z += rng.normal(size=z.shape) * robot.sigma_v
    z[(rng.random(z.shape) < missing) & ~reads_inputs(robot)] = np.nan
    low, high = limits(robot)
    sigma = np.array(robot.sigma_guess)
    guess = np.append(x, np.clip(p, low, high)) + 0.5 * sigma * rng.normal(size=len(sigma))
    guess[len(x) :] = np.clip(guess[len(x) :], low, high)
    return guess, z


def prior(robot):
    """The arrival cost's weight of a guess."""
    return np.diag(1 / np.square(robot.sigma_guess))


@functools.cache
def robots_model(robot, state_bounds=()):
    return rhec.Model(**robot.model, state_bounds=dict(state_bounds))


def mhe_by_ipopt(robot, guess, z, sigma_w=None, state_bounds=None):
    """The optimum of all samples z (n, n_z), NaN where one is missing, with the guess as the prior.

    Newest x, u, p, how many parameters are at a bound, the states (n_x, n), and what finds the
    covariance of the newest (x, p). Process noise has the standard deviations sigma_w (n, n_x +
    n_p), none of them 0, a row for each sample; None: there is none.
    """
    model = robots_model(robot, tuple((state_bounds or {}).items()))
    problem = window_problem(model, len(z) - 1, noisy=sigma_w is not None)
    of_intervals = None if sigma_w is None else sigma_w[1:]
    found = problem.solve(z, guess, prior(robot), robot.sigma_v, of_intervals)
    assert found.solved
    low, high = limits(robot)
    at_bounds = np.sum(np.minimum(found.p - low, high - found.p) < 1e-7)
    newest = dict(x=found.x[:, -1], u=found.u[:, -1], p=found.p)
    return newest | dict(states=found.x, at_bounds=at_bounds, covariance=problem.covariance)


@functools.cache
def plan_problem(robot, command):
    weights = dict(zip(robot.inputs, robot.r))
    options = dict(
        model=robots_model(robot),
        dt=DT,
        horizon=N,
        command=command,
        bounds={name: robot.bounds[name] for name in command},
        q=robot.q,
        r=[weights[name] for name in command],
        qn_factor=robot.qn_factor,
    )
    return PlanProblem(options)


def mpc_by_ipopt(robot, x, p, x_ref, u_ref, command=None):
    """The optimal inputs (n_u, N); those that are not commanded stay at their reference."""
    found = plan_problem(robot, command or robot.inputs).solve(x, x_ref, p, u_ref)
    assert found.solved
    return found.u


def mpc_instance(robot, rng, intervals=N):
    """The robot somewhere near a reference that it could follow if its parameters were the drawn
    ones, which are within their bounds.
    """
    x, inputs, p = draw(robot, rng, intervals)
    p = np.clip(p, *limits(robot))
    reference, _ = drive_robot(robot, x, inputs, p)
    return dict(
        x=reference[0] + 0.15 * rng.normal(size=len(x)) * (np.array(robot.q) > 0),
        p=p,
        x_ref=reference.T,
        u_ref=inputs.T,
    )


# Linear robots: the Kalman filter


def kalman(m, P, samples):
    """Mean, covariance and -2 log likelihood, up to a constant, after each sample, by the textbook.

    A sample (A, by, Q, H, sigma_v, z) is what leads to it, m = A m + by with the noise Q, and what
    is measured there, NaN where it is missing. Nothing leads to the first one.
    """
    for k, (A, by, Q, H, sigma_v, z) in enumerate(samples):
        if k:
            m = A @ m + by
            P = A @ P @ A.T + Q
        seen = ~np.isnan(z)
        H = H[seen]
        S = H @ P @ H.T + np.diag(np.square(sigma_v)[seen])
        K = P @ H.T @ np.linalg.inv(S)
        off = np.array(z)[seen] - H @ m
        m = m + K @ off
        P = P - K @ H @ P
        yield m, P, off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1]


def cart_matrices(dt=DT):
    """A (3, 3) and B (3, 1) of (position, velocity, bias) over one interval, by hand."""
    A = np.array([[1, dt, -(dt**2) / 2], [0, 1, -dt], [0, 0, 1]])
    return A, np.array([[dt**2 / 2], [dt], [0]])


def kalman_filter(z, guess, sigma_guess, sigma_v, sigma_w, leaving, dt=DT):
    """The cart's Kalman filter over z (n, 2) = (position, acceleration): mean (3,) and covariance
    (3, 3) of (position, velocity, bias), the newest input's mean, and -2 log likelihood of the
    newest position, up to a constant.

    The measured input drives the prediction, and its noise passes through B. Process noise enters
    in the first `leaving` intervals only: those that have left the window.
    """
    (A, B), H = cart_matrices(dt), np.array([[1.0, 0, 0, 0]])
    # With the input as the last state.
    F = np.block([[A, np.zeros((3, 1))], [np.zeros((1, 4))]])
    G = np.vstack([B, [[1.0]]])
    Q = G @ G.T * sigma_v[1] ** 2
    W = np.diag([*np.square(sigma_w), 0.0])
    samples = [
        (F, G[:, 0] * acceleration, Q + W * (i <= leaving), H, sigma_v[:1], [position])
        for i, (position, acceleration) in enumerate(z)
    ]
    first = np.append(guess, 0.0), np.diag([*np.square(sigma_guess), 0.0])
    *_, (m, P, deviance) = kalman(*first, samples)
    return m[:3], P[:3, :3], m[3], deviance
