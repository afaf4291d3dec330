"""The problems that all contestants solve: consecutive samples of one closed loop, each with the
answer at convergence.

Two systems make them: the paper's robot, with any horizon, and a heated rod, with any number of
states.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import rhec
from benchmark import models
from rhec import paper
from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.tracked_robot import tuning
from rhec.tracked_robot.tuning import DEFAULT_RULE

POSE = ("x_m", "y_m", "theta_rad")
READINGS = ("x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps")
PAPERS_SIZE = (15, 3)  # intervals, states


class Case(NamedTuple):
    """A system with a size: one estimation and one control problem for all contestants.

    min ½ ‖s_0 - m‖²_H + ½ Σ ‖(z_i - h(s_i, u_{i-1})) / σ_v‖², with s = (x, p) and p within its
    bounds at the newest node; and
    min ½ Σ ‖x_i - x_r,i‖²_Q + ½ ‖x_N - x_r,N‖²_{QN} + ½ Σ R (u_i - u_r,i)² with |u_i| ≤ u_max.
    """

    system: str  # of models.SYSTEMS
    model: rhec.Model
    horizon: int  # intervals of both problems
    sigma_v: tuple
    q: tuple
    qn_factor: float
    r: float
    u_max: float
    measured: tuple  # the entries of s that are measured; the last output is the input
    options: dict  # of rhec's estimator, apart from its guess
    papers: bool  # whether rhec's own objects for the paper's robot solve it

    @property
    def name(self):
        """What it is called in tables."""
        return f"{self.system}, {len(self.model.states)} states, {self.horizon} intervals"

    @property
    def builds(self):
        """Which of rhec's Functions estimate and control."""
        return (rhe.build_live_phases if self.papers else rhe.build_solvable), rhc.build_phases

    def live(self, guess):
        """rhec's estimator and controller as they begin.

        Args:
            guess: First guess of s.
        """
        shape = dict(horizon=self.horizon)
        if self.papers:
            return rhec.RHE(guess=tuple(guess), **shape), rhec.RHC(**shape)
        shape |= dict(model=self.model, dt=paper.DT_S)
        estimator = rhec.RHE(guess=tuple(guess), sigma_v=self.sigma_v, **self.options, **shape)
        weights = dict(q=self.q, qn_factor=self.qn_factor, r=(self.r,))
        bounds = {self.model.inputs[0]: (-self.u_max, self.u_max)}
        return estimator, rhec.RHC(bounds=bounds, **weights, **shape)

    def joint(self, estimate):
        """s (n_s,) of an estimate."""
        if self.papers:
            return np.array(estimate[:6])
        return np.append(estimate.x, estimate.p)

    def command(self, call, estimate, x_ref, u_ref, **options):
        """Call `feedback` or `solve` of rhec's controller."""
        x, p = np.split(estimate, [len(self.model.states)])
        if self.papers:
            return call(x, p, x_ref, u_ref[0], **options)
        return call(x=x, p=p, x_ref=x_ref, u_ref=u_ref, **options)


class Problem(NamedTuple):
    """One sample, and the optimum of its two nonlinear problems."""

    z: np.ndarray  # (n_z, N+1) the window of measurements, the newest last
    m: np.ndarray  # (n_s,) mean of the arrival cost
    H: np.ndarray  # (n_s, n_s) its weight
    estimate: np.ndarray  # (n_s,) answer at the newest node; the controller starts from it
    x_ref: np.ndarray  # (n_x, N+1)
    u_ref: np.ndarray  # (1, N)
    plan: np.ndarray  # (N,) answer: the inputs


class Loop(NamedTuple):
    """A closed loop that gives a Case its problems."""

    case: Case
    guess: np.ndarray  # (n_s,)
    z: np.ndarray  # (samples, n_z) measurements
    references: Any  # function of (sample, estimate) that returns x_ref and u_ref


def papers_case(horizon=PAPERS_SIZE[0]):
    """The Case of the paper's robot, W and V by prediction.

    Args:
        horizon: Intervals of both problems.
    """
    model = rhec.Model(
        states=POSE,
        inputs=("omega_radps",),
        parameters={"nu_mps": None, "mu": (0.0, 1.0), "kappa": (0.0, 1.0)},
        outputs=("x_m", "y_m", "nu_mps", "omega_radps"),
        f=models.robot,
    )
    return Case(
        system="robot",
        model=model,
        horizon=horizon,
        sigma_v=tuning.NOISES["rhe"][DEFAULT_RULE].sigma_v,
        q=paper.Q3,
        qn_factor=paper.QN_FACTOR,
        r=paper.R,
        u_max=paper.OMEGA_MAX_RADPS,
        measured=(0, 1, 3),
        options={},
        papers=True,
    )


