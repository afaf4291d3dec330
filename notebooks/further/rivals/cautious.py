"""A controller that slows down where it may not be able to stay on the path. Not in the paper.

    careful = dataclasses.replace(scenario, controller=cautious.controller(scenario))

It commands two inputs: the yaw rate, by the RHC as it is, and the speed ν, as fast as two chance
constraints allow. Each sets aside z = `caution` standard deviations σ of the estimate. (EVORA,
arXiv 2311.06234, has the same model, the unicycle with uncertain traction.)

    |c| μ̄ ν ≤ κ̲ ω_max   The soil gives the yaw rate that the curvature c asks for, eq. (16), even
                         with μ̄ = μ̂ + z σ_μ and κ̲ = κ̂ - z σ_κ. In curves ahead it holds once
                         the robot has braked.
    |ê| + z σ_e ≤ 0.12   The robot's nose is within the tolerance [m]. Where less than BAND_M is
                         left of it, ν shrinks in proportion to what is left.

The first constraint looks ahead. The second answers what nobody could foresee, such as a wet patch,
since a slow robot turns in less space. On rows a slow robot also comes back more steeply, which
swings its corners into the crop, so it is not as slow there. ν changes by ACCELERATION_MPS2 at
most, which the estimators, whose models have a constant speed, can follow.
"""

import functools

import casadi as ca

import rhec
from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core._casadi.packing import pack_array
from rhec.core.controller.rhc import init as plan_init
from rhec.simulation.closed_loop import first_guess
from rhec.tracked_robot import paper_rhc, yaw_disturbance
from rhec.tracked_robot.estimators import Choice, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.path import OPEN, path_of
from rhec.tracked_robot.references import pose_at

# By campaigns on training seeds from 6000 on.
BAND_M = 0.04
ACCELERATION_MPS2 = 0.5
SLOWEST_MPS = dict(curve=0.15, row=0.35)
NOSE_M = paper.ROBOT_LENGTH_M / 2
# A robot further from the path has yet to reach its row and need not keep within it.
_IN_A_ROW_M = paper.ROW_SPACING_M / 2


def build_speed(states, n_segments, dt_s):
    """The next speed to command [m/s], as a Function of the last one and an estimate.

    `states` names what the estimator's covariance (n, n) covers; others count as certain. The
    speeds are above 0; `upper` is ω_max, `speed_mps` the set speed and `caution` z.
    """
    one = (1, 1)
    selection = _selection(states)

    @casadi_function(
        "cautious_speed",
        speed=one,
        s_m=one,
        estimate=(6, 1),
        covariance=(len(states), len(states)),
        upper=one,
        segments=(5, n_segments),
        period_m=one,
        speed_mps=one,
        caution=one,
    )
    def speed(speed, s_m, estimate, covariance, upper, segments, period_m, speed_mps, caution):
        P = selection @ covariance @ selection.T
        set_speed = ca.fabs(speed_mps)
        largest_mu = ca.fmin(estimate[4] + caution * ca.sqrt(P[4, 4]), 1)
        least_kappa = ca.fmax(estimate[5] - caution * ca.sqrt(P[5, 5]), 0)
        in_reach = largest_mu, least_kappa * upper
        pose, curvature = pose_at(s_m, segments, period_m)
        limit = _limit_by_tolerance(estimate, P, pose, curvature, speed_mps, caution)
        for in_curve, distance in _curves(s_m, segments, period_m, in_reach, set_speed):
            # ν² = ν_c² + 2 a d: so fast it may be at the distance d from what allows ν_c.
            brakes = 2 * ACCELERATION_MPS2 * ca.fmax(distance - NOSE_M, 0)
            limit = ca.fmin(limit, ca.sqrt(in_curve**2 + brakes))
        limit = ca.fmax(limit, ca.fmin(SLOWEST_MPS["curve"], set_speed))
        change = ACCELERATION_MPS2 * dt_s
        return dict(speed=ca.fmin(ca.fmax(limit, speed - change), speed + change))

    return speed


def _selection(states):
    """The matrix S (6, n) by which S P Sᵀ is the covariance of (x, y, θ, ν, μ, κ)."""
    selection = ca.DM(len(QUANTITIES), len(states))
    for place, name in enumerate(states):
        if name in QUANTITIES:
            selection[QUANTITIES.index(name), place] = 1
    return selection


