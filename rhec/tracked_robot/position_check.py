"""Outlier rejection of the paper's RHE: a position that is impossible is not used.

One Gauss-Newton step from a position far away can turn the yaw round, which no later step mends.
With n = NOISES (V_x + V_y), a position z is improbable where it is both

- out of reach of the last position z', which arrived τ s ago, used or not:
  |z - z'|² > (NEAR_M + REACH_MPS τ)² + n, and
- far from its prediction m, where the last one that was used is τ_u s old:
  |z - m|² > (NEAR_M + DRIFT_MPS τ_u)² + n.

Both are far beyond what a drive without a fault does, so that it keeps its bits. While positions
follow each other none is rejected, however wrong the estimate is: a wrong model and a receiver that
is stuck behave as without this check.

An improbable position counts as missing if the CALM positions used before it were new, and within
CLOSE_M of their predictions. So do those after it, until one is near its prediction. But if
AGREEING of them say the same as the one before, by their innovations y = z - m,

    |y - y'|² ≤ (SPREAD_MPS τ)² + n,

then it is the estimate that is wrong: the window restarts at the newest position, with all but the
pose as predicted. So it does after MAX_REJECTION_S. Where smaller outliers came first they have
reached the estimate, and dead reckoning from there would go astray. Then all have the weight that
they have in the paper.

It is not in the paper, whose least squares give each position the same weight. Another judge,
`rhec.tracked_robot.robust`, handles more kinds of faults. The words in capitals are in `Tuned`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, packed_size, short_cut, unpack
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import guard
from rhec.core.model.limits import is_valid_measurement


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived.

    tests/tracked_robot/test_outliers.py shows on seeds 0 to 11 of the default world that a drive
    without a fault keeps its bits; no seeds are recorded on which they were chosen.
    """

    # name: value  # [unit] meaning
    near_m: float = 1.5  # [m] from the position before, or from the prediction, is near
    reach_mps: float = 5.0  # [m/s] faster than any robot of this kind
    drift_mps: float = 0.1  # [m/s] of dead reckoning, on soil that differs from the estimate
    spread_mps: float = 2.0  # [m/s] of dead reckoning with a wrong yaw: twice the robot's speed
    noises: float = 100.0  # [1] the square of ten standard deviations
    calm: int = 5  # [positions] used before one can be improbable
    close_m: float = 0.75  # [m] from the prediction is calm
    agreeing: int = 3  # [positions] that say the same restart the window
    max_rejection_s: float = 12.0  # [s] then the window restarts in any case
    sigma_position_m: float = 100.0  # [m] of x and of y at a restart
    sigma_yaw_rad: float = 0.5  # [rad] at a restart; the yaw may have been turned, too


TUNED = Tuned()


class _Memory(NamedTuple):
    """What the check remembers."""

    last: ca.SX  # (2,) the last position that arrived [m], NaN before the first one
    innovation: ca.SX  # (2,) its innovation [m]
    unseen: ca.SX  # samples since then
    unused: ca.SX  # samples since a position was used
    rejected: ca.SX  # positions rejected in succession
    agreeing: ca.SX  # of these, the last ones that say the same as the one before
    calm: ca.SX  # used positions in succession that were new and close to their predictions


_MEMORY = dict(zip(_Memory._fields, ((2, 1), (2, 1), *[(1, 1)] * 5)))


def most_rejected(dt_s):
    """The largest number of positions rejected in succession."""
    return round(TUNED.max_rejection_s / dt_s)


def _is_within(way, longest_m, V):
    """Whether a way (2,) [m] is no longer than this, but for noise of variances V."""
    return ca.sumsqr(way) <= longest_m**2 + TUNED.noises * (V[0] + V[1])


def _is_rejected(leaps, innovation, agreeing, V, before, dt_s):
    """Whether a position is rejected, and whether the window restarts at it.

    `leaps` tells that it is out of reach of the one before.
    """
    near_m = TUNED.near_m + TUNED.drift_mps * before.unused * dt_s
    was_rejected = before.rejected > 0
    is_suspect = ca.logic_or(was_rejected, leaps * (before.calm >= TUNED.calm))
    improbable = ca.logic_and(is_suspect, 1 - _is_within(innovation, near_m, V))
    too_long = before.rejected >= most_rejected(dt_s)
    is_enough = ca.logic_or(agreeing >= TUNED.agreeing, too_long)
    restart = improbable * ca.logic_and(was_rejected, is_enough)
    return improbable * (1 - restart), restart


