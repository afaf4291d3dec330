"""Published control problems with bounds on states and outputs, for the gallery.

Weights, bounds and lengths follow the source that each function names. Where `rhec.Model` or
`rhec.RHC` cannot say what the source does, the docstring tells the difference.
"""

import casadi as ca
import numpy as np

from notebooks.further.gallery import ControlProblem
from rhec.core.controller.bounds import Bound
from rhec.core.model.base import Model


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
