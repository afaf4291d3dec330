"""The sign that a robot is thought to be turned round: a parameter as if below its lower bound.

A robot that drives with the traction μ ≥ 0 in the direction θ leaves the same positions as one with
-μ in the direction θ + π. Where θ is more than a quarter turn off, the window therefore drives best
at μ = 0. There no position tells anything of θ, and the estimate lags behind the robot until both
happen to have turned differently. Without bounds the window would be right, with μ below 0. With
q̂ the parameters of the solution without bounds, P_q their covariance, and q within the bounds,

    (q̂ - q)_μ² / (P_q)_μμ > limit  and  q̂_μ < q_μ,  with  q̂ - q = P_q λ  by the multipliers λ,

happens with no more than the limit's share of the windows of a robot whose μ is at 0 or above: the
left side has the distribution χ² with one degree of freedom where μ is at 0. Such an estimate is
not `ok`. An absurd speed measurement can bring it about for as long as the window holds it. After
more samples that say so than a window holds, the robot is turned round, and the window restarts.
Only a full window that does not say so takes back what was counted: a window that is turned round
may restart again and again because it rejects its samples.
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

    def is_seen(self, window, result, limit):
        """Whether the window says so (1 or 0).

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

    def counted(self, window, given, is_seen):
        """After how many samples it was seen, this one included.

        Args:
            window: The rhe.Window.
            given: {name: expression} of before this sample: how many there were, as `turned`, and
                the window's age.
            is_seen: Whether this sample's window says so.
        """
        before = given["turned"] * (1 - self.is_certain(window, given["turned"]))
        unless = before * (given["age"] < window.N)
        return ca.if_else(is_seen, before + 1, unless)

    def is_certain(self, window, turned):
        """Whether so many samples say so that no window holds them all."""
        return turned > window.N + 1

    def turned(self, window, s, turned):
        """The joint state s (n_s,), half a turn on where so many samples make it certain."""
        s = ca.SX(s)
        place = window.model.joint_names.index(self.state)
        s[place] += ca.pi * self.is_certain(window, turned)
        return s
