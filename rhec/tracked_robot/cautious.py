"""A controller that slows down where it may not be able to stay on the path. Not in the paper.

It commands two inputs: the yaw rate, by the RHC as it is, and the speed ν, as fast as two chance
constraints allow. In each, `caution` standard deviations σ of the estimate are set aside. (EVORA,
arXiv 2311.06234, has the same model, the unicycle with uncertain traction.)

    |c| μ̄ ν ≤ κ̲ ω_max   the soil gives the yaw rate that curvature c asks for, eq. (16), even with
                         μ̄ = μ̂ + z σ_μ, κ̲ = κ̂ - z σ_κ; in curves ahead: once it has braked
    |ê| + z σ_e ≤ 0.12   the robot's nose is within the tolerance [m]; where less than BAND_M is
                         left, ν shrinks in proportion to what is left

The first looks ahead; the second answers what nobody could foresee, such as a wet patch, since a
slow robot turns in less space: in curves. On rows it comes back more steeply, too, which swings its
corners into the crop; there it is not as slow. ν changes by ACCELERATION_MPS2 at most, which the
estimators, whose models have a constant speed, can follow.
"""

import casadi as ca

from rhec import paper
from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.path import OPEN
from rhec.tracked_robot.references import pose_at

__all__ = ["ACCELERATION_MPS2", "NOSE_M", "SLOWEST_MPS", "build_speed", "build_step"]

# By campaigns on training seeds from 6000 on.
BAND_M = 0.04
ACCELERATION_MPS2 = 0.5
SLOWEST_MPS = dict(curve=0.15, row=0.35)
NOSE_M = paper.ROBOT_LENGTH_M / 2
_IN_A_ROW_M = paper.ROW_SPACING_M / 2  # who is further off has a row yet to reach


def build_speed(states, n_segments, dt_s):
    """The next commanded speed [m/s], above 0, from the last one and an estimate.

    Args:
        states: Names that the estimator's covariance (n, n) covers; others are taken as known.
        n_segments: Of the path.
        dt_s: Length of a sample [s].

    Returns:
        A Function of speed (the last one), s (the closest point), estimate (6,), covariance (n, n),
        upper (ω_max), segments, period_m, speed_mps (the set speed), caution.
    """
    one = (1, 1)
    n = len(states)
    known = ca.DM(len(QUANTITIES), n)
    for place, name in enumerate(states):
        if name in QUANTITIES:
            known[QUANTITIES.index(name), place] = 1

    @casadi_function(
        "cautious_speed",
        speed=one,
        s=one,
        estimate=(6, 1),
        covariance=(n, n),
        upper=one,
        segments=(5, n_segments),
        period_m=one,
        speed_mps=one,
        caution=one,
    )
    def speed(speed, s, estimate, covariance, upper, segments, period_m, speed_mps, caution):
        P = known @ covariance @ known.T
        fast = ca.fabs(speed_mps)
        x, y, theta, _, mu, kappa = ca.vertsplit(estimate)
        most_mu = ca.fmin(mu + caution * ca.sqrt(P[4, 4]), 1)
        least_kappa = ca.fmax(kappa - caution * ca.sqrt(P[5, 5]), 0)

        pose, curvature = pose_at(s, segments, period_m)
        sine = ca.sin(pose[2])
        cosine = ca.cos(pose[2])
        ahead = ca.if_else(speed_mps < 0, -NOSE_M, NOSE_M)
        left = (y - pose[1]) * cosine - (x - pose[0]) * sine + ahead * ca.sin(theta - pose[2])
        slope = ca.vertcat(-sine, cosine, ahead * ca.cos(theta - pose[2]))
        sigma = ca.sqrt(ca.bilin(P[:3, :3], slope, slope))
        room = paper.TOLERANCE_M - ca.fabs(left) - caution * sigma
        slowest = ca.if_else(curvature == 0, SLOWEST_MPS["row"], SLOWEST_MPS["curve"])
        limit = ca.fmin(ca.fmax(fast * room / BAND_M, slowest), fast)  # slow where room is NaN
        limit = ca.if_else(ca.fabs(left) > _IN_A_ROW_M, fast, limit)

        begins = [*ca.horzsplit(segments[0, :]), period_m]
        closed = period_m < OPEN
        place = ca.if_else(closed, s - period_m * ca.floor(s / period_m), ca.fmax(s, 0))
        for begin, end, c in zip(begins, begins[1:], ca.horzsplit(segments[4, :])):
            to = begin - place + period_m * (end <= place)
            in_curve = least_kappa * upper / (most_mu * ca.fabs(c))
            in_curve = ca.if_else(c == 0, fast, in_curve)
            brakes = 2 * ACCELERATION_MPS2 * ca.fmax(to - NOSE_M, 0)
            limit = ca.fmin(limit, ca.sqrt(in_curve**2 + brakes))
        limit = ca.fmax(limit, ca.fmin(SLOWEST_MPS["curve"], fast))
        change = ACCELERATION_MPS2 * dt_s
        return dict(speed=ca.fmin(ca.fmax(limit, speed - change), speed + change))

    return speed


def build_step(control, states, n_segments, dt_s):
    """The step of an RHC, (memory, weights, references) -> (memory, kkt, command, ok), with the
    speed as a second command.

    Its memory has the last speed at its end. states, n_segments, dt_s: as for `build_speed`.
    """
    speed = build_speed(states, n_segments, dt_s)
    sizes = {name: f.size_in(name) for f in (control, speed) for name in f.name_in()}
    n = control.numel_in("memory")
    del sizes["speed"], sizes["estimate"]

    @casadi_function("cautious_step", ca.MX, **sizes | dict(memory=(n + 1, 1)))
    def step(memory, s_0, **known):
        of_plan, last = ca.vertsplit(memory, [0, n, n + 1])
        known |= dict(s_0=s_0, estimate=s_0, memory=of_plan, speed=last)
        planned = control(**select_inputs(control, known))
        newest = speed(**select_inputs(speed, known))["speed"]
        planned["memory"] = ca.vertcat(planned["memory"], newest)
        return planned | dict(speed_mps=ca.if_else(known["speed_mps"] < 0, -newest, newest))

    return step
