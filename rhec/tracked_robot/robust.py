"""Robust handling of measurements: how far each one is trusted, and when to restart. Not in the
paper.

Each measurement in the window of an RHE has a variance of its own, from what the sensors say of one
another, never from how the estimate likes it alone:

- *Noisy* positions count less: their variance is at least that of their second differences.
- A position is *rejected* where it is the last one repeated, to the last digit (the receiver is
  stuck), or where its innovation y is improbable, y' S⁻¹ y > CHI2_GATE (Bar-Shalom, Li,
  Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.7) and it
  does not follow smoothly on an accepted one.
- The path by the encoders is laid on the last positions, turned and stretched as fits best (Kabsch,
  1976). Where the positions are smooth, and yet do not agree with it, *encoders are doubted*: over
  these samples the positions count, and their speed takes the place of the encoders'. So it stays
  until both agree again. With `speed_model="parameter"` encoders that jump are doubted at once.
- Where both agree, and the yaw is another than the estimate's, or the position for long, it is the
  estimate that is wrong: the *window restarts* there.

All of it wraps the RHE's phases from outside: the estimator knows variances, not where from.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, pack_array, packed_size, select_inputs, unpack
from rhec.core._casadi.compiled import loop_symbols
from rhec.core.estimator import rhe
from rhec.core.model.limits import MAX_MEASUREMENT, is_valid_measurement
from rhec.tracked_robot import rhe as paper_rhe
from rhec.tracked_robot.slipping import LEVER_ARM

__all__ = ["ROBUST_RHE", "gated"]

_RHE = paper_rhe.ESTIMATORS["rhe"]

CHI2_GATE = 13.8  # two degrees of freedom: a good innovation is beyond once in a thousand
# samples that positions' noise, and agreement with encoders, are found from
PAST = 10
CHECKED = 6
MAX_BEND_M = 0.25  # second difference of positions: beyond they are not smooth
DEAD_RECKONING = 0.06  # error per distance that it may add since the last accepted position
LATE_S = 0.15  # positions and encoders may be out of step by so much
TRACTION = (0.4, 1.1)  # distance by positions, over the way by encoders
LEAST_KAPPA = 0.3
# mean square apart, over the noise; rms over the path's size
NOISES_APART = 2.5
SHARE_APART = 0.15
SIGMA_DOUBTED = (0.15, 0.4)  # of (ν, ω) [m/s, rad/s] that stand for doubted encoders'
SIGMA_JUMP = (0.1, 0.3)  # of the change of ν [m/s], ω [rad/s] from one sample to the next
MIN_COURSE_M = 0.1  # a path of less than this size (rms) tells no yaw
MIN_HEADING_COSINE = 0.7  # of the angle between course and yaw: below, over 45°, they contradict
HEADING_MISMATCHES_TO_RESTART = 5
MAX_REJECTION_S = 12.0  # how long positions and encoders are rejected at most
SIGMA_RESTART = dict(x_m=0.05, y_m=0.05, theta_rad=0.15, nu_mps=0.05)
_SIGMA_RESTART_ELSE = 0.1

# What is remembered: `past` positions, NaN where there was none, with the encoder measurements
# there; the `last` position and the encoder measurements last accepted; samples `since` a smooth
# position was accepted and since encoders were; how often in a row the course has `contradicted`
# the yaw; whether encoders were in `doubt`.
_MEMORY = dict(past=(4, PAST), last=(4, 1), since=(2, 1), contradicted=(1, 1), doubt=(1, 1))


def _is_there(x):
    """1 where x is a number."""
    return is_valid_measurement(x, MAX_MEASUREMENT**2)


def _driven(past, arm, kappa, dt_s):
    """Places (2, n) of the antenna by the encoders' `past` (4, n), seen from the newest pose."""
    places = [ca.SX.zeros(2)]
    yaw = 0
    for k in reversed(range(1, past.size2())):
        turn = kappa * past[3, k] * dt_s
        ahead = dt_s * past[2, k] - turn * arm[1]
        left = turn * arm[0]
        cos = ca.cos(yaw - turn / 2)
        sin = ca.sin(yaw - turn / 2)
        places.append(places[-1] - ca.vertcat(cos * ahead - sin * left, sin * ahead + cos * left))
        yaw = yaw - turn
    return ca.horzcat(*reversed(places))


