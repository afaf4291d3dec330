"""The window's and the horizon's nonlinear problems, written down once more for IPOPT, and random
instances of them: first of the paper's robot, then of any robot in `robots`; a Kalman filter for
the linear one.

Nothing here uses `rhec` beyond the paper's constants. The paper's θ is linear in time, so there one
Runge-Kutta step is Simpson's rule.
"""

import functools

import casadi as ca
import numpy as np

from rhec import paper

DT, N = 0.2, 15
V = np.square(paper.SIGMA_V)
IPOPT = {"print_time": 0, "ipopt": dict(print_level=0, sb="yes", tol=1e-11, bound_relax_factor=0.0)}
SOLVED = (
    "Solve_Succeeded",
    "Solved_To_Acceptable_Level",
    "Search_Direction_Becomes_Too_Small",
)  # what double precision allows


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


def places(speed_model):
    """Which of (x, y, θ, ν, μ, κ) the window's state holds."""
    return [0, 1, 2, 3, 4, 5] if speed_model == "parameter" else [0, 1, 2, 4, 5]


@functools.cache
def rhe_nlp(intervals, speed_model):
    """Eq. (10) for a window of so many intervals, to be solved by IPOPT. Unknowns: s_0, then all
    inputs, interval by interval.
    """
    parameter = speed_model == "parameter"
    n_s, n_v = (6, 1) if parameter else (5, 2)
    s, v = ca.MX.sym("s", n_s), ca.MX.sym("v", n_v, intervals)
    z, weight = ca.MX.sym("z", 4, intervals + 1), ca.MX.sym("weight", 4, intervals + 1)
    m, H = ca.MX.sym("m", n_s), ca.MX.sym("H", n_s, n_s)
    mu, kappa, pose = s[n_s - 2], s[n_s - 1], s[:3]
    cost = ca.bilin(H, s - m, s - m)
    for i in range(intervals + 1):
        cost += weight[0, i] * (z[0, i] - pose[0]) ** 2 + weight[1, i] * (z[1, i] - pose[1]) ** 2
        if parameter or i:
            cost += weight[2, i] * (z[2, i] - (s[3] if parameter else v[0, i - 1])) ** 2
        if i:
            cost += weight[3, i] * (z[3, i] - v[n_v - 1, i - 1]) ** 2
        if i < intervals:
            pose = move(pose, s[3] if parameter else v[0, i], mu, kappa, v[n_v - 1, i])
    newest = ca.vertcat(
        pose[0], pose[1], pose[2], s[3] if parameter else v[0, intervals - 1], mu, kappa
    )
    unknowns, given = ca.veccat(s, v), ca.veccat(z, weight, m, H)
    return ca.nlpsol("rhe", "ipopt", dict(x=unknowns, f=cost / 2, p=given), IPOPT), ca.Function(
        "newest", [unknowns], [newest]
    )


def rhe_by_ipopt(z, m, P, speed_model, guess=None):
    """Optimum of the window z (n, 4), NaN where there is no reading, with the arrival cost (m, P):
    unknowns, newest (x, y, θ, ν, μ, κ).
    """
    if guess is None:
        guess = np.concatenate([m, z[1:, 3 if speed_model == "parameter" else 2 :].ravel()])
    solver, newest = rhe_nlp(len(z) - 1, speed_model)
    weight = np.where(np.isnan(z), 0, 1 / V)
    lower = np.full(solver.numel_in("x0"), -np.inf)
    lower[[len(m) - 2, len(m) - 1]] = 0
    upper = np.where(lower == 0, 1, np.inf)
    solution = solver(
        x0=guess,
        lbx=lower,
        ubx=upper,
        p=np.concatenate([np.nan_to_num(z).ravel(), weight.ravel(), m, np.linalg.inv(P).ravel()]),
    )
    assert solver.stats()["return_status"] in SOLVED, solver.stats()["return_status"]
    return flat(solution["x"]), flat(newest(solution["x"]))


def rhe_instance(rng, speed_model):
    """A window of noisy readings (N+1, 4) and an arrival cost (m, P) from a prior that is off; the
    traction is as often above 1 as below.
    """
    keep = places(speed_model)
    first = np.array([*rng.normal(0, 1, 2), rng.uniform(-3, 3), 0.5, *rng.uniform(0.7, 1.3, 2)])
    _, z = drive(first, rng.uniform(-0.3, 0.3, N))
    z += rng.normal(size=z.shape) * np.sqrt(V)
    scale = np.sqrt([1, 1, 0.05, 0.1, 0.02, 0.02])[keep]
    mix = np.eye(len(keep)) + 0.3 * rng.normal(size=(len(keep), len(keep)))
    P = scale[:, None] * (mix @ mix.T) * scale
    m = first[keep] + rng.normal(size=len(keep)) * 0.05
    return z, m, P


