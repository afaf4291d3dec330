"""The sign that a robot is thought to be turned round: a parameter as if below its lower bound.

A robot that drives with the traction μ ≥ 0 in the direction θ leaves the same positions as one with
-μ in the direction θ + π. Where θ is more than a quarter turn off, the window therefore drives best
at μ = 0. There no position tells anything of θ, and the estimate lags behind the robot until both
happen to have turned differently. Without bounds the window would be right, with μ below 0. With
q̂ the parameters of the solution without bounds, P_q their covariance, and q within the bounds,

    (q̂ - q)_μ² / (P_q)_μμ > limit  and  q̂_μ < q_μ,  with  q̂ - q = P_q λ  by the multipliers λ,

happens with no more than the limit's share of the windows of a robot whose μ is at 0 or above: the
left side has the distribution χ² with one degree of freedom where μ is at 0. Such an estimate is
not `ok`. An absurd speed measurement can bring it about for as long as the window holds it. Where
more windows in a row say so, the robot is turned round, and the window restarts.
"""

from typing import NamedTuple

import casadi as ca


class HalfTurn(NamedTuple):
    """What a Model would look like that is turned round, by names."""

    state: str  # that is half a turn off: an angle [rad]
    parameter: str  # that is below its lower bound then

    def is_possible(self, window):
        """Whether the window has this parameter within bounds, and knows their multipliers."""
        bounds = window.model.parameters.get(self.parameter)
        return bool(bounds) and not window.model.state_bounds

    def is_seen(self, window, multipliers, covariance, limit):
        """Whether the window says so (1 or 0).

        Args:
            window: The rhe.Window.
            multipliers: (n_q,) λ of the bounded parameters.
            covariance: (n_s, n_s) of the newest node, without the bounds.
            limit: The quantile of χ².
        """
        places = [*window.interval.bounds]
        place = window.model.joint_names.index(self.parameter)
        beyond = covariance[place, places] @ multipliers
        return (beyond < 0) * (beyond**2 > limit * covariance[place, place])

    def turned(self, window, s, turns):
        """The joint state s (n_s,), half a turn on where `turns` is 1."""
        s = ca.SX(s)
        s[window.model.joint_names.index(self.state)] += ca.pi * turns
        return s
