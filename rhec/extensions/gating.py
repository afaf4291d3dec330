"""Innovation gating: which measurements an RHE accepts, and when it restarts. Not in the paper.

A position is rejected where it is the last one repeated, to the last digit (the receiver is stuck),
or where its innovation y is improbable, y' S⁻¹ y > CHI2_GATE (Bar-Shalom, Li, Kirubarajan,
"Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.7). While positions are
missing or rejected, S grows by what dead reckoning may be off, so that good ones after a long gap
are let in; outliers, which do not lie near each other, would slip in, too, so it does not grow for
those. With `speed_model="parameter"`, encoder measurements that jump are rejected as well. A
rejected measurement is treated as missing (NaN).

An estimate that is wrong itself, such as a yaw turned round, would so be cut off from what could
mend it. Therefore the window restarts at the newest position, with the yaw of the course over
ground, where the positions of COURSE_S are in line and as far apart as the encoders say, and
either point elsewhere than the yaw or have all been rejected for long.

Gating wraps the RHE's phases from outside: the estimator itself knows nothing of it.
"""

import casadi as ca
import numpy as np

from rhec._casadi.build import casadi_function, pack_array, packed_size, select_inputs, unpack
from rhec._casadi.compiled import loop_symbols
from rhec.estimator import rhe
from rhec.model.limits import is_valid_measurement
from rhec.tracked_robot import rhe as paper_rhe
from rhec.tracked_robot.estimators import estimator_of

__all__ = ["ROBUST", "gated"]

CHI2_GATE = 13.8  # two degrees of freedom: a good innovation is beyond once in a thousand
DEAD_RECKONING = 0.07  # error per distance that it may add since the last accepted position
SIGMA_JUMP = (0.1, 0.3)  # of the change of ν [m/s], ω [rad/s] from one sample to the next
CONSISTENT_POSITIONS = 5  # in a row near the one before, for dead reckoning to be doubted, not them
COURSE_S = 2.0  # a course over ground takes this long
MIN_COURSE_M = 0.3  # over less than this it tells no yaw
MAX_COURSE_STRETCH, COURSE_SLACK_M = 1.3, 0.15  # by positions, over the way by encoders
MAX_COURSE_BEND_M = 0.25  # how far the position midway may be off the chord's middle
MIN_HEADING_COSINE = 0.7  # of the angle between course and yaw: below, over 45°, they contradict
HEADING_MISMATCHES_TO_RESTART = 5
MAX_REJECTION_S = 10.0  # how long positions and encoders are rejected at most
SIGMA_RESTART = dict(x_m=0.05, y_m=0.05, theta_rad=0.1, nu_mps=0.05)
_SIGMA_RESTART_ELSE = 0.1


def _memory(dt_s):
    """Shapes of what the gate remembers.

    `past` positions, with the encoder measurements accepted then; the `last` position there was
    and the encoder measurements last accepted; samples `since` a position and since encoders were
    accepted; how often in a row the course has `contradicted` the yaw; samples since there was a
    `position`, and how many of them in a row were `consistent`, near the one before.
    """
    one = (1, 1)
    return dict(
        past=(4, round(COURSE_S / dt_s)), last=(4, 1), since=(2, 1), contradicted=one,
        position=one, consistent=one,
    )  # fmt: skip


