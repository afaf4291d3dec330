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

It is not in the paper, whose least squares give each position the same weight. All of it wraps the
RHE's phases from outside, as `rhec.tracked_robot.robust` does, which handles more kinds of faults.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, packed_size, select_inputs, short_cut, unpack
from rhec.core._casadi.compiled import loop_symbols
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import rhe
from rhec.core.model.limits import is_valid_measurement

NEAR_M = 1.5
REACH_MPS = 5.0  # faster than any robot of this kind
DRIFT_MPS = 0.1  # of dead reckoning, on soil that differs from the estimate
SPREAD_MPS = 2.0  # of dead reckoning with a wrong yaw: twice the robot's speed
NOISES = 100.0  # the square of ten standard deviations
CALM = 5
CLOSE_M = 0.75
AGREEING = 3
MAX_REJECTION_S = 12.0
# Of (x, y) [m] and of the yaw [rad] at a restart; the yaw may have been turned, too.
SIGMA_RESTART = (100.0, 100.0, 0.5)


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
_CHECK = dict(check=(packed_size(_MEMORY), 1))


def most_rejected(dt_s):
    """The largest number of positions rejected in succession."""
    return round(MAX_REJECTION_S / dt_s)


def _is_within(way, longest_m, V):
    """Whether a way (2,) [m] is no longer than this, but for noise of variances V."""
    return ca.sumsqr(way) <= longest_m**2 + NOISES * (V[0] + V[1])


def _judge(leaps, innovation, agreeing, V, before, dt_s):
    """Whether a position is rejected, and whether the window restarts at it.

    `leaps` tells that it is out of reach of the one before.
    """
    near_m = NEAR_M + DRIFT_MPS * before.unused * dt_s
    was_rejected = before.rejected > 0
    is_suspect = ca.logic_or(was_rejected, leaps * (before.calm >= CALM))
    improbable = ca.logic_and(is_suspect, 1 - _is_within(innovation, near_m, V))
    too_long = before.rejected >= most_rejected(dt_s)
    is_enough = ca.logic_or(agreeing >= AGREEING, too_long)
    restart = improbable * ca.logic_and(was_rejected, is_enough)
    return improbable * (1 - restart), restart


def _check(z, m, V, limits, before, dt_s):
    """Judge the position in z (n_z,), with the prediction m: rejected, restart, the memory after.

    The first position has none before it, and is used.
    """
    has_position = is_valid_measurement(z[0], limits[0]) * is_valid_measurement(z[1], limits[1])
    is_first = before.last[0] != before.last[0]  # NaN alone differs from itself
    innovation = z[:2] - m[:2]
    way = z[:2] - before.last
    time_s = before.unseen * dt_s
    leaps = ca.logic_and(1 - is_first, 1 - _is_within(way, NEAR_M + REACH_MPS * time_s, V))
    agrees = _is_within(innovation - before.innovation, SPREAD_MPS * time_s, V)
    agreeing = ca.if_else(agrees * (before.rejected > 0), before.agreeing + 1, 0)
    judged = _judge(leaps, innovation, agreeing, V, before, dt_s)
    rejected, restart = (has_position * flag for flag in judged)
    is_calm = ca.logic_and(_is_within(innovation, CLOSE_M, V), ca.sumsqr(way) != 0)
    seen = _Memory(
        last=z[:2],
        innovation=innovation,
        unseen=1,
        unused=ca.if_else(rejected, before.unused + 1, 1),
        rejected=ca.if_else(rejected, before.rejected + 1, 0),
        agreeing=ca.if_else(rejected, agreeing, 0),
        calm=ca.if_else(rejected, before.calm, ca.if_else(is_calm, before.calm + 1, 0)),
    )
    unseen = before._replace(unseen=before.unseen + 1, unused=before.unused + 1)
    return rejected, restart, ca.if_else(has_position, ca.veccat(*seen), ca.veccat(*unseen))


def _accepted(z, limits, rejected):
    """Which of x, y, ν and ω in z (n_z,) are used (4,); a rejected position is not."""
    valid = [is_valid_measurement(z[row], limits[row]) for row in range(4)]
    return ca.vertcat(*valid) * ca.vertcat(1 - rejected, 1 - rejected, 1, 1)


def _with_uncertain_pose(P):
    """The covariance P with a pose that is uncertain and independent of all other quantities."""
    P = ca.SX(ca.densify(P))
    P[:3, :] = 0
    P[:, :3] = 0
    for place, sigma in enumerate(SIGMA_RESTART):
        P[place, place] = sigma**2
    return P


