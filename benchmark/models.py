"""The two systems that all contestants know, in CasADi alone: acados reads them in a process and
an environment of its own. Every output is an entry of the joint state (x, p), or the input.
"""

import casadi as ca

COOLING = 0.05  # of a node of the rod, by the third power of its temperature


def robot(x, u, p):
    """The paper's robot, eq. (2): x = (x, y, θ), u = ω, p = (ν, μ, κ)."""
    nu, mu, kappa = (p[i] for i in range(3))
    return ca.vertcat(mu * nu * ca.cos(x[2]), mu * nu * ca.sin(x[2]), kappa * u)


def rod(x, u, p):
    """A rod of any number of nodes with temperatures x, heated to u at one end, insulated at the
    other; its conductivity p is unknown.

        ẋ_i = p (x_{i-1} - 2 x_i + x_{i+1}) - COOLING x_i³
    """
    warmer = ca.vertcat(u, x[:-1])
    colder = ca.vertcat(x[1:], x[-1])
    return p[0] * (warmer - 2 * x + colder) - COOLING * x**3


SYSTEMS = {"robot": robot, "rod": rod}


def runge_kutta(f, x, u, p, dt_s):
    """x one interval later, by one step of Runge and Kutta."""
    k1 = f(x, u, p)
    k2 = f(x + dt_s / 2 * k1, u, p)
    k3 = f(x + dt_s / 2 * k2, u, p)
    k4 = f(x + dt_s * k3, u, p)
    return x + dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