def _course(past, z, kappa, dt_s):
    """Yaw [rad] by the positions from the oldest of `past` (4, n) to z (4,).

    With it, whether they moved as the encoders say, and whether far enough to tell.
    """
    n = past.size2()
    way, midway = z[:2] - past[:2, 0], past[:2, n // 2] - (z[:2] + past[:2, 0]) / 2
    distance, turned = (dt_s * (ca.sum2(past[row, 1:]) + z[row]) for row in (2, 3))
    # Also 0 where anything is not a number.
    as_far = ca.norm_2(way) < MAX_COURSE_STRETCH * ca.fabs(distance) + COURSE_SLACK_M
    course_ok = as_far * (ca.norm_2(midway) < MAX_COURSE_BEND_M)
    yaw = ca.atan2(way[1], way[0]) + ca.pi * (distance < 0) + kappa * turned / 2
    return yaw, course_ok, ca.norm_2(way) > MIN_COURSE_M


def _gate(z, limits, memory, predict, V, kappa, first, constant_speed, dt_s):
    """Which measurements are accepted, whether to restart, at which pose, and the memory after.

    memory: the pieces of `_memory`; predict(z) -> mean (n,) and covariance (n, n) of the pose and
    more, by the encoders in z alone; kappa: place of κ there; first: 1 before any measurement.
    """
    past, last, since, contradicted, came, consistent = memory.values()
    valid = [is_valid_measurement(z[row], limits[row]) for row in range(4)]
    may_reject = since * dt_s < MAX_REJECTION_S

    # Never where there is no last one.
    change = ca.sumsqr((z[2:] - last[2:]) / ca.DM(SIGMA_JUMP))
    jump = change > CHI2_GATE if constant_speed else 0
    encoders = valid[2] * valid[3] * (1 - jump * may_reject[1])
    turning = ca.if_else(encoders, z[2:], ca.DM.nan(2))

    usable = ca.vertcat(z[:2], turning)
    m, P = predict(usable)
    speed = ca.if_else(encoders, ca.fabs(z[2]), 0)
    has_position = valid[0] * valid[1] * (1 - (z[0] == last[0]) * (z[1] == last[1]))
    y = z[:2] - m[:2]
    reach = MAX_COURSE_STRETCH * speed * dt_s * (came + 1) + COURSE_SLACK_M
    near = ca.norm_2(z[:2] - last[:2]) < reach
    consistent = ca.if_else(has_position, ca.if_else(near, consistent + 1, 0), consistent)
    doubted = consistent >= CONSISTENT_POSITIONS
    drift = DEAD_RECKONING * speed * dt_s * since[0] * doubted
    S = P[:2, :2] + ca.diag(V[:2]) + drift**2 * ca.SX.eye(2)
    probable = ca.bilin(ca.inv_minor(S), y, y) <= CHI2_GATE
    position = has_position * ca.logic_or(first, probable)

    yaw, course_ok, moved_far = _course(past, usable, m[kappa], dt_s)
    suspect = has_position * (1 - position) * course_ok
    mismatch = suspect * moved_far * (ca.cos(yaw - m[2]) < MIN_HEADING_COSINE)
    contradicted = ca.if_else(mismatch, contradicted + 1, 0)
    restart = suspect * ca.logic_or(
        contradicted >= HEADING_MISMATCHES_TO_RESTART, 1 - may_reject[0]
    )
    nearest = yaw - 2 * ca.pi * ca.floor((yaw - m[2]) / (2 * ca.pi) + 0.5)

    accepted = ca.logic_or(position, restart)
    after = dict(
        past=ca.horzcat(past[:, 1:], ca.if_else(has_position, usable, ca.DM.nan(4))),
        last=ca.vertcat(
            ca.if_else(valid[0] * valid[1], z[:2], last[:2]), ca.if_else(encoders, z[2:], last[2:])
        ),
        since=ca.vertcat(
            ca.if_else(accepted, 0, since[0] + 1), ca.if_else(encoders, 0, since[1] + 1)
        ),
        contradicted=ca.if_else(restart, 0, contradicted),
        position=ca.if_else(has_position, 0, came + 1),
        consistent=consistent,
    )
    return dict(
        accepted=ca.vertcat(accepted, accepted, encoders, encoders),
        restart=restart,
        pose=ca.vertcat(z[:2], ca.if_else(moved_far, nearest, m[2])),
        gate_after=ca.veccat(*after.values()),
    )


def gated(window, phases):
    """The phases of an RHE of the tracked robot with its measurements gated.

    Args:
        window: Its rhe.Window.
        phases: {name: Function}, from rhe.build_phases.

    Returns:
        Such a dict. The memory has one piece more, `gate`; feedback says what is
        `accepted` (4,), as 1 or 0, and whether the window is to `restart`.
    """
    interval, names, N = window.interval, window.model.joint_names, window.N
    state, one, four = (interval.n_s, 1), (1, 1), (4, 1)
    shapes = _memory(window.dt_s)
    memory = window.memory | dict(gate=(packed_size(shapes), 1))
    remembered = {name: memory[name] for name in ("age", "gate")}

    @casadi_function("gated_shift", **memory, **window.noise, W=state)
    def shift(gate, **inputs):
        return phases["shift"](**inputs) | dict(gate=gate)

    @casadi_function("gate", **window.prediction, z_N=four, **window.noise, **remembered)
    def gate(B_N, v_N, m_N, P_N, z_N, age, gate, **noise):
        def predict(z):
            return rhe.predict_input(window, B_N, m_N, P_N, v_N, z, **noise)

        result = _gate(
            z_N, window.model.limits, unpack(gate, shapes), predict, noise["V"],
            names.index("kappa"), age < 1, "nu_mps" in names, window.dt_s,
        )  # fmt: skip
        return result | dict(z_accepted=ca.if_else(result["accepted"], z_N, ca.DM.nan(4)))

    plain = phases["feedback"]
    shapes_in = {name: plain.sparsity_in(name) for name in plain.name_in()}

    @casadi_function("gated_feedback", loop_symbols(), **shapes_in, **remembered)
    def feedback(**inputs):
        result = gate(**select_inputs(gate, inputs))
        return plain(**select_inputs(plain, inputs | dict(z_N=result["z_accepted"]))) | result

    full = phases["expand"]
    shapes_in = {name: full.sparsity_in(name) for name in full.name_in() if name != "z_N"}

    @casadi_function("restarted", restart=one, pose=(3, 1), z_accepted=four, **window.memory)
    def restarted(restart, pose, z_accepted, **memory):
        """The window of a new start at this pose with the present speed and traction."""
        there = ca.vertcat(pose, memory["s"][3:, N])
        for place, (lowest, highest) in interval.bounds.items():
            there[place] = ca.fmin(ca.fmax(there[place], lowest), highest)
        sigma = [SIGMA_RESTART.get(name, _SIGMA_RESTART_ELSE) for name in names]
        fresh = dict(
            s=ca.repmat(there, 1, N + 1),
            v=ca.repmat(memory["v"][:, N - 1], 1, N),
            z=ca.horzcat(ca.SX.nan(4, N), z_accepted),
            age=0,
            m=there,
            P=ca.diag(np.square(sigma)),
        )
        return {name: ca.if_else(restart, fresh[name], memory[name]) for name in memory}

    @casadi_function(
        "gated_expand", loop_symbols(), **shapes_in, z_accepted=four, restart=one, pose=(3, 1),
        gate_after=memory["gate"],
    )  # fmt: skip
    def expand(z_accepted, restart, pose, gate_after, **inputs):
        result = full(z_N=z_accepted, **inputs)
        new = restarted(
            restart=restart, pose=pose, z_accepted=z_accepted,
            **{name: result[name] for name in window.memory},
        )  # fmt: skip
        return new | dict(gate=gate_after, kkt=result["kkt"])

    linearise = phases["linearise"]
    result = dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand)
    return result | dict(step=rhe.compose("gated_step", result, memory, loop_symbols()))


def _init(choice, guess, sigma=paper_rhe.SIGMA_START):
    memory = estimator_of("rhe").init(choice, guess, sigma)
    gate = {
        name: np.full(shape, np.nan if name in ("past", "last") else 0.0)
        for name, shape in _memory(choice.dt_s).items()
    }
    return memory | dict(gate=pack_array(gate))


def _build_phases(choice):
    plain = estimator_of("rhe").build_phases(choice)
    return gated(paper_rhe.window_of(choice), plain)


ROBUST = {
    "rhe": estimator_of("rhe")._replace(
        build_step=lambda choice: _build_phases(choice)["step"],
        build_phases=_build_phases,
        init=_init,
    )
}
