"""System model with traction coefficients (paper, Sec. "System Model with Traction Coefficients").

State ξ = (x, y, θ) [m, m, rad], input u = ω [rad/s], parameters p = (ν, μ, κ) [m/s, 1, 1], output z
= (x, y, ν, ω).

RHE and RHC both work on the *joint state* s = (ξ, p): within a window the parameters are constant,
so they are states that do not move. The paper takes the speed ν as one such constant
(`speed_model="parameter"`); with `speed_model="input"` it is a measured input of each interval
instead (reading R13). `"slipping"` goes beyond the paper, for recorded robots: every interval has a
side slip speed η of its own, and where the antenna is on the robot is estimated, too.
"""

import functools
from typing import NamedTuple

import casadi as ca


def f(xi, u, p):
    """Eq. (systemmodel): ξ̇ = f(ξ, u, p) = (μν cos θ, μν sin θ, κω). Shapes (3,), (), (3,) -> (3,);
    SI units.
    """
    theta, omega = xi[2], u
    nu, mu, kappa = p[0], p[1], p[2]
    return ca.vertcat(mu * nu * ca.cos(theta), mu * nu * ca.sin(theta), kappa * omega)


SIDE_SLIP_S = 0.1  # of two recorded skid-steered robots, a wheeled and a tracked one, alike


def f_slipping(xi, v, p):
    """The same for v = (ν, ω, η) where tracks slip sideways, by SIDE_SLIP_S times the lateral
    acceleration and a speed η [m/s], and (x, y) is an antenna l_f ahead and l_l left of the robot's
    centre of turning: p = (l_f, l_l, μ, κ). Shapes (3,), (3,), (4,) -> (3,).
    """
    nu, omega, eta = v[0], v[1], v[2]
    l_f, l_l, mu, kappa = p[0], p[1], p[2], p[3]
    ahead, left = mu * nu - kappa * omega * l_l, eta + kappa * omega * (l_f - SIDE_SLIP_S * mu * nu)
    cos, sin = ca.cos(xi[2]), ca.sin(xi[2])
    return ca.vertcat(ahead * cos - left * sin, ahead * sin + left * cos, kappa * omega)


def rk4(f, xi, u, p, dt_s):
    """One classical Runge-Kutta step of f(ξ, u, p) over `dt_s` [s], u and p held: ξ(t) -> ξ(t +
    dt_s).
    """
    k1 = f(xi, u, p)
    k2 = f(xi + dt_s / 2 * k1, u, p)
    k3 = f(xi + dt_s / 2 * k2, u, p)
    k4 = f(xi + dt_s * k3, u, p)
    return xi + dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


class Interval(NamedTuple):
    """One shooting interval of the joint state s, with the indices that say which entry is what."""

    step: ca.Function  # (s, v, dt_s) -> s at the end of the interval
    linearised: (
        ca.Function
    )  # (s, v, dt_s) -> (the same, D = ∂s⁺/∂s - 1, which has fewer entries, B = ∂s⁺/∂v)
    n_s: int  # length of s
    n_v: int  # length of v, the inputs of an interval
    states: tuple  # which of (x, y, θ, ν, μ, κ, l_f, l_l) s holds, in its order
    measured_states: tuple  # (place in s, place in z) of each output that measures s
    measured_inputs: tuple  # (place in v, place in z) of each output that measures v
    traction: tuple  # places of (μ, κ) in s
    slips: bool  # whether process noise is the tracks' slip, in proportion to how far they ran


@functools.cache
def interval(speed_model="parameter"):
    """The shooting interval for a speed model: s = (ξ, ν, μ, κ), v = ω; or s = (ξ, μ, κ), v = (ν,
    ω); or s = (ξ, l_f, l_l, μ, κ), v = (ν, ω, η).
    """
    dt_s = ca.SX.sym("dt_s")
    xi = ca.SX.sym("xi", 3)
    nu, mu, kappa, omega, eta, arm = (
        ca.SX.sym(name, length)
        for name, length in dict(nu=1, mu=1, kappa=1, omega=1, eta=1, arm=2).items()
    )
    if speed_model == "parameter":
        p, v = ca.vertcat(nu, mu, kappa), omega
        states, measured_states, measured_inputs = (
            (0, 1, 2, 3, 4, 5),
            ((0, 0), (1, 1), (3, 2)),
            ((0, 3),),
        )
    else:
        p, v = ca.vertcat(mu, kappa), ca.vertcat(nu, omega)
        states, measured_states, measured_inputs = (
            (0, 1, 2, 4, 5),
            ((0, 0), (1, 1)),
            ((0, 2), (1, 3)),
        )
    xi_next = rk4(f, xi, omega, ca.vertcat(nu, mu, kappa), dt_s)
    if speed_model == "slipping":
        p, v, states = ca.vertcat(arm, mu, kappa), ca.vertcat(nu, omega, eta), (0, 1, 2, 6, 7, 4, 5)
        xi_next = rk4(f_slipping, xi, v, p, dt_s)
    s, s_next = ca.vertcat(xi, p), ca.vertcat(xi_next, p)
    return Interval(
        step=ca.Function("interval", [s, v, dt_s], [s_next]),
        linearised=ca.Function(
            "linearised",
            [s, v, dt_s],
            [
                s_next,
                ca.sparsify(ca.jacobian(s_next, s) - ca.SX.eye(s.numel())),
                ca.jacobian(s_next, v),
            ],
            {"cse": True},
        ),
        n_s=s.numel(),
        n_v=v.numel(),
        states=states,
        measured_states=measured_states,
        measured_inputs=measured_inputs,
        traction=(s.numel() - 2, s.numel() - 1),
        slips=speed_model == "slipping",
    )
