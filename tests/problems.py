"""The window's and the horizon's nonlinear problems, written down once more for IPOPT, and random
instances of them.

Nothing here uses `rhec` beyond the paper's constants. Where θ is linear in time, as here, one
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
    """Eq. (mhe) for a window of so many intervals, to be solved by IPOPT. Unknowns: s_0, then all
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
        given = dict(memory) | settings | newest
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
