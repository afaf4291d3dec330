"""Problems that others published, as models of a few lines, each beside IPOPT.

Weights, bounds, lengths and noise follow the source that each function names. Where `rhec.Model`
or `rhec.RHC` cannot say what the source does, its docstring tells the difference.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from notebooks.studies.ipopt import PlanProblem, WindowProblem, next_state
from rhec.core.controller.bounds import Bound
from rhec.core.controller.rhc import RHC
from rhec.core.estimator.rhe import RHE
from rhec.core.model.robot_model import Model


class ControlProblem(NamedTuple):
    """A system to be steered from `start` to `goal`."""

    options: dict  # of rhec.RHC
    start: tuple
    goal: tuple  # desired state
    samples: int
    iterations: int = 1  # of a sample after the first


class EstimationProblem(NamedTuple):
    """A system to be estimated; its estimator has the true standard deviations of the sensors."""

    options: dict  # of rhec.RHE
    start: tuple
    inputs: np.ndarray  # true inputs (samples, n_u)


class Drive(NamedTuple):
    """A closed loop, and its first problem solved to convergence by RHC and by IPOPT."""

    x: np.ndarray  # (samples + 1, n_x)
    u: np.ndarray  # (samples, n_u)
    cost: float  # of the plan by rhec.RHC.solve, cold
    ipopt: float  # of the plan by IPOPT


# Controllers


def pendulum():
    """The swing-up of a pendulum on a cart, after acados' first example (N = 40)."""

    def f(x, u, p):
        _, theta, v, w = ca.vertsplit(x)
        sin = ca.sin(theta)
        cos = ca.cos(theta)
        mass = 1.1 - 0.1 * cos**2
        a = (-0.08 * sin * w**2 + 0.981 * cos * sin + u) / mass
        turn = (-0.08 * cos * sin * w**2 + u * cos + 10.791 * sin) / (0.8 * mass)
        return ca.vertcat(v, w, a, turn)

    states = ("p_m", "theta_rad", "v_mps", "w_radps")
    model = Model(states=states, inputs=("force_N",), parameters={}, outputs=states, f=f)
    options = dict(model=model, command=("force_N",), bounds={"force_N": (-80.0, 80.0)})
    options |= dict(q=(2e3, 2e3, 2e-2, 2e-2), r=(2e-2,), qn_factor=1.0, dt=0.025, horizon=40)
    return ControlProblem(options, (0.0, np.pi, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), 120)


# Controllers with bounds on states or outputs


def obstacle(discrete=True):
    """A unicycle that drives around an obstacle, after Mehrez (N = 14), by Euler's rule as there.

    With discrete=False, it is integrated by Runge and Kutta's.
    """

    def f(x, u, p):
        slope = ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])
        return x + 0.2 * slope if discrete else slope

    names = dict(states=("x_m", "y_m", "theta_rad"), inputs=("v_mps", "w_radps"))
    model = Model(**names, parameters={}, outputs=("x_m", "y_m"), f=f, discrete=discrete)
    outputs = {"distance_m": lambda x, u, p: ca.hypot(x[0] - 0.5, x[1] - 0.5)}
    bounds = dict(v_mps=(-0.6, 0.6), w_radps=(-np.pi / 4, np.pi / 4), distance_m=(0.3, np.inf))
    bounds |= dict(x_m=(-2.0, 2.0), y_m=(-2.0, 2.0))
    options = dict(model=model, command=model.inputs, bounds=bounds, outputs=outputs)
    options |= dict(q=(1.0, 5.0, 0.1), qn=(0.0,) * 3, r=(0.5, 0.05), dt=0.2, horizon=14)
    return ControlProblem(options, (0.0, 0.0, 0.0), (1.5, 1.5, 0.0), 100, 3)


def lotka_volterra():
    """Prey whose inflow keeps predators above a number, after OpEn (N = 20), from another start."""

    def f(x, u, p):
        prey = (0.6 * x[0] - 0.05 * x[0] * x[1]) / (1 + 0.1 * x[0]) + u
        return ca.vertcat(prey, (0.95 * x[1] - 0.1 * x[0] * x[1]) / (1 + 0.1 * x[1]))

    names = dict(states=("prey", "predators"), inputs=("inflow",))
    model = Model(**names, parameters={}, outputs=("prey",), f=f, discrete=True)
    bounds = dict(predators=Bound(0.05, np.inf, quadratic=3e3))
    options = dict(model=model, command=model.inputs, bounds=bounds, dt=1.0, horizon=20)
    options |= dict(q=(1.5, 0.0), qn=(2.0, 0.0), r=(0.1,))
    return ControlProblem(options, (1.0, 0.1), (0.2, 0.0), 60)


