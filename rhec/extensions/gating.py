"""Which readings to believe: what comes between the sensors and the RHE when it is `robust`. Not in
the paper.

A position is refused where it is the last one repeated, to the last digit (the receiver is stuck),
or where its innovation y is improbable, y' S⁻¹ y > GATE (innovation gating: Bar-Shalom, Li,
Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.7). While
positions are missing or refused, S grows by what dead reckoning may be off, so that good ones after
a long gap are let in; outliers, which do not lie near each other, would slip in, too, so it does
not grow for those. Where speed is taken to be constant, encoder readings that jump are refused,
too. All refused readings are missing ones, as if there had been none.

An estimate that is wrong itself, such as a yaw turned round, would so be cut off from what could
mend it. Therefore the estimator begins again at the newest position, with the yaw of the course
over ground, where the positions of COURSE_S are in line and as far apart as the encoders say, and
either point elsewhere than the yaw or have all been refused for long.
"""

import casadi as ca
import numpy as np

from rhec._casadi.build import pack_array, unpack
from rhec.estimator.kalman import is_valid_measurement

# of a squared, normalised innovation with two degrees of freedom: a good one is beyond once in a
# thousand
GATE = 13.8
DEAD_RECKONING = (
    0.07  # error per distance that it may add since the last position that was believed
)
JUMP = (
    0.1,
    0.3,
)  # ν [m/s], ω [rad/s]: standard deviations of the encoders' change from one sample to the next
# so many positions in a row must lie near the one before, for dead reckoning to be doubted rather
# than them
STEADY = 5
COURSE_S = 2.0  # a course over ground takes this long
SHORTEST_M = 0.3  # over less than this it tells no yaw
LONGER, SLACK_M = (
    1.3,
    0.15,
)  # the way by positions may be so many times that by encoders, and so much more
BEND_M = 0.25  # how far the position midway may be off the chord's middle
AWAY = 0.7  # cosine of the angle between course and yaw, below which they contradict: 45°
TURNED, REFUSED_S = (
    5,
    10.0,
    # how many samples the course must contradict the yaw; how long positions and encoders are refused
    # at most
)
SIGMA_AGAIN = (
    0.05,
    0.05,
    0.1,
    0.05,
    0.1,
    0.1,
    0.1,
    0.1,
)  # of (x, y, θ, ν, μ, κ, l_f, l_l) when it begins again


def memory(dt_s):
    """Shapes of what is remembered: `past` positions, with the encoder readings believed then; the
    position that came `last` and the encoder readings last believed; samples `since` a position and
    since encoder readings were believed, and how many in a row the course has `contradicted` the
    yaw; samples since a position `came`, and how many of them in a row were `steady`, near the one
    before.
    """
    return dict(
        past=(4, round(COURSE_S / dt_s)),
        last=(4, 1),
        since=(2, 1),
        contradicted=(1, 1),
        came=(1, 1),
        steady=(1, 1),
    )


def init(dt_s):
    """The memory before the first sample, as one vector."""
    return pack_array(
        {
            name: np.full(shape, np.nan if name in ("past", "last") else 0.0)
            for name, shape in memory(dt_s).items()
        }
    )


def course(past, z, kappa, dt_s):
    """Yaw [rad] by the positions from the oldest of `past` (4, n) to z (4,); whether they drove as
    the encoders say; whether far enough to tell.
    """
    n = past.size2()
    way, midway = z[:2] - past[:2, 0], past[:2, n // 2] - (z[:2] + past[:2, 0]) / 2
    distance, turned = (dt_s * (ca.sum2(past[row, 1:]) + z[row]) for row in (2, 3))
    drove = (ca.norm_2(way) < LONGER * ca.fabs(distance) + SLACK_M) * (
        ca.norm_2(midway) < BEND_M
    )  # 0 also where anything is not a number
    return (
        ca.atan2(way[1], way[0]) + ca.pi * (distance < 0) + kappa * turned / 2,
        drove,
        ca.norm_2(way) > SHORTEST_M,
    )


def gate(z, seen, predict, V, traction, first, constant_speed, dt_s):
    """The readings z (4,) as far as they are believed, NaN elsewhere; 1 to begin again, and the
    pose (3,) to begin at; the memory after.

    seen: the memory (vector) before; predict(z) -> mean (n,) and covariance (n, n) of the pose and
    more by the encoders in z alone; traction: place of κ there; first: 1 if nothing was measured
    before.
    """
    past, last, since, contradicted, came, steady = unpack(seen, memory(dt_s)).values()
    patient = since * dt_s < REFUSED_S

    jump = (
        ca.sumsqr((z[2:] - last[2:]) / ca.DM(JUMP)) > GATE if constant_speed else 0
    )  # never where there is no last one
    encoders = is_valid_measurement(z, 2) * is_valid_measurement(z, 3) * (1 - jump * patient[1])
    turning = ca.if_else(encoders, z[2:], ca.DM.nan(2))

    usable = ca.vertcat(z[:2], turning)
    m, P = predict(usable)
    speed = ca.if_else(encoders, ca.fabs(z[2]), 0)
    there = (
        is_valid_measurement(z, 0)
        * is_valid_measurement(z, 1)
        * (1 - (z[0] == last[0]) * (z[1] == last[1]))
    )
    y = z[:2] - m[:2]
    near = ca.norm_2(z[:2] - last[:2]) < LONGER * speed * dt_s * (came + 1) + SLACK_M
    steady = ca.if_else(there, ca.if_else(near, steady + 1, 0), steady)
    S = (
        P[:2, :2]
        + ca.diag(V[:2])
        + (DEAD_RECKONING * speed * dt_s * since[0] * (steady >= STEADY)) ** 2 * ca.SX.eye(2)
    )
    position = there * ca.logic_or(first, ca.bilin(ca.inv_minor(S), y, y) <= GATE)

    yaw, drove, far = course(past, usable, m[traction], dt_s)
    suspect = there * (1 - position) * drove
    contradicted = ca.if_else(suspect * far * (ca.cos(yaw - m[2]) < AWAY), contradicted + 1, 0)
    again = suspect * ca.logic_or(contradicted >= TURNED, 1 - patient[0])
    nearest = yaw - 2 * ca.pi * ca.floor((yaw - m[2]) / (2 * ca.pi) + 0.5)

    believed = ca.logic_or(position, again)
    after = dict(
        past=ca.horzcat(past[:, 1:], ca.if_else(there, usable, ca.DM.nan(4))),
        last=ca.vertcat(
            ca.if_else(is_valid_measurement(z, 0) * is_valid_measurement(z, 1), z[:2], last[:2]),
            ca.if_else(encoders, z[2:], last[2:]),
        ),
        since=ca.vertcat(
            ca.if_else(believed, 0, since[0] + 1), ca.if_else(encoders, 0, since[1] + 1)
        ),
        contradicted=ca.if_else(again, 0, contradicted),
        came=ca.if_else(there, 0, came + 1),
        steady=steady,
    )
    return dict(
        z_used=ca.vertcat(ca.if_else(believed, z[:2], ca.DM.nan(2)), turning),
        again=again,
        pose=ca.vertcat(z[:2], ca.if_else(far, nearest, m[2])),
        seen=ca.veccat(*after.values()),
    )
