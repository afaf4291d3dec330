"""Loops of the paper's robot, each an estimator and a controller with their options, and runs of
one loop that differ in all else.
"""

import dataclasses

import casadi as ca
import pytest
from helpers import no_compiler, own_controller

import rhec
from notebooks.rivals import RIVALS
from rhec import paper
from rhec.core._casadi import compiled
from rhec.core.controller import rhc
from rhec.core.lanes import lanes
from rhec.simulation import closed_loop
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import NAMES
from rhec.tracked_robot.kinematics import SPEED_MODELS

SMALL = rhec.Scenario(estimation_horizon=3, prediction_horizon=3, duration_s=20.0)


@dataclasses.dataclass(frozen=True)
class Loop:
    """What a scenario has beyond SMALL, and the forms that such a loop does not have."""

    fields: dict
    without: tuple = ()


def own_estimator():
    """An estimator of one's own, with functions that no other has."""
    memory, z = ca.SX.sym("memory", 6), ca.SX.sym("z", 4)
    moved = z[:2] - memory[:2]
    theta = ca.if_else(z[2] > 0.3, ca.atan2(moved[1], moved[0]), memory[2] + 0.16 * z[3])
    estimate = ca.vertcat(z[:2], theta, z[2], 0.9 * ca.tanh(z[2] * 9), ca.sqrt(0.7))
    return ca.Function("mine", [memory, z], [estimate, estimate])


# Who is told the truth is not exported.
NO_C = "oracle", "traction_oracle", "drift_oracle"
GAP = rhec.Fault(kind="missing", start_s=5.0, duration_s=4.0)
OFF = rhec.Fault(kind="outliers", start_s=12.0, duration_s=1.0, size_m=2.0)
NO_GYRO = rhec.Fault(kind="missing", channel="gyro", start_s=8.0, duration_s=3.0)
BOTH = "gyro", "heading"
UNLIKE_TRACKS = dict(soil_under="tracks", slip_difference=0.05, rotation_centre_m=-0.2)
UNLIKE_TRACKS |= dict(rut_length_m=0.5, gnss_slow_share=0.7, gnss_slow_time_s=300.0)
PATH = rhec.Path.from_segments([(3.0, 0.0), (4.0, 0.1), (20.0, -0.05)], start=(1.0, 2.0, 0.5))
EVERYTHING_ELSE = dict(
    speed_model="input", arrival_mean="filtered", input_reference="curvature", command_delay=1,
    prediction_horizon=4, estimation_horizon=2, q=(1, 1, 10), backwards=True, look_ahead_m=0.3,
    guess_yaw_rad=0.2, process_noise="prediction", path=PATH,
)  # fmt: skip

ESTIMATORS = dict(zip(NAMES, NAMES)) | RIVALS
LOOPS = {
    name: Loop(dict(estimator=estimator), ("live",) + ("in_c",) * (name in NO_C))
    for name, estimator in ESTIMATORS.items()
}
LOOPS |= {
    "rhe": Loop({}),
    "delayed": Loop(dict(process_noise="printed", q=paper.Q1, command_delay=1, look_ahead_m=0.3)),
    "weights": Loop(dict(r=2.0, omega_max_radps=0.2, start_yaw_rad=0.2, guess_yaw_rad=0.3)),
    "unlike tracks": Loop(UNLIKE_TRACKS),
    "input": Loop(dict(speed_model="input", process_noise="prediction")),
    "slipping": Loop(dict(speed_model="slipping", faults=(GAP, OFF))),
    "sensors and faults": Loop(
        dict(speed_model="input", process_noise="consistent", sensors=BOTH, faults=(NO_GYRO, OFF))
    ),
    "slipping with a gyro": Loop(
        dict(speed_model="slipping", process_noise="consistent", sensors=("gyro",))
    ),
    "yaw drift": Loop(dict(yaw_drift=True, process_noise="printed", slip_difference=-0.1)),
    "yaw drift with a gyro": Loop(
        dict(
            yaw_drift=True,
            start_yaw_rad=-1.0,  # so that the yaw rate is at both of its bounds
            process_noise="consistent",
            speed_model="input",
            sensors=("gyro",),
            faults=(NO_GYRO, OFF),
        )
    ),
    "yaw drift alone": Loop(dict(estimator=RIVALS["rhe_no_slip_yaw_drift"]), ("live",)),
    "patches and faults": Loop(dict(patches=((0.0, 0.0, 1.0, 0.5, 0.5),), faults=(GAP,))),
    "everything else": Loop(EVERYTHING_ELSE, ("live",)),
    "own": Loop(dict(estimator=own_estimator()), ("live",)),
    "own controller": Loop(dict(controller=own_controller(SMALL)), ("live", "in_c")),
}