def _check(z, m, V, limits, before, dt_s):
    """Whether the position in z (n_z,) is rejected, given its prediction m; restart; memory after.

    The first position has none before it, and is used.
    """
    has_position = is_valid_measurement(z[0], limits[0]) * is_valid_measurement(z[1], limits[1])
    is_first = before.last[0] != before.last[0]  # NaN alone differs from itself
    innovation = z[:2] - m[:2]
    way = z[:2] - before.last
    time_s = before.unseen * dt_s
    reach_m = TUNED.near_m + TUNED.reach_mps * time_s
    leaps = ca.logic_and(1 - is_first, 1 - _is_within(way, reach_m, V))
    agrees = _is_within(innovation - before.innovation, TUNED.spread_mps * time_s, V)
    agreeing = ca.if_else(agrees * (before.rejected > 0), before.agreeing + 1, 0)
    judged = _is_rejected(leaps, innovation, agreeing, V, before, dt_s)
    is_rejected, restart = (has_position * flag for flag in judged)
    is_calm = ca.logic_and(_is_within(innovation, TUNED.close_m, V), ca.sumsqr(way) != 0)
    seen = _Memory(
        last=z[:2],
        innovation=innovation,
        unseen=1,
        unused=ca.if_else(is_rejected, before.unused + 1, 1),
        rejected=ca.if_else(is_rejected, before.rejected + 1, 0),
        agreeing=ca.if_else(is_rejected, agreeing, 0),
        calm=ca.if_else(is_rejected, before.calm, ca.if_else(is_calm, before.calm + 1, 0)),
    )
    unseen = before._replace(unseen=before.unseen + 1, unused=before.unused + 1)
    return is_rejected, restart, ca.if_else(has_position, ca.veccat(*seen), ca.veccat(*unseen))


def _accepted(z, limits, is_rejected):
    """Which of x, y, ν and ω in z (n_z,) are used (4,); a rejected position is not."""
    valid = [is_valid_measurement(z[row], limits[row]) for row in range(4)]
    return ca.vertcat(*valid) * ca.vertcat(1 - is_rejected, 1 - is_rejected, 1, 1)


def _with_uncertain_pose(P):
    """The covariance P with a pose that is uncertain and independent of all other quantities."""
    P = ca.SX(ca.densify(P))
    P[:3, :] = 0
    P[:, :3] = 0
    for place, sigma in enumerate((*[TUNED.sigma_position_m] * 2, TUNED.sigma_yaw_rad)):
        P[place, place] = sigma**2
    return P


@dataclass(frozen=True)
class PositionCheck(guard.Judge):
    """The judge that leaves out impossible positions, or restarts the window at them.

    `accepted` (4,) tells which of x, y, ν and ω are used.
    """

    def memory(self, window):
        """The _Memory, packed."""
        return dict(check=(packed_size(_MEMORY), 1))

    def first(self, window):
        """As after calm samples, the last of which had no position."""
        first = {name: np.zeros(shape) for name, shape in _MEMORY.items()}
        first |= dict(last=np.full(2, np.nan), calm=TUNED.calm)
        return dict(check=pack_array(first))

    def build(self, window):
        """The Function that checks the newest position."""
        limits = window.model.limits
        shapes = window.prediction | window.noise | dict(z_N=(len(limits), 1))

        @casadi_function("check", ca.SX, **shapes, **self.memory(window))
        def check(B_N, v_N, m_N, P_N, z_N, check, **noise):
            m, _ = window.predict_input(B_N, m_N, P_N, v_N, z_N, **noise)
            before = _Memory(**unpack(check, _MEMORY))
            judged = _check(z_N, m, noise["V"], limits, before, window.dt_s)
            is_rejected, restart, after = judged
            return dict(
                P_used=ca.if_else(restart, _with_uncertain_pose(P_N), P_N),
                z_used=ca.vertcat(ca.if_else(is_rejected, ca.DM.nan(2), z_N[:2]), z_N[2:]),
                agrees=1 - is_rejected,
                accepted=_accepted(z_N, limits, is_rejected),
                restart=restart,
                check_after=after,
            )

        return check

    def build_restarted(self, window):
        """The memory of a window that restarts at its newest position, unless it goes on.

        Nearly always it goes on. Then the prediction of the restart is not computed.
        """
        shapes = window.prediction | window.noise | window.pieces._asdict()
        shapes |= dict(goes_on=(1, 1), z_used=(len(window.model.outputs), 1))

        @short_cut("goes_on")
        @casadi_function("restarted", ca.SX, **shapes)
        def restarted(goes_on, B_N, v_N, m_N, P_N, z_used, **values):
            memory = {name: values[name] for name in window.pieces._fields}
            noise = {name: values[name] for name in window.noise}
            P_N = _with_uncertain_pose(P_N)
            m, P = window.predict_input(B_N, m_N, P_N, v_N, z_used, **noise)
            s = ca.vertcat(z_used[:2], memory["s"][2:, window.N])
            fresh = guard.fresh(window, memory, s, z_used, m, P)
            return {name: ca.if_else(goes_on, memory[name], fresh[name]) for name in memory}

        return restarted