def _limit_by_tolerance(estimate, P, pose, curvature, speed_mps, caution):
    """The speed that the second constraint allows, for the path's closest pose and curvature.

    ê is the nose's distance to the left of the path, and σ_e² = g' P g with the slope g of ê over
    (x, y, θ).
    """
    x, y, theta = ca.vertsplit(estimate[:3])
    set_speed = ca.fabs(speed_mps)
    sine = ca.sin(pose[2])
    cosine = ca.cos(pose[2])
    # In reverse the tail leads.
    nose = ca.if_else(speed_mps < 0, -NOSE_M, NOSE_M)
    left = (y - pose[1]) * cosine - (x - pose[0]) * sine + nose * ca.sin(theta - pose[2])
    slope = ca.vertcat(-sine, cosine, nose * ca.cos(theta - pose[2]))
    sigma = ca.sqrt(ca.bilin(P[:3, :3], slope, slope))
    room = paper.TOLERANCE_M - ca.fabs(left) - caution * sigma
    slowest = ca.if_else(curvature == 0, SLOWEST_MPS["row"], SLOWEST_MPS["curve"])
    # fmax drops a NaN, so that the robot is slow where the room is unknown.
    limit = ca.fmin(ca.fmax(set_speed * room / BAND_M, slowest), set_speed)
    return ca.if_else(ca.fabs(left) > _IN_A_ROW_M, set_speed, limit)


def _curves(s, segments, period_m, in_reach, set_speed):
    """For each segment, the speed that the first constraint allows and the distance to it [m].

    in_reach: (μ̄, κ̲ ω_max).
    """
    largest_mu, turning = in_reach
    begins = [*ca.horzsplit(segments[0, :]), period_m]
    closed = period_m < OPEN
    place = ca.if_else(closed, s - period_m * ca.floor(s / period_m), ca.fmax(s, 0))
    for begin, end, c in zip(begins, begins[1:], ca.horzsplit(segments[4, :])):
        # Segments behind the robot come again after a whole period.
        distance = begin - place + period_m * (end <= place)
        in_curve = turning / (largest_mu * ca.fabs(c))
        yield ca.if_else(c == 0, set_speed, in_curve), distance


def controller(scenario, caution=0.25):
    """The RHC of a Scenario with the speed as a second command, as a rhec.Controller.

    Args:
        scenario: The Scenario that it is for; its own controller does not count.
        caution: Number of standard deviations of the estimate that it sets aside.

    Returns:
        The rhec.Controller. Its memory starts at the scenario's start and set speed.
    """
    choice = Choice.of(scenario)
    path = path_of(scenario)
    stages, settings = paper_rhc.problem_of_scenario(scenario)
    structure = (
        estimator_of(choice.estimator).states(choice),
        estimator_of(choice.estimator).has_yaw_drift(choice),
        stages,
        scenario.traction_timing,
        len(path.segments),
    )
    guess = first_guess(scenario, path)
    plan = plan_init(stages, guess[:3], guess[3:], settings)
    memory = (*pack_array(plan).tolist(), scenario.speed_mps)
    return _made(compiled.loop_symbols(), structure, caution, memory)


# The runs of a campaign share it: to build one takes a third of a second.
@functools.lru_cache(maxsize=64)
def _made(symbols, structure, caution, memory):
    """The Controller; `symbols` is the kind that Functions may use, which depends on a compiler."""
    states, has_yaw_drift, stages, timing, n_segments = structure
    control = paper_rhc.build_step(stages, timing)
    if has_yaw_drift:
        control = _compensated(control)
    return rhec.Controller(build_step(control, states, n_segments, paper.DT_S, caution), memory)


def _compensated(control):
    """A controller's step with the input `disturbance` d: it plans ω + d and commands ω."""
    move, take_off = yaw_disturbance.moved_bounds(), yaw_disturbance.taken_off()
    shapes = {name: control.size_in(name) for name in control.name_in()} | dict(disturbance=(1, 1))

    @casadi_function("compensated_step", ca.MX, **shapes)
    def step(disturbance, **signals):
        bounds = move(lower=signals["lower"], upper=signals["upper"], disturbance=disturbance)
        planned = control(**select_inputs(control, signals | bounds))
        return planned | take_off(command=planned["command"], disturbance=disturbance)

    return step


def build_step(control, states, n_segments, dt_s, caution):
    """The step of an RHC with the speed as a second command.

    The arguments are those of `build_speed`, after the step `control` of the RHC, and the caution.
    The step's memory has the last speed at its end, and its results have `speed_mps`, too.
    """
    speed = build_speed(states, n_segments, dt_s)
    shapes = {name: f.size_in(name) for f in (control, speed) for name in f.name_in()}
    for name in ("speed", "estimate", "caution"):
        del shapes[name]
    n = control.numel_in("memory")

    @casadi_function("cautious_step", ca.MX, **shapes | dict(memory=(n + 1, 1)))
    def step(memory, s_0, **signals):
        plan, last_speed = ca.vertsplit(memory, [0, n, n + 1])
        signals = signals | dict(s_0=s_0, memory=plan)
        planned = control(**select_inputs(control, signals))
        signals |= dict(estimate=s_0, speed=last_speed, caution=caution)
        newest = speed(**select_inputs(speed, signals))["speed"]
        planned["memory"] = ca.vertcat(planned["memory"], newest)
        return planned | dict(speed_mps=ca.if_else(signals["speed_mps"] < 0, -newest, newest))

    return step