def robot(horizon, samples):
    """A drive of the paper's robot with so many full windows.

    Args:
        horizon: Intervals of both problems.
        samples: How many problems.
    """
    scenario = scenario_of(horizon + samples)
    run = rhec.simulate(scenario)
    guess = np.array([*run.log.loc[0, [*POSE]], scenario.speed_mps, 1.0, 1.0])
    tracker = rhec.PathTracker(run.path, horizon=horizon)
    z = run.log[[*READINGS]].to_numpy()

    def references(k, estimate):
        x_ref, u_ref = tracker.references(estimate, z[k, 3])
        return x_ref.copy(), u_ref[None].copy()

    return Loop(papers_case(horizon), guess, z, references)


def scenario_of(samples):
    """The Scenario of a drive of so many samples."""
    return rhec.Scenario(process_noise=DEFAULT_RULE, duration_s=samples * paper.DT_S)


def rod(states, samples, horizon=PAPERS_SIZE[0]):
    """A rod whose temperature follows a wave, with so many full windows.

    Args:
        states: Nodes of the rod.
        samples: How many problems.
        horizon: Intervals of both problems.
    """
    names = tuple(f"x{i}" for i in range(states))
    measured = tuple(range(states))
    model = rhec.Model(
        states=names,
        inputs=("u",),
        parameters={"p": (0.0, 3.0)},
        outputs=(*(names[i] for i in measured), "u"),
        f=models.rod,
    )
    case = Case(
        system="rod",
        model=model,
        horizon=horizon,
        sigma_v=(0.02,) * (len(measured) + 1),
        q=(30.0,) * states,
        qn_factor=2.0,
        r=3.0,
        u_max=1.0,
        measured=measured,
        # Without noise of the temperatures the arrival cost of many nodes is all but singular.
        options=dict(sigma_w=(0.003,) * states + (0.01,), sigma_guess=(0.3,) * states + (0.5,)),
        papers=False,
    )
    wave = 0.8 * np.sin(0.1 * np.arange(2 * horizon + samples + 1))

    def references(k, estimate):
        return np.tile(wave[k : k + horizon + 1], (states, 1)), wave[None, k : k + horizon]

    z = _heated(case, horizon + samples, references)
    return Loop(case, np.append(np.zeros(states), 0.8), z, references)


def _heated(case, samples, references):
    """Measurements (samples, n_z) of a rod that is steered by its true state."""
    states = len(case.model.states)
    symbols = ca.SX.sym("x", states), ca.SX.sym("u"), ca.SX.sym("p")
    step = ca.Function("step", [*symbols], [models.runge_kutta(models.rod, *symbols, paper.DT_S)])
    rng = np.random.default_rng(0)
    truth = np.append(np.zeros(states), 1.0)
    _, controller = case.live(truth)
    rows = []
    u = 0.0
    for k in range(samples):
        noise = case.sigma_v * rng.normal(size=len(case.sigma_v))
        rows.append([*truth[[*case.measured]], u] + noise)
        controller.prepare()
        u = float(np.ravel(case.command(controller.feedback, truth, *references(k, truth)))[0])
        truth[:-1] = step(truth[:-1], u, truth[-1]).full().ravel()
    return np.array(rows)


def record(loop, iterations=20):
    """The problems of a loop, from the first full window on, each iterated so often."""
    case = loop.case
    N = case.horizon
    estimator, controller = case.live(loop.guess)
    problems = []
    for k, newest in enumerate(loop.z):
        estimator.prepare()
        estimate = case.joint(estimator.solve(newest, iterations))
        references = loop.references(k, estimate)
        controller.prepare()
        case.command(controller.solve, estimate, *references, iterations=iterations)
        if k >= N:
            arrival = estimator.iteration.current
            n_s = len(estimate)
            weight = np.linalg.inv(arrival["P"].reshape(n_s, n_s))
            window = loop.z[k - N : k + 1].T.copy()
            answer = np.ravel(controller.omega_plan if case.papers else controller.u_plan).copy()
            m = arrival["m"].copy()
            problems.append(Problem(window, m, weight, estimate, *references, answer))
    return problems


def with_sums(parts):
    """{(problem, phase): number} with "overall" of each problem and of both."""
    parts = dict(parts)
    for problem in ("RHE", "RHC"):
        phases = [number for (which, _), number in parts.items() if which == problem]
        if len(phases) > 1:
            parts[problem, "overall"] = sum(phases)
    if ("RHE", "overall") in parts:
        parts["RHE + RHC", "overall"] = parts["RHE", "overall"] + parts["RHC", "overall"]
    return parts
