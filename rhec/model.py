"""System model with traction coefficients (paper, Sec. "System Model with Traction Coefficients").

State ξ = (x, y, θ) [m, m, rad], input u = ω [rad/s], parameters p = (ν, μ, κ) [m/s, 1, 1], output z = (x, y, ν, ω).

RHE and RHC both work on the *joint state* s = (ξ, p): within a window the parameters are constant, so they are states that do
not move. The paper takes the speed ν as one such constant (`speed_model="parameter"`); with `speed_model="input"` it is a
measured input of each interval instead (reading R13).
"""

import functools
from typing import NamedTuple

import casadi as ca


def f(xi, u, p):
    """Eq. (systemmodel): ξ̇ = f(ξ, u, p) = (μν cos θ, μν sin θ, κω). Shapes (3,), (), (3,) -> (3,); SI units."""
    theta, omega = xi[2], u
    nu, mu, kappa = p[0], p[1], p[2]
    return ca.vertcat(mu * nu * ca.cos(theta), mu * nu * ca.sin(theta), kappa * omega)


def rk4(xi, u, p, dt_s):
    """One classical Runge-Kutta step of `f` over `dt_s` [s], u and p held: ξ(t) -> ξ(t + dt_s)."""
    k1 = f(xi, u, p)
    k2 = f(xi + dt_s / 2 * k1, u, p)
    k3 = f(xi + dt_s / 2 * k2, u, p)
    k4 = f(xi + dt_s * k3, u, p)
    return xi + dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


class Interval(NamedTuple):
    """One shooting interval of the joint state s, with the indices that say which entry is what."""

    step: ca.Function        # (s, v, dt_s) -> s at the end of the interval
    linearised: ca.Function  # (s, v, dt_s) -> (the same, D = ∂s⁺/∂s - 1, which has fewer entries, B = ∂s⁺/∂v)
    n_s: int                 # length of s
    n_v: int                 # length of v, the inputs of an interval
    states: tuple            # places of (x, y, θ, ν, μ, κ) that s holds
    measured_states: tuple   # (place in s, place in z) of each output that measures s
    measured_inputs: tuple   # (place in v, place in z) of each output that measures v
    traction: tuple          # places of (μ, κ) in s


@functools.cache
def interval(speed_model="parameter"):
    """The shooting interval for a speed model: s = (ξ, ν, μ, κ), v = ω, or s = (ξ, μ, κ), v = (ν, ω)."""
    dt_s = ca.SX.sym("dt_s")
    xi = ca.SX.sym("xi", 3)
    nu, mu, kappa, omega = (ca.SX.sym(name) for name in ("nu", "mu", "kappa", "omega"))
    if speed_model == "parameter":
        p, v = ca.vertcat(nu, mu, kappa), omega
        states, measured_states, measured_inputs = (0, 1, 2, 3, 4, 5), ((0, 0), (1, 1), (3, 2)), ((0, 3),)
    else:
        p, v = ca.vertcat(mu, kappa), ca.vertcat(nu, omega)
        states, measured_states, measured_inputs = (0, 1, 2, 4, 5), ((0, 0), (1, 1)), ((0, 2), (1, 3))
    s = ca.vertcat(xi, p)
    s_next = ca.vertcat(rk4(xi, omega, ca.vertcat(nu, mu, kappa), dt_s), p)
    return Interval(
        step=ca.Function("interval", [s, v, dt_s], [s_next]),
        linearised=ca.Function("linearised", [s, v, dt_s], [s_next, ca.sparsify(ca.jacobian(s_next, s) - ca.SX.eye(s.numel())), ca.jacobian(s_next, v)], {"cse": True}),
        n_s=s.numel(), n_v=v.numel(), states=states, measured_states=measured_states, measured_inputs=measured_inputs,
        traction=(s.numel() - 2, s.numel() - 1))