def window_memory(z, m, P, speed_model):
    """The RHE's memory before the newest reading of the full window z enters, linearised where the
    arrival cost says.
    """
    inputs = [[0.0]] if speed_model == "parameter" else [[0.5], [0.0]]
    z = z.T.copy()
    z[:, -1] = np.nan
    return dict(s=np.tile(m[:, None], (1, N + 1)), v=np.tile(inputs, (1, N)), z=z, age=N, m=m, P=P)


def iterate(phases, memory, newest, settings, iterations):
    """Linearise, feedback, expand, again and again: the last memory and feedback, and the KKT
    tolerance of every iteration.
    """
    tolerances = []
    for _ in range(iterations):
        given = dict(P_0=np.ones(flat(memory["m"]).size)) | dict(memory) | settings | newest
        for name in ("linearise", "feedback", "expand"):
            phase = phases[name]
            result = phase(**{key: given[key] for key in phase.name_in()})
            given |= result
            if name == "feedback":
                answer = result
        tolerances.append(float(result["kkt"]))
        memory = dict(memory) | {key: result[key] for key in memory if key != "z"}
    return memory, answer, np.array(tolerances)


def unknowns(memory):
    """What IPOPT calls the unknowns, from the RHE's memory."""
    return np.concatenate([np.array(memory["s"])[:, 0], flat(memory["v"])])


@functools.cache
def rhc_nlp():
    """Eq. (NMPC), to be solved by IPOPT. Unknowns: ω_0 … ω_{N-1}."""
    omega, pose, p = ca.MX.sym("omega", N), ca.MX.sym("pose", 3), ca.MX.sym("p", 3)
    xi_ref, omega_ref, q, qn, r = (
        ca.MX.sym("xi_ref", 3, N + 1),
        ca.MX.sym("omega_ref", N),
        ca.MX.sym("q", 3),
        ca.MX.sym("qn", 3),
        ca.MX.sym("r"),
    )
    cost, xi = r * ca.sumsqr(omega - omega_ref), pose
    for i in range(N):
        xi = move(xi, *ca.vertsplit(p), omega[i])
        cost += ca.dot(qn if i + 1 == N else q, (ca.vertcat(*xi) - xi_ref[:, i + 1]) ** 2)
    return ca.nlpsol(
        "rhc",
        "ipopt",
        dict(x=omega, f=cost / 2, p=ca.veccat(pose, p, xi_ref, omega_ref, q, qn, r)),
        IPOPT,
    )


def rhc_by_ipopt(problem, q, qn_factor, r, omega_max):
    given = [problem[name] for name in ("pose", "p", "xi_ref", "omega_ref")]
    solution = rhc_nlp()(
        x0=0,
        lbx=-omega_max,
        ubx=omega_max,
        p=np.concatenate([flat(each) for each in (*given, q, qn_factor * np.array(q), r)]),
    )
    assert rhc_nlp().stats()["return_status"] in SOLVED
    return flat(solution["x"])


def rhc_instance(rng):
    """A robot somewhere near a reference that bends."""
    omegas = rng.normal(0, 0.05) + rng.normal(0, 0.02, N)
    reference, _ = drive([0, 0, rng.normal(0, 0.3), 0.45, 1, 1], omegas)
    pose = reference[0, :3] + rng.normal(size=3) * (0.3, 0.3, 0.3)
    return dict(
        pose=pose,
        p=(0.5, *rng.uniform(0.5, 1, 2)),
        xi_ref=reference[:, :3].T,
        omega_ref=np.full(N, rng.normal(0, 0.03)),
    )


def rhc_weights(rng):
    """Weights in which no two are alike."""
    return dict(
        q=tuple(rng.uniform(0.2, 3, 3)),
        qn_factor=rng.uniform(0.5, 12),
        r=rng.uniform(2, 12),
        omega_max=rng.uniform(0.05, 0.15),
    )


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


@functools.cache
def mhe_nlp(robot, intervals, dt=DT):
    """Moving horizon estimation over so many intervals whose prior is a guess, for IPOPT.

    Unknowns: x_0 and p, then the inputs, interval by interval. Also the Function (unknowns, data)
    -> (newest (x, p), its Jacobian, that of the residuals).
    """
    n_x, n_u, n_p, n_z = map(len, (robot.states, robot.inputs, robot.parameters, robot.outputs))
    first, u = ca.SX.sym("first", n_x + n_p), ca.SX.sym("u", n_u, intervals)
    z, weight = ca.SX.sym("z", n_z, intervals + 1), ca.SX.sym("weight", n_z, intervals + 1)
    guess, sigma = ca.SX.sym("guess", n_x + n_p), ca.SX.sym("sigma", n_x + n_p)
    x, p = first[:n_x], first[n_x:]
    residuals = [(first - guess) / sigma]
    for i in range(intervals + 1):
        if i:
            x = runge_kutta(robot, x, u[:, i - 1], p, dt)
        before = u[:, i - 1] if i else ca.SX.zeros(n_u)
        residuals.append(weight[:, i] * (z[:, i] - outputs(robot, x, before, p)))
    residuals, unknowns = ca.vertcat(*residuals), ca.veccat(first, u)
    given = ca.veccat(z, weight, guess, sigma)
    newest = ca.vertcat(x, p)
    slope, jacobian = ca.jacobian(newest, unknowns), ca.jacobian(residuals, unknowns)
    problem = dict(x=unknowns, f=ca.sumsqr(residuals) / 2, p=given)
    return ca.nlpsol("mhe", "ipopt", problem, IPOPT), ca.Function(
        "newest", [unknowns, given], [newest, slope, jacobian]
    )