def cstr():
    """A stirred tank reactor that is to make 0.6 mol/l of B, after do-mpc, for nominal kinetics."""

    def f(x, u, p):
        kelvin = x[2] + 273.15
        k1 = 1.287e12 * ca.exp(-9758.3 / kelvin)
        k3 = 9.043e9 * ca.exp(-8560.0 / kelvin)
        rates = ca.vertcat(k1 * x[0], k1 * x[1], k3 * x[0] ** 2)  # A -> B -> C, 2 A -> D
        heat = ca.dot(ca.DM([4.2, -11.0, -41.85]), rates) / -2.811942
        cooling = 866.88 * (x[3] - x[2])
        flow = 60 * u[0]
        warming = heat + flow * (130.0 - x[2]) + cooling / 28.14753942
        a = flow * (5.1 - x[0]) - rates[0] - rates[2]
        return [a, rates[0] - rates[1] - flow * x[1], warming, 100 * u[1] - cooling / 10]

    names = dict(
        states=("a_mol_l", "b_mol_l", "reactor_C", "jacket_C"), inputs=("flow_per_min", "heat_MJ_h")
    )
    model = Model(**names, parameters={}, outputs=("b_mol_l",), f=f)
    soft = Bound(50.0, 140.0, linear=100.0)
    bounds = dict(flow_per_min=(5 / 60, 100 / 60), heat_MJ_h=(-8.5, 0.0), reactor_C=soft)
    bounds |= dict(a_mol_l=(0.1, 2.0), b_mol_l=(0.1, 2.0), jacket_C=(50.0, 140.0))
    options = dict(model=model, command=model.inputs, bounds=bounds, dt=0.005, horizon=20)
    options |= dict(q=(0.0, 2.0, 0.0, 0.0), qn_factor=1.0, r=(0.0, 0.0), r_delta=(0.072, 5e-4))
    return ControlProblem(options, (0.8, 0.5, 134.14, 130.0), (0.0, 0.6, 0.0, 0.0), 50)


# Estimators


def range_bearing():
    """A robot that sees one landmark, at the origin, after Mehrez' MHE; without bounds on θ."""

    def f(x, u, p):
        return ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])

    def h(x, u, p):
        return ca.vertcat(ca.hypot(x[0], x[1]), ca.atan2(x[1], x[0]))

    names = ("x_m", "y_m", "theta_rad"), ("v_mps", "w_radps")
    outputs = ("range_m", "bearing_rad", *names[1])
    model = Model(
        states=names[0], inputs=names[1], parameters={}, outputs=outputs, f=f, h=h,
        angles=("bearing_rad",),
    )  # fmt: skip
    options = dict(model=model, dt=0.2, horizon=10, arrival_mean="filtered")
    options |= dict(sigma_v=(0.1, 0.035, 0.005, 0.035), sigma_w=(0.0, 0.0, 0.0))
    options |= dict(guess=(0.1, 0.3, 0.0), sigma_guess=(0.3, 0.3, 0.3))
    turning = 0.6 * np.sign(np.sin(0.08 * np.arange(120)))
    inputs = np.column_stack([0.4 + 0.1 * np.cos(0.1 * np.arange(120)), turning])
    return EstimationProblem(options, (0.2, 0.1, 0.2), inputs)


def mass_on_a_spring():
    """A mass on a spring, CasADi's own MHE example, as the Kalman filter that it should be.

    The force is known up to white noise: that is a measured input with this standard deviation.
    """

    def f(x, u, p):
        return ca.vertcat(x[1], u - x[0] - 0.5 * x[1])

    states = ("position_m", "velocity_mps")
    outputs = ("position_m", "force_N")
    model = Model(states=states, inputs=("force_N",), parameters={}, outputs=outputs, f=f)
    options = dict(model=model, dt=0.05, horizon=10, arrival_mean="filtered")
    options |= dict(sigma_v=(0.005, 0.1), sigma_w=(0.0, 0.0))
    options |= dict(guess=(1.0, 0.0), sigma_guess=(0.01, 0.01))
    return EstimationProblem(options, (1.0, 0.0), np.cos(0.05 * np.arange(400))[:, None])


# Loops


def drive(problem):
    """Solve a ControlProblem's first sample to convergence, and drive on: a Drive."""
    rhc = RHC(**problem.options)
    model = problem.options["model"]
    reference = PlanProblem(problem.options)
    step = next_state(model, problem.options["dt"])
    rest = dict(p=np.zeros(0), u_ref=np.zeros(len(model.inputs)))
    xs = [np.array(problem.start)]
    goal = np.array(problem.goal)
    us = [rhc.solve(xs[0], x_ref=goal, **rest, iterations=100)]
    plans = reference.cost(xs[0], goal, rhc.u_plan), reference.solve(xs[0], goal).cost
    for _ in range(problem.samples - 1):
        xs.append(step(xs[-1], us[-1], []).full().ravel())
        rhc.prepare()
        given = dict(x=xs[-1], x_ref=goal, **rest)
        if problem.iterations == 1:
            us.append(rhc.feedback(**given))
        else:
            us.append(rhc.solve(**given, iterations=problem.iterations))
    xs.append(step(xs[-1], us[-1], []).full().ravel())
    return Drive(np.array(xs), np.array(us), *plans)


def estimate(problem, seed=0):
    """The newest state of the last window on simulated measurements, by rhec.RHE and by IPOPT.

    Before it, the RHE takes one iteration a sample.
    """
    options = problem.options
    model = options["model"]
    rhe = RHE(**options)
    step = next_state(model, options["dt"])
    rng = np.random.default_rng(seed)
    x = np.array(problem.start)
    z = []
    for k, u in enumerate(problem.inputs):
        if k:  # a measured input belongs to the interval that ends with the sample
            x = step(x, u, []).full().ravel()
        exact = model.measurement(x, u, []).full().ravel()
        z.append(exact + rng.normal(size=len(exact)) * options["sigma_v"])
        rhe.prepare()
        m, P = (rhe.iteration.current[name].copy() for name in "mP")
        rhe.feedback(z[-1])
    N = options["horizon"]
    window = WindowProblem(model, N, options["dt"])
    H = np.linalg.inv(P.reshape(m.size, m.size))
    by_ipopt = window.solve(np.array(z[-N - 1 :]), m, H, options["sigma_v"]).newest
    return rhe.solve(z[-1], iterations=30).x, by_ipopt
