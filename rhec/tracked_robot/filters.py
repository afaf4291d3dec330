"""The robot's Kalman filters: the paper's EKF, eq. (23)-(26), and one that has the RHE's model.

The paper's filter has the state (x, y, θ, ν), the measured yaw rate as input, an Euler step, and
the traditional model, that is μ = κ = 1. The bounded filter has (μ, κ) as states, too, and keeps
their estimates between 0 and 1.
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import with_packed_memory
from rhec.core.estimator.filter import Filter, Noise
from rhec.core.model.robot_model import Model, interval
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimator_record import TOLD, EstimatorRecord
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, YAW_DRIFT
from rhec.tracked_robot.paper_rhe import SIGMA_START

_TRACTION = QUANTITIES[4:]


def _euler(x, u, p):
    """Eq. (23): one Euler step of a sample from (x, y, θ, ν), with u = (ω, μ, κ)."""
    x_m, y_m, theta, nu = ca.vertsplit(x)
    omega, mu, kappa = ca.vertsplit(u)
    ahead = paper.DT_S * mu * nu
    turned = theta + paper.DT_S * kappa * omega
    return ca.vertcat(x_m + ahead * ca.cos(theta), y_m + ahead * ca.sin(theta), turned, nu)


def pose_and_speed(f, soil, discrete=False):
    """The Model of (x, y, θ, ν) with the yaw rate as input.

    So is what its filter knows of the `soil`, by name, which no output measures.
    """
    return Model(
        states=QUANTITIES[:4],
        inputs=("omega_radps", *soil),
        parameters={},
        outputs=_ROBOT.outputs,
        f=f,
        max_measurement=_ROBOT.limits,
        sigma_held=_ROBOT.sigma_held,
        discrete=discrete,
    )


_ROBOT = SPEED_MODELS["parameter"].model
_PAPERS = pose_and_speed(_euler, QUANTITIES[4:], discrete=True)


def build_step(name, model, bounds=None, told=()):
    """A filter as a Function (memory, z_N, V, W) -> (memory, estimate, …).

    What its Model has as inputs beside the yaw rate is what it is told of the soil: that of the
    sample, on which the robot drives from there on, or 1 where it is told nothing. It ends the
    estimate.

    Args:
        name: Of the filter.
        model: What it knows of the robot.
        bounds: Of its states, as for a Filter; None: those of the model.
        told: Names of TOLD, which the step takes as inputs.
    """
    bounds = model.bounds if bounds is None else bounds
    kalman = Filter(interval(model), paper.DT_S, bounds=bounds)
    shapes = dict(z_N=(4, 1), V=(4, 1), W=(model.n_s, 1))
    shapes |= {signal: TOLD[signal] for signal in told}

    @with_packed_memory(f"{name}_step", kalman.memory_shapes, ca.SX, **shapes)
    def step(z_N, V, W, **values):
        memory = {name: values[name] for name in kalman.memory_shapes}
        no_slip = ca.SX.ones(len(model.inputs) - 1)
        soil = ca.vertcat(*(values[signal] for signal in told)) if told else no_slip
        # The yaw rate counts as exact, also where the last one is held.
        noise = Noise(V=ca.vertcat(V[:3], 0), W=W, held=0)
        after = kalman.sample(z_N, noise, **memory)
        known = ca.vertcat(after.m, soil)
        results = dict(estimate=known[:6], covariance=after.P, deviance=after.deviance)
        if YAW_DRIFT in model.names:  # estimated or told
            results["yaw_drift"] = known[6]
        # The interval that begins at this sample is on the soil of this sample.
        return results | after.memory | dict(v=ca.vertcat(after.v[0], soil))

    return step


def _init(model, guess, sigma):
    """The memory before the first sample, {name: array}."""
    sigma = SIGMA_START | sigma
    return dict(
        m=np.array([guess[name] for name in model.joint_names]),
        P=np.diag(np.square([sigma[name] for name in model.joint_names])),
        # No interval ends at the first sample, so that its inputs have no effect.
        v=np.zeros(len(model.inputs)),
        started=0.0,
    )


def _filter(name, model):
    """The EstimatorRecord of a filter; `tuning` has its noise."""
    return EstimatorRecord(
        build_step=lambda choice: build_step(name, model),
        init=lambda choice, guess, sigma=SIGMA_START: _init(model, guess, sigma),
        settings=lambda scenario: tuning.variances_of(name, scenario),
        states=lambda choice: model.joint_names,
        n_sigma_w=lambda choice: model.n_s,
    )


ESTIMATORS = {"ekf": _filter("ekf", _PAPERS), "bounded_ekf": _filter("bounded_ekf", _ROBOT)}