def _wrap_feedback(window, feedback_of_rhe):
    limits = window.model.limits
    z_N = (len(limits), 1)

    @casadi_function("check", **window.prediction, **window.noise, z_N=z_N, **_CHECK)
    def check(B_N, v_N, m_N, P_N, z_N, check, **noise):
        m, _ = rhe.predict_input(window, B_N, m_N, P_N, v_N, z_N, **noise)
        before = _Memory(**unpack(check, _MEMORY))
        rejected, restart, after = _check(z_N, m, noise["V"], limits, before, window.dt_s)
        return dict(
            P_used=ca.if_else(restart, _with_uncertain_pose(P_N), P_N),
            z_used=ca.vertcat(ca.if_else(rejected, ca.DM.nan(2), z_N[:2]), z_N[2:]),
            rejected=rejected,
            accepted=_accepted(z_N, limits, rejected),
            restart=restart,
            check_after=after,
        )

    shapes = {name: feedback_of_rhe.sparsity_in(name) for name in feedback_of_rhe.name_in()}

    @casadi_function("checked_feedback", loop_symbols(), **shapes, **_CHECK)
    def feedback(**inputs):
        checked = check(**select_inputs(check, inputs))
        values = inputs | dict(z_N=checked["z_used"], P_N=checked.pop("P_used"))
        used = 1 - checked.pop("rejected")
        result = feedback_of_rhe(**select_inputs(feedback_of_rhe, values)) | checked
        return result | dict(ok=result["ok"] * used, solved=result["ok"])

    return feedback


def _build_restarted(window):
    """The memory of a window that restarts at its newest position, unless it goes on.

    Nearly always it goes on. Then the prediction of the restart is not computed.
    """
    N = window.N
    shapes = window.prediction | window.noise | window.memory
    shapes |= dict(goes_on=(1, 1), z_used=(len(window.model.outputs), 1))

    @short_cut("goes_on")
    @casadi_function("restarted", **shapes)
    def restarted(goes_on, B_N, v_N, m_N, P_N, z_used, **values):
        memory = {name: values[name] for name in window.memory}
        noise = {name: values[name] for name in window.noise}
        P_N = _with_uncertain_pose(P_N)
        m, P = rhe.predict_input(window, B_N, m_N, P_N, v_N, z_used, **noise)
        s = ca.vertcat(z_used[:2], memory["s"][2:, N])
        fresh = memory | dict(
            s=ca.repmat(s, 1, N + 1),
            v=ca.repmat(memory["v"][:, N - 1], 1, N),
            z=ca.horzcat(ca.SX.nan(z_used.numel(), N), z_used),
            age=0,
            m=m,
            P=P,
        )
        return {name: ca.if_else(goes_on, memory[name], fresh[name]) for name in memory}

    return restarted


def _wrap_expand(window, expand_of_rhe):
    restarted = _build_restarted(window)
    shapes = {name: expand_of_rhe.sparsity_in(name) for name in expand_of_rhe.name_in()}
    del shapes["z_N"]
    one = (1, 1)
    shapes |= window.prediction | window.noise
    shapes |= dict(z_used=restarted.sparsity_in("z_used"), check_after=_CHECK["check"])
    shapes |= dict(restart=one, solved=one)

    @casadi_function("checked_expand", loop_symbols(), **shapes)
    def expand(check_after, **inputs):
        values = inputs | dict(z_N=inputs["z_used"], ok=inputs["solved"])
        result = expand_of_rhe(**select_inputs(expand_of_rhe, values))
        kkt = ca.if_else(inputs["ok"], result["kkt"], ca.DM.nan())
        values |= result | dict(goes_on=1 - inputs["restart"])
        after = restarted(**select_inputs(restarted, values))
        return after | dict(check=check_after, kkt=kkt)

    return expand


def checked(window, phases):
    """Wrap the phases {name: Function} of an RHE, so that each position is checked.

    The memory has one more piece, `check`. The feedback's `ok` is 0 where a position was rejected,
    and `kkt` is NaN then; `accepted` (4,) tells which of x, y, ν and ω were used, `restart` whether
    the window restarts.
    """
    shift_of_rhe = phases["shift"]
    shapes = {name: shift_of_rhe.sparsity_in(name) for name in shift_of_rhe.name_in()}

    @casadi_function("checked_shift", **shapes, **_CHECK)
    def shift(check, **inputs):
        return shift_of_rhe(**inputs) | dict(check=check)

    wrapped = dict(
        shift=shift,
        linearise=phases["linearise"],
        feedback=_wrap_feedback(window, phases["feedback"]),
        expand=_wrap_expand(window, phases["expand"]),
    )
    step = rhe.compose("checked_step", wrapped, window.memory | _CHECK, loop_symbols())
    return wrapped | dict(step=step)


def init():
    """The memory of the check before the first sample."""
    first = {name: np.zeros(shape) for name, shape in _MEMORY.items()}
    first |= dict(last=np.full(2, np.nan), calm=CALM)
    return dict(check=pack_array(first))
