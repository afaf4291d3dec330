"""The signs that a robot is thought to be turned round, by half a turn.

**It drives away from where it is predicted.** Beside the window the judge predicts where the robot
would be if its heading had been half a turn off since the last sample that was used. A restart at a
sample that agrees with this prediction, while it contradicts that of the window, begins there.

**A parameter seems to be below its lower bound.** A robot that drives with the traction μ ≥ 0 in
the direction θ leaves the same positions as one with -μ in the direction θ + π. Where θ is more
than a quarter turn off, the window therefore drives best at μ = 0. There no position tells anything
of θ, and the estimate lags behind the robot until both happen to have turned differently. Without
bounds the window would be right, with μ below 0. With q̂ the parameters of the solution without
bounds, P_q their covariance, and q within the bounds,

    (q̂ - q)_μ² / (P_q)_μμ > limit  and  q̂_μ < q_μ,  with  q̂ - q = P_q λ  by the multipliers λ,

happens with no more than the limit's share of the windows of a robot whose μ is at 0 or above: the
left side has the distribution χ² with one degree of freedom where μ is at 0. Such an estimate is
not `ok`. An absurd speed measurement can bring it about for as long as the window holds it. After
more samples that say so than a window holds, the robot is turned round, and the window restarts.
Only a full window that does not say so takes back what was counted: a window that is turned round
may restart again and again because it rejects its samples. All of the samples of one that restarts
before it is full count, too.
"""

import functools
from typing import NamedTuple

import casadi as ca
import numpy as np

_POINTS = 8  # random ones, at which two models are compared
_TOLERANCE = 1e-9


class HalfTurn(NamedTuple):
    """What a Model would look like that is turned round, by names."""

    state: str  # that is half a turn off: an angle [rad]
    parameter: str | None = None  # that is below its lower bound then

    def has_parameter(self, window):
        """Whether the window has this parameter within bounds, and knows their multipliers."""
        bounds = window.model.parameters.get(self.parameter)
        return bool(bounds) and not window.model.state_bounds

    def is_seen(self, window, result, limit):
        """Whether the parameter says so (1 or 0).

        Args:
            window: The rhe.Window.
            result: {name: expression} of the feedback: the multipliers (n_q,) λ, and the newest
                node's covariance (n_s, n_s) without the bounds.
            limit: The quantile of χ².
        """
        places = [*window.interval.bounds]
        place = window.model.joint_names.index(self.parameter)
        of_parameter = result["covariance"][place, :]
        beyond = of_parameter[places] @ result["multipliers"]
        return (beyond < 0) * (beyond**2 > limit * of_parameter[place])

    def counted(self, window, given, is_seen, restart):
        """After how many samples it was seen, this one included.

        Args:
            window: The rhe.Window.
            given: {name: expression} of before this sample: how many there were, as `turned`, and
                the window's age.
            is_seen: Whether this sample's window says so.
            restart: Whether the window starts anew with this sample, so that it is not full.
        """
        before = given["turned"] * (1 - self.is_certain(window, given["turned"]))
        is_young = given["age"] < window.N
        unless = before * ca.logic_or(is_young, restart)
        return ca.if_else(is_seen, before + 1, unless) + restart * is_young * given["age"]

    def is_certain(self, window, turned):
        """Whether so many samples say so that no window holds them all."""
        return turned > window.N + 1

    def turned(self, window, s, is_turned):
        """The joint state s (n_s,), half a turn on where it is turned."""
        is_heading = ca.DM([name == self.state for name in window.model.joint_names])
        return s + ca.pi * is_heading * is_turned


@functools.cache
def of_model(model):
    """The HalfTurn of a Model that names its heading, else None."""
    if model.heading is None:
        return None
    bounded = (name for name, bounds in model.parameters.items() if bounds)
    return HalfTurn(model.heading, next(filter(_mirrors(model), bounded), None))


def _mirrors(model):
    """Whether a parameter of opposite sign is half a turn of the Model's heading, by its name.

    f(x with θ + π, u, p with -p_j) = f(x, u, p) at random points, and not so with p_j itself.
    """
    rng = np.random.default_rng(0)
    shapes = [len(names) for names in (model.states, model.acting, model.parameters)]
    points = [[rng.uniform(0.2, 1.0, n) for n in shapes] for _ in range(_POINTS)]
    turn = np.pi * (np.array(model.states) == model.heading)

    def slopes(x, u, p):
        return np.array(model.dynamics(x, u, p)).ravel()

    def is_same(one, other):
        return np.allclose(one, other, rtol=_TOLERANCE, atol=_TOLERANCE)

    def mirrors(name):
        sign = np.where(np.array([*model.parameters]) == name, -1.0, 1.0)
        here = np.array([slopes(x, u, p) for x, u, p in points])
        there = np.array([slopes(x + turn, u, p * sign) for x, u, p in points])
        turned = np.array([slopes(x + turn, u, p) for x, u, p in points])
        return is_same(here, there) and not is_same(here, turned)

    return mirrors