def mhe_by_ipopt(robot, guess, z, dt=DT):
    """The optimum of all samples z (n, n_z), NaN where one is missing, with the guess as the prior:
    newest x, u, p and the covariance of (x, p), and how many parameters are at a bound.
    """
    n_x, n_u, n_p = map(len, (robot.states, robot.inputs, robot.parameters))
    intervals = len(z) - 1
    solver, newest = mhe_nlp(robot, intervals, dt)
    low, high = (
        np.concatenate([np.full(n_x, fill), bounds, np.full(n_u * intervals, fill)])
        for fill, bounds in zip((-np.inf, np.inf), limits(robot))
    )
    weight = np.where(np.isnan(z), 0, 1 / np.array(robot.sigma_v))
    weight[0, reads_inputs(robot)] = 0
    measured = [
        z[1:, robot.outputs.index(name)] if name in robot.outputs else np.zeros(intervals)
        for name in robot.inputs
    ]
    given = np.concatenate(
        [np.nan_to_num(z).ravel(), weight.ravel(), guess, np.array(robot.sigma_guess)]
    )
    start = np.clip(np.concatenate([guess, np.transpose(measured).ravel()]), low, high)
    solution = solver(x0=start, lbx=low, ubx=high, p=given)
    assert solver.stats()["return_status"] in SOLVED, solver.stats()["return_status"]
    optimum = flat(solution["x"])
    last, slope, jacobian = (np.array(each) for each in newest(optimum, given))
    covariance = slope @ np.linalg.solve(jacobian.T @ jacobian, slope.T)
    p = optimum[n_x : n_x + n_p]
    at_bounds = np.sum(np.minimum(p - low[n_x : n_x + n_p], high[n_x : n_x + n_p] - p) < 1e-7)
    return dict(
        x=last[:n_x, 0],
        u=optimum[len(optimum) - n_u :],
        p=p,
        covariance=covariance,
        at_bounds=at_bounds,
    )


def window_by_ipopt(robot, guess, z, sigma_w=None, state_bounds=None, dt=DT):
    """Moving horizon estimation of all samples z (n, n_z), none missing, with states and parameters
    of each node as unknowns: the newest x, u, p, and the states (n_x, n) of the window.

    Process noise has the standard deviations sigma_w (n, n_x + n_p), none of them 0, a row for each
    sample; None: there is none. Bounds of states hold at all nodes, those of parameters at the
    newest one or, where both change within the window, at all nodes.
    """
    n_x, n_u, n_p = map(len, (robot.states, robot.inputs, robot.parameters))
    opti = ca.Opti()
    s, u = opti.variable(n_x + n_p, len(z)), opti.variable(n_u, len(z))
    cost = ca.sumsqr((s[:, 0] - guess) / robot.sigma_guess)
    counts = ~reads_inputs(robot)
    for k, row in enumerate(z):
        if k:
            x, p = s[:n_x, k - 1], s[n_x:, k - 1]
            missing = s[:, k] - ca.vertcat(runge_kutta(robot, x, u[:, k], p, dt), p)
            if sigma_w is None:
                opti.subject_to(missing == 0)
            else:
                cost += ca.sumsqr(missing / sigma_w[k])
        measured = outputs(robot, s[:n_x, k], u[:, k], s[n_x:, k])
        cost += ca.sumsqr((counts | (k > 0)) * (row - measured) / robot.sigma_v)
    opti.minimize(cost / 2 + 1e-3 * ca.sumsqr(u[:, 0]))  # the last: no interval ends with it
    for row, name in enumerate(robot.states):
        if name in (state_bounds or {}):
            low, high = state_bounds[name]
            opti.subject_to(opti.bounded(low, ca.vec(s[row, :]), high))
    for row, (low, high) in enumerate(limits(robot).T, start=n_x):
        if np.isfinite([low, high]).any():
            bounded = s[row, -1] if sigma_w is None or not state_bounds else ca.vec(s[row, :])
            opti.subject_to(opti.bounded(low, bounded, high))
    opti.set_initial(s, np.tile(np.array(guess)[:, None], (1, len(z))))
    inputs = [z[:, robot.outputs.index(name)] for name in robot.inputs if name in robot.outputs]
    if len(inputs) == n_u:
        opti.set_initial(u, np.array(inputs))
    opti.solver("ipopt", IPOPT)
    solution = opti.solve()
    found = solution.value(s).reshape(n_x + n_p, -1)
    u = solution.value(u).reshape(n_u, -1)
    return dict(x=found[:n_x, -1], u=u[:, -1], p=found[n_x:, -1], states=found[:n_x])


