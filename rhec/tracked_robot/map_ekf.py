"""A bounded EKF that knows the soil of earlier drives. Not in the paper.

Its states are (x, y, θ, ν, μ, κ, δ), δ the yaw drift (`rhec.tracked_robot.yaw_drift`). Of the last
three, q = (μ, κ, δ), the map gives a mean m(x, y) and a variance σ²(x, y) at the estimated place.
The rest, q - m, is an Ornstein-Uhlenbeck process of the distance d that the robot goes
over ground, with the correlation length ℓ of the soil:

    q⁺ = m(x⁺, y⁺) + e^{-d/ℓ} (q - m(x, y)) + w,  w ~ N(0, (1 - e^{-2d/ℓ}) σ²(x⁺, y⁺)).

So the estimate is the map's where the map is sure, follows the measurements where it is not, and
returns to the map after a place where the map was wrong. Without a map σ and ℓ are so large that
q is a random walk. The slope of the map is small and left out of the filter's covariance.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, with_packed_memory
from rhec.core.estimator.ekf import predict_and_correct
from rhec.core.model.base import interval, rk4
from rhec.core.model.limits import is_valid_measurement
from rhec.tracked_robot import ekf, soil_map, terrain, tuning, yaw_drift
from rhec.tracked_robot.choice import Estimator
from rhec.tracked_robot.rhe import SIGMA_START

STATES = yaw_drift.STATES
_N = len(STATES)
_MODEL = yaw_drift.MODEL
_MEMORY = dict(m=(_N, 1), P=(_N, _N), omega=(1, 1), started=(1, 1))
_ONE = (1, 1)
_PAIR = (2, 1)
_LEAST_MU = 0.1  # by which a yaw rate may be divided


def _build_soil(shape):
    """The map at a pose as a Function (pose, map …) -> (mean (3,), variance (3,)) of (μ, κ, δ).

    With g = s_x sin θ - s_y cos θ + g₀, the yaw for each metre of the tracks, δ = g / μ.
    """
    lookup = terrain.lookup(shape)
    size = lookup.size_in("slip")
    settings = dict(map_origin_m=_PAIR, map_cell_m=_ONE, map_yaw=_ONE)
    settings |= dict.fromkeys(("map_traction", "map_slope", "map_variance"), size)
    settings |= dict(map_yaw_variance=size)
    along = _build_along()

    @casadi_function("map_at", ca.MX, pose=(3, 1), **settings)
    def map_at(pose, map_origin_m, map_cell_m, map_yaw, **fields):
        found = {
            name: lookup(pose[:2], map_origin_m, map_cell_m, field)
            for name, field in fields.items()
        }
        mean, variance = along(pose[2], map_yaw, *found.values())
        return dict(mean=mean, variance=variance)

    return map_at


def _build_along():
    """Mean and variance of (μ, κ, δ) along a heading, from the map's fields at a place."""

    pairs = dict.fromkeys(("traction", "slope", "variance", "yaw_variance"), _PAIR)

    @casadi_function("along", theta=_ONE, yaw=_ONE, **pairs)
    def along(theta, yaw, traction, slope, variance, yaw_variance):
        mu = ca.fmax(traction[0], _LEAST_MU)
        g = slope[0] * ca.sin(theta) - slope[1] * ca.cos(theta) + yaw
        return dict(
            mean=ca.vertcat(traction, g / mu),
            variance=ca.vertcat(variance, yaw_variance[0] / mu**2),
        )

    return along


def _move(m, omega, dt_s):
    return rk4(_MODEL.dynamics, m[:3], omega, m[3:], dt_s)


def _build_ahead(dt_s):
    """Where the robot will be, and e^{-d/ℓ}, as a Function (m, ω, z, ℓ) -> (pose, omega, keep)."""

    @casadi_function("ahead", m=(_N, 1), omega=_ONE, z_N=(4, 1), map_length_m=_ONE)
    def ahead(m, omega, z_N, map_length_m):
        # While the encoders are silent, the last yaw rate is held.
        omega = ca.if_else(is_valid_measurement(z_N[3], _MODEL.limits[3]), z_N[3], omega)
        keep = ca.exp(-ca.fabs(dt_s * m[3] * m[4]) / map_length_m)
        return dict(pose=_move(m, omega, dt_s), omega=omega, keep=keep)

    return ahead


def _build_filter(dt_s):
    """One sample of the filter, given the map at its last place and at the next one."""
    moments = dict(mean=(3, 1), next_mean=(3, 1), variance=(3, 1), next_variance=(3, 1))
    noise = dict(V=(4, 1), W=(4, 1))

    @casadi_function("map_filter", **_MEMORY, keep=_ONE, **moments, z_N=(4, 1), noise=noise)
    def sample(m, P, omega, started, keep, mean, next_mean, variance, next_variance, z_N, noise):
        V, W = noise.values()
        moved = ca.vertcat(_move(m, omega, dt_s), m[3], next_mean + keep * (m[4:] - mean))
        Q = ca.diag(ca.vertcat(W, (1 - keep**2) * next_variance))
        A = ca.jacobian(moved, m)
        # At the first sample the map is all that is known of the soil.
        m = ca.if_else(started, m, ca.vertcat(m[:4], mean))
        P = ca.if_else(started, P, ca.diagcat(P[:4, :4], ca.diag(variance)))
        outputs = interval(_MODEL).outputs
        m, P, deviance = predict_and_correct(m, P, moved, A, Q, started, z_N, V, outputs)
        m = ekf.within_bounds(interval(_MODEL).bounds, m, P)
        return dict(m=m, P=ca.densify(P), deviance=deviance)

    return sample


def _build_step(choice):
    """The filter as a Function (memory, z_N, V, W, map …) -> (memory, estimate, …)."""
    map_at = _build_soil(choice.map_shape)
    ahead = _build_ahead(choice.dt_s)
    sample = _build_filter(choice.dt_s)
    shapes = {name: map_at.size_in(name) for name in map_at.name_in() if name != "pose"}
    shapes |= dict(z_N=(4, 1), V=(4, 1), W=(4, 1), map_length_m=_ONE)
    order = ("z_N", "V", "W", *(name for name in shapes if name.startswith("map")))

    @with_packed_memory("map_ekf_step", _MEMORY, ca.MX, **{name: shapes[name] for name in order})
    def step(m, P, omega, started, z_N, V, W, map_length_m, **fields):
        pose, omega, keep = ahead(m, omega, z_N, map_length_m)
        here = map_at(pose=m[:3], **fields)
        there = map_at(pose=pose, **fields)
        moments = here["mean"], there["mean"], here["variance"], there["variance"]
        m, P, deviance = sample(m, P, omega, started, keep, *moments, z_N, V, W)
        result = dict(estimate=m[:6], yaw_drift=m[6], covariance=P, deviance=deviance)
        return result | dict(m=m, P=P, omega=omega, started=ca.MX(1))

    return step


def _init(choice, guess, sigma=SIGMA_START):
    # The map stands in for a guess of the yaw drift, too.
    start = dict(yaw_drift_radpm=0.0)
    return ekf.init(STATES, start | guess, start | sigma)


def _settings(scenario):
    soil = soil_map.settings(soil_map.map_of(scenario))
    return tuning.variances_of("map_ekf", scenario) | soil


MAP_EKF = Estimator(
    build_step=_build_step,
    init=_init,
    settings=_settings,
    states=lambda choice: STATES,
    n_sigma_w=lambda choice: 4,
    has_yaw_drift=True,
)