def _registration(q, e):
    """A path e (2, n) laid on positions q (2, n): by which angle it is turned, their mean squared
    distance then, and the mean squares of q and e about their middles.
    """
    q, e = (path - ca.repmat(ca.sum2(path) / path.size2(), 1, path.size2()) for path in (q, e))
    dot = ca.sum2(ca.sum1(q * e))
    cross = ca.sum2(q[1, :] * e[0, :] - q[0, :] * e[1, :])
    fit = ca.sqrt(dot**2 + cross**2)
    sizes = (ca.sumsqr(q), ca.sumsqr(e))
    mu = ca.fmin(ca.fmax(fit / ca.fmax(sizes[1], 1e-9), TRACTION[0]), TRACTION[1])
    apart = sizes[0] - 2 * mu * fit + mu**2 * sizes[1]
    return ca.atan2(cross, dot), *(square / q.size2() for square in (apart, *sizes))


def _noise(bends):
    """Variance (x and y together) of positions, from their squared second differences (von Neumann,
    1941): the less of two halves, so that one outlier is not taken for noise; 0 where too few.
    """
    halves = []
    for half in ca.horzsplit(bends, [0, bends.numel() // 2, bends.numel()]):
        n = ca.sum2(_is_there(half))
        mean = ca.sum2(ca.if_else(_is_there(half), half, 0)) / ca.fmax(n, 1)
        halves.append(ca.if_else(n >= 3, mean / 6, 0))
    return ca.fmin(*halves)


def _gate(z, limits, memory, predict, V, names, first, dt_s):
    """What is to be made of z: measurements and variances to use, whether to restart and at which
    pose, what doubted encoders are replaced by, and the memory after.

    memory: the pieces of _MEMORY; predict(z, V) -> mean (n,) and covariance (n, n) of the pose and
    more, by the encoders in z alone; names: of these; first: 1 before any measurement.
    """
    past, last, since, contradicted, doubt = memory.values()
    valid = [is_valid_measurement(z[row], limits[row]) for row in range(4)]
    may_reject = since * dt_s < MAX_REJECTION_S
    told = valid[2] * valid[3]
    heard = valid[0] * valid[1]
    has_position = heard * (1 - (z[0] == last[0]) * (z[1] == last[1]))
    held = ca.if_else(told, z[2:], ca.if_else(_is_there(past[2:, -1]), past[2:, -1], 0))
    seen = ca.if_else(has_position, z[:2], ca.DM.nan(2))
    past = ca.horzcat(past, ca.vertcat(seen, held))

    # Positions by themselves.
    bend = past[:2, 2:] - 2 * past[:2, 1:-1] + past[:2, :-2]
    bends = ca.sum1(bend * bend)
    smooth = ca.mmin(bends[1 - CHECKED :] <= MAX_BEND_M**2)  # no position is missing, either
    noise = ca.fmax(V[0] + V[1], _noise(bends))
    V_position = V[:2] * noise / (V[0] + V[1])

    # Positions and encoders. NaN is never in agreement.
    m, _ = predict(ca.vertcat(seen, ca.if_else(told, z[2:], ca.DM.nan(2))), V)
    arm = [m[names.index(name)] if name in names else 0 for name in LEVER_ARM]
    kappa = ca.fmin(ca.fmax(m[names.index("kappa")], LEAST_KAPPA), 1)
    checked = past[:, -CHECKED - 1 :]
    driven = _driven(checked, arm, kappa, dt_s)
    yaw, apart, size, size_driven = _registration(checked[:2, :], driven)
    speed = ca.sumsqr(driven[:, 1:] - driven[:, :-1]) / (CHECKED * dt_s**2)
    agree = apart <= NOISES_APART * noise + SHARE_APART**2 * size + (2 * LATE_S) ** 2 * speed
    agree, wrong = smooth * agree, smooth * _is_there(apart) * (1 - agree)
    change = ca.sumsqr((z[2:] - last[2:]) / ca.DM(SIGMA_JUMP))  # never beyond without a last one
    jump = change > CHI2_GATE if "nu_mps" in names else 0
    doubt = ca.logic_or(wrong, ca.logic_or(jump, doubt * (1 - agree)) * may_reject[1])
    encoders = told * (1 - doubt)
    way = checked[:2, -1] - checked[:2, 0]
    sign = ca.if_else(ca.cos(m[2]) * way[0] + ca.sin(m[2]) * way[1] < 0, -1, 1)
    mu = ca.fmax(m[names.index("mu")], TRACTION[0])
    by_positions = ca.vertcat(sign * ca.norm_2(way) / (CHECKED * dt_s * mu), 0)
    by_positions = ca.if_else(told * doubt * smooth, by_positions, ca.DM.nan(2))
    turning = ca.if_else(encoders, z[2:], by_positions)
    V_used = ca.vertcat(V_position, ca.if_else(told * doubt, ca.DM(SIGMA_DOUBTED) ** 2, V[2:]))

    # Positions and the estimate.
    m, P = predict(ca.vertcat(seen, turning), V_used)
    y = z[:2] - m[:2]
    late = LATE_S * ca.fabs(held[0]) * ca.vertcat(ca.cos(m[2]), ca.sin(m[2]))
    drift = DEAD_RECKONING * ca.fabs(held[0]) * dt_s * since[0] * agree
    S = P[:2, :2] + ca.diag(V_position) + late @ late.T + drift**2 * ca.SX.eye(2)
    probable = ca.bilin(ca.inv_minor(S), y, y) <= CHI2_GATE
    follows = ca.logic_or(wrong, (since[0] == 0) * (bends[-1] <= MAX_BEND_M**2))
    position = has_position * ca.logic_or(first, ca.logic_or(probable, follows))

    far = size_driven > MIN_COURSE_M**2
    mismatch = agree * far * (ca.cos(yaw - m[2]) < MIN_HEADING_COSINE)
    contradicted = ca.if_else(mismatch, contradicted + 1, 0)
    restart = ca.logic_or(
        contradicted >= HEADING_MISMATCHES_TO_RESTART, agree * (1 - position) * (1 - may_reject[0])
    )
    nearest = yaw - 2 * ca.pi * ca.floor((yaw - m[2]) / (2 * ca.pi) + 0.5)

    accepted = ca.logic_or(position, restart)
    after = dict(
        past=past[:, 1:],
        last=ca.vertcat(ca.if_else(heard, z[:2], last[:2]), ca.if_else(encoders, z[2:], last[2:])),
        since=ca.vertcat(
            ca.if_else(ca.logic_or(position * smooth, restart), 0, since[0] + 1),
            ca.if_else(encoders, 0, since[1] + 1),
        ),
        contradicted=ca.if_else(restart, 0, contradicted),
        doubt=doubt,
    )
    return dict(
        accepted=ca.vertcat(accepted, accepted, encoders, encoders),
        z_used=ca.vertcat(ca.if_else(accepted, z[:2], ca.DM.nan(2)), turning),
        V_used=V_used,
        restart=restart,
        pose=ca.vertcat(z[:2], ca.if_else(far, nearest, m[2])),
        replace=wrong,
        replaced=ca.vertcat(checked[:2, 1:], ca.repmat(turning, 1, CHECKED)),
        gate_after=ca.veccat(*after.values()),
    )


def gated(window, phases):
    """The phases of an RHE of the tracked robot whose measurements have variances of their own.

    Args:
        window: Its rhe.Window, weighted.
        phases: {name: Function}, from rhe.build_phases.

    Returns:
        Such a dict. The memory has two pieces more, `V_window` (4, N + 1) and `gate`; feedback says
        what is `accepted` (4,), as 1 or 0, and whether the window is to `restart`.
    """
    interval = window.interval
    names = window.model.joint_names
    N = window.N
    one = (1, 1)
    four = (4, 1)
    replaced = (4, CHECKED)
    newest = min(CHECKED, N)
    own = dict(V_window=(4, N + 1), gate=(packed_size(_MEMORY), 1))
    remembered = dict(age=one, gate=own["gate"])

    def taken(phase, *without):
        """What a phase takes but for V: shapes by name."""
        phase = phases[phase]
        return {n: phase.sparsity_in(n) for n in phase.name_in() if n not in ("V", *without)}

    @casadi_function("gated_shift", **taken("shift"), V=four, **own)
    def shift(V, V_window, gate, **inputs):
        V_after = ca.horzcat(V_window[:, 1:], V)
        return phases["shift"](V=V_window, **inputs) | dict(V_window=V_after, gate=gate)

    @casadi_function(
        "gated_linearise", loop_symbols(), **taken("linearise"), V_window=own["V_window"]
    )
    def linearise(V_window, **inputs):
        return phases["linearise"](V=V_window, **inputs)

    @casadi_function("gate", **window.prediction, z_N=four, **window.noise, **remembered)
    def gate(B_N, v_N, m_N, P_N, z_N, V, age, gate, **c):
        def predict(z, V):
            return rhe.predict_input(window, B_N, m_N, P_N, v_N, z, V=V, **c)

        memory = unpack(gate, _MEMORY)
        return _gate(z_N, window.model.limits, memory, predict, V, names, age < 1, window.dt_s)

    @casadi_function("gated_feedback", loop_symbols(), **taken("feedback"), V=four, **remembered)
    def feedback(**inputs):
        result = gate(**select_inputs(gate, inputs))
        known = inputs | dict(z_N=result["z_used"], V=result["V_used"])
        return phases["feedback"](**select_inputs(phases["feedback"], known)) | result

    @casadi_function(
        "restarted",
        restart=one,
        pose=(3, 1),
        replace=one,
        replaced=replaced,
        z_used=four,
        V_used=four,
        **window.memory,
        V_window=own["V_window"],
    )
    def restarted(restart, pose, replace, replaced, z_used, V_used, **memory):
        """The window with doubted encoders replaced; or that of a new start at this pose with the
        present speed and traction.
        """
        for name, latest in (
            ("z", replaced[:, -newest:]),
            ("V_window", ca.repmat(V_used, 1, newest)),
        ):
            with_latest = ca.horzcat(memory[name][:, :-newest], latest)
            memory[name] = ca.if_else(replace, with_latest, memory[name])
        there = ca.vertcat(pose, memory["s"][3:, N])
        for place, (lowest, highest) in interval.bounds.items():
            there[place] = ca.fmin(ca.fmax(there[place], lowest), highest)
        sigma = [SIGMA_RESTART.get(name, _SIGMA_RESTART_ELSE) for name in names]
        fresh = memory | dict(
            s=ca.repmat(there, 1, N + 1),
            v=ca.repmat(memory["v"][:, N - 1], 1, N),
            z=ca.horzcat(ca.SX.nan(4, N), z_used),
            age=0,
            m=there,
            P=ca.diag(np.square(sigma)),
        )
        return {name: ca.if_else(restart, fresh[name], memory[name]) for name in memory}

    @casadi_function(
        "gated_expand",
        loop_symbols(),
        **taken("expand", "z_N"),
        z_used=four,
        V_used=four,
        restart=one,
        pose=(3, 1),
        replace=one,
        replaced=replaced,
        V_window=own["V_window"],
        gate_after=own["gate"],
    )
    def expand(V_window, gate_after, **inputs):
        V_window = ca.horzcat(V_window[:, :N], inputs["V_used"])
        known = inputs | dict(z_N=inputs["z_used"], V=V_window)
        result = phases["expand"](**select_inputs(phases["expand"], known))
        known |= {name: result[name] for name in window.memory} | dict(V_window=V_window)
        new = restarted(**select_inputs(restarted, known))
        return new | dict(gate=gate_after, kkt=result["kkt"])

    result = dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand)
    return result | dict(
        step=rhe.compose("gated_step", result, window.memory | own, loop_symbols())
    )


def _init(choice, guess, sigma=paper_rhe.SIGMA_START):
    memory = _RHE.init(choice, guess, sigma)
    gate = {
        name: np.full(shape, np.nan if name in ("past", "last") else 0.0)
        for name, shape in _MEMORY.items()
    }
    V_window = np.ones((4, choice.estimation_horizon + 1))  # of no measurement
    return memory | dict(V_window=V_window, gate=pack_array(gate))


def _build_phases(choice):
    return gated(paper_rhe.window_of(choice), _RHE.build_phases(choice))


ROBUST_RHE = _RHE._replace(
    build_step=lambda choice: _build_phases(choice)["step"], build_phases=_build_phases, init=_init
)