@functools.cache
def mpc_nlp(robot, intervals=N, dt=DT):
    """Model predictive control over so many intervals, for IPOPT. Unknowns: the inputs, interval by
    interval.
    """
    n_x, n_u, n_p = map(len, (robot.states, robot.inputs, robot.parameters))
    u, first, p = ca.SX.sym("u", n_u, intervals), ca.SX.sym("first", n_x), ca.SX.sym("p", n_p)
    x_ref, u_ref = ca.SX.sym("x_ref", n_x, intervals + 1), ca.SX.sym("u_ref", n_u, intervals)
    q, qn, r = ca.SX.sym("q", n_x), ca.SX.sym("qn", n_x), ca.SX.sym("r", n_u)
    cost, x = 0, first
    for i in range(intervals):
        cost += ca.dot(r, (u[:, i] - u_ref[:, i]) ** 2)
        x = runge_kutta(robot, x, u[:, i], p, dt)
        cost += ca.dot(q if i + 1 < intervals else qn, (x - x_ref[:, i + 1]) ** 2)
    given = ca.veccat(first, p, x_ref, u_ref, q, qn, r)
    return ca.nlpsol("mpc", "ipopt", dict(x=ca.vec(u), f=cost / 2, p=given), IPOPT)


def mpc_by_ipopt(robot, x, p, x_ref, u_ref, command=None, dt=DT):
    """The optimal inputs (n_u, N); those that are not commanded stay at their reference."""
    solver, intervals = mpc_nlp(robot, u_ref.shape[1], dt), u_ref.shape[1]
    free = [name in (robot.inputs if command is None else command) for name in robot.inputs]
    bounds = np.array([robot.bounds[name] for name in robot.inputs])
    low, high = (np.where(np.array(free)[:, None], each[:, None], u_ref) for each in bounds.T)
    weights = [robot.q, robot.qn_factor * np.array(robot.q), robot.r]
    solution = solver(
        x0=flat(np.clip(u_ref, low, high)),
        lbx=flat(low),
        ubx=flat(high),
        p=np.concatenate([flat(each) for each in (x, p, x_ref, u_ref, *weights)]),
    )
    assert solver.stats()["return_status"] in SOLVED, solver.stats()["return_status"]
    return flat(solution["x"]).reshape(intervals, -1).T


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


# The linear robot: its Kalman filter


def cart_matrices(dt=DT):
    """A (3, 3) and B (3, 1) of (position, velocity, bias) over one interval, by hand."""
    A = np.array([[1, dt, -(dt**2) / 2], [0, 1, -dt], [0, 0, 1]])
    return A, np.array([[dt**2 / 2], [dt], [0]])


def kalman_filter(z, guess, sigma_guess, sigma_v, sigma_w, leaving, dt=DT):
    """The cart's Kalman filter over z (n, 2) = (position, acceleration): mean (3,) and covariance
    (3, 3) of (position, velocity, bias), and the newest input's mean.

    The measured input drives the prediction, and its noise passes through B. Process noise enters
    in the first `leaving` intervals only: those that have left the window. Its sigma_w is (3,), or
    (n, 3) with a row for the interval that ends with each sample.
    """
    sigma_w = np.broadcast_to(sigma_w, (len(z), 3))
    (A, B), H = cart_matrices(dt), np.array([[1.0, 0, 0, 0]])
    m, P = np.append(guess, 0.0), np.diag([*np.square(sigma_guess), 0.0])  # with the input last
    for i, (position, acceleration) in enumerate(z):
        if i:
            W = np.diag([*np.square(sigma_w[i]), 0.0]) * (i <= leaving)
            F, G = np.block([[A, np.zeros((3, 1))], [np.zeros((1, 4))]]), np.vstack([B, [[1.0]]])
            m = F @ m + G[:, 0] * acceleration
            P = F @ P @ F.T + G @ G.T * sigma_v[1] ** 2 + W
        if not np.isnan(position):
            S = H @ P @ H.T + sigma_v[0] ** 2
            K = P @ H.T / S
            m, P = m + K[:, 0] * (position - m[0]), P - K @ H @ P
    return m[:3], P[:3, :3], m[3]