def tuned_rules(estimator):
    """Two rules of W, or one where an estimator is tuned by no other."""
    usual = ("printed", "prediction")
    noises = tuning.noises_of(estimator) if isinstance(estimator, str | rhec.Estimator) else usual
    return [rule for rule in usual if rule in noises] or usual


def unlike(scenario):
    """Eight scenarios of one structure that differ in all that it does not hold; steps fail."""
    rules = tuned_rules(scenario.estimator)
    for i in range(8):
        faults = (rhec.Fault(kind="missing", start_s=2.0 + i, duration_s=1.0 + i),)
        faults += (rhec.Fault(kind="latency", delay_s=0.1 * i),)
        yield dataclasses.replace(
            scenario, seed=i,
            process_noise=scenario.process_noise or rules[i % len(rules)],
            q=(10.0 ** (i - 4), 1.0, 0.5 * i), r=10.0 ** (4 - i), speed_mps=0.3 + 0.1 * i,
            start_offset_m=0.5 * i - 2.0, start_yaw_rad=float(i),
            gnss_sigma_m=(0.03, 3.0, 0.0, 1e9)[i % 4],
            encoder_sigma_mps=(0.0, 1.0, 0.02, 1e5)[i // 2], mu_deviation=0.01 * i,
            slip_difference=0.05 * (i - 4), rotation_centre_m=0.1 * (i - 3),
            rut_length_m=(0.0, 0.3, 3.0)[i % 3], gnss_slow_share=i / 8,
            faults=faults if scenario.faults else (),
        )  # fmt: skip


def lanes_as_in_use(build, *structure):
    """Lanes compiled with the flags that campaigns have, without those of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "FLAGS", tuple(flag for flag in compiled.FLAGS if flag != "-O0"))
        return lanes.load.__wrapped__(build, *structure)


def live_step(scenario):
    """The loop's estimator, path and controller as objects in plain Python.

    A function of z that returns x̂, ŷ, θ̂, ν̂, μ̂, κ̂, ω and the KKT tolerances of both.
    """
    setup = closed_loop.set_up(scenario)
    horizon = scenario.prediction_horizon
    with no_compiler():
        mhe = rhec.RHE(
            horizon=scenario.estimation_horizon,
            process_noise=scenario.process_noise or "prediction",
            speed_model=scenario.speed_model,
            sensors=scenario.sensors,
            yaw_drift=scenario.yaw_drift,
            guess=tuple(setup.guess),
        )
        weights = dict(q=scenario.q, r=scenario.r, omega_max=scenario.omega_max_radps)
        mpc = rhec.RHC(horizon=horizon, **weights)
        tracker = rhec.PathTracker(setup.path, horizon, look_ahead_m=scenario.look_ahead_m)
    mpc.iteration.start(rhc.init(mpc.stages, setup.guess[:3], setup.guess[3:]))
    fastest = SPEED_MODELS["parameter"].model.limits[3]
    command = 0.0

    def step(z):
        nonlocal command
        mhe.prepare()
        mpc.prepare()
        estimate = mhe.feedback(z)
        # The yaw rate of the last command stands in for one that was not measured.
        omega = z[3] if abs(z[3]) <= fastest else command
        d = mpc.disturbance(estimate)
        references = tracker.references(estimate, omega + d)
        command = mpc.feedback(estimate.pose, estimate.p, *references, disturbance=d)
        return [*estimate[:6], command, mhe.kkt, mpc.kkt]

    return step
