"""References on a path, eq. (17)-(18): the desired points over the horizon.

The closed loop follows the closest point from sample to sample by Newton's method, which is cheap
and keeps to its branch where a path crosses itself. `Path.project` searches the whole path.
"""

from typing import Any

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.validation import Intervals, NotNegative, Positive, Real, checked, refuse
from rhec.core.estimator.estimate import Estimate
from rhec.tracked_robot.path import OPEN, Path, advance, ahead_and_left

# Near the centre of an arc every point of it is equally close; this bounds Newton's steps there.
_LEAST_SLOPE = 0.2
_SEGMENTS_STEP = 12  # between the numbers of segments for which loops are compiled
_BEYOND_M = 1e18  # an arc length that no robot reaches
LEAST_KAPPA = 0.1  # a traction κ̂ near 0 must not ask for any yaw rate


def pose_at(s, segments, period_m):
    """Pose (3,) and curvature [1/m] of a path at the arc length s [m], as CasADi expressions.

    `segments` (5, M) has columns (s, x, y, θ, c). Beyond the ends of an open path its last and
    first segment go on.
    """
    # Before an open path's beginning is not after its end.
    s = ca.if_else(period_m < OPEN, s - period_m * ca.floor(s / period_m), s)
    rows = ca.horzsplit(segments)
    row = rows[0]
    for before, after in zip(rows, rows[1:]):
        row = row + (s >= after[0]) * (after - before)
    return ca.vertcat(*advance(row[1], row[2], row[3], row[4], s - row[0], ca)), row[4]


def padded_segments(path):
    """The segments (M, 5) of a Path, and more without length up to the next of a few numbers, so
    that another path seldom needs compiling.

    They lie at the end of a closed path, which is its beginning, and beyond any place of an open
    one, whose last segment goes on.
    """
    _, x, y, theta, _ = path.segments[0]
    none = (path.length_m if path.closed else _BEYOND_M, x, y, theta, 0.0)
    return np.vstack([path.segments, *[none] * (-len(path.segments) % _SEGMENTS_STEP)])


def closest(xy, s, segments, period_m, iterations=2):
    """Arc length closest to xy (2,), by Newton's method from s.

    It solves r'(s) · (xy - r(s)) = 0, whose left side is the distance ahead, and whose derivative
    is -(1 - c · left).
    """
    for _ in range(iterations):
        pose, c = pose_at(s, segments, period_m)
        offset = xy - pose[:2]
        ahead, left = ahead_and_left(offset[0], offset[1], pose[2], ca)
        s = s + ahead / ca.fmax(1 - c * left, _LEAST_SLOPE)
    return s


def build_references(dt_s, horizon, n_segments, input_reference="measured"):
    """References as a Function of the last arc length and the estimate.

    The desired points begin `look_ahead_m` beyond the closest one. They lie one sample of the
    robot's estimated speed over ground, |μ̂ν̂| Δt, apart, so that the path leads and not a clock,
    eq. (17). The desired yaw is that of the path plus λπ, eq. (18), with λ = `backwards`, in the
    turn nearest to the estimate (interpretation G9). The desired yaw rate is the measured one over
    the whole horizon, as in the paper. With `input_reference` "curvature" it is c |μ̂ν̂| / κ̂, for
    the path's curvature c at each node (G8).

    The results are the arc length s_m of the closest point [m], xi_ref (3, N+1), omega_ref (1, N)
    and the curvature there [1/m].
    """
    one = (1, 1)

    @casadi_function(
        "references",
        s_m=one,
        estimate=(6, 1),
        omega_measured=one,
        segments=(5, n_segments),
        period_m=one,
        look_ahead_m=one,
        backwards=one,
    )
    def references(s_m, estimate, omega_measured, segments, period_m, look_ahead_m, backwards):
        x, y, theta, nu, mu, kappa = ca.vertsplit(estimate)
        # The distance over ground in one sample; the search starts where the robot should be now.
        pace = ca.fabs(mu * nu) * dt_s
        s_m = closest(ca.vertcat(x, y), s_m + pace, segments, period_m)
        points = (s_m + look_ahead_m + i * pace for i in range(horizon + 1))
        poses, curvatures = zip(*(pose_at(point, segments, period_m) for point in points))
        _, curvature = pose_at(s_m, segments, period_m)
        xy = ca.horzcat(*poses)[:2, :]
        yaw = ca.horzcat(*(nearest_turn(pose[2] + backwards * ca.pi, theta) for pose in poses))
        if input_reference == "measured":
            omega_ref = ca.repmat(omega_measured, 1, horizon)
        else:
            turning = ca.fmax(kappa, LEAST_KAPPA)
            omega_ref = ca.horzcat(*curvatures[:-1]) * ca.fabs(mu * nu) / turning
        return dict(s_m=s_m, xi_ref=ca.vertcat(xy, yaw), omega_ref=omega_ref, curvature=curvature)

    return references


def _build_compiled(*arguments):
    """{"references": those of `build_references`}, as `compiled.load` takes it."""
    return dict(references=build_references(*arguments))


def nearest_turn(angle, near):
    """The angle, moved by full turns to within π of `near` [rad]."""
    return angle + 2 * ca.pi * ca.floor((near - angle) / (2 * ca.pi) + 0.5)


class PathTracker:
    """References on a path for a control loop of your own, eq. (17)-(18).

    It starts each search at the closest point of the last sample, so that a path may cross itself.
    By default it takes estimates of the paper's robot. For any other Model name its states of
    position and heading: `PathTracker(path, position=("x_m", "y_m"), heading="theta_rad",
    speed=0.5)`.

    Args:
        path: A rhec.Path.
        horizon: Intervals of the controller's prediction.
        dt: Length of a sample [s].
        look_ahead_m: How far beyond the closest point the desired points begin [m].
        position: Names of a Model's states x and y [m].
        heading: Name of its state of yaw, counter-clockwise from the x axis [rad].
        speed: Desired speed on the path [m/s]; negative: backwards, with the yaw turned by π.

    Raises:
        ValueError: If an argument is invalid.
    """

    @checked
    def __init__(
        self,
        path: Path,
        horizon: Intervals = paper.HORIZON,
        dt: Positive = paper.DT_S,
        look_ahead_m: NotNegative = 0.0,
        *,
        position: tuple[str, str] | None = None,
        heading: str | None = None,
        speed: Real | None = None,
    ):
        named = dict(position=position, heading=heading, speed=speed)
        missing = [name for name, value in named.items() if value is None]
        if 0 < len(missing) < 3:
            raise ValueError(
                f"{missing[0]} was not given; PathTracker needs position, heading and speed for a "
                "Model, and none of them for the paper's robot"
            )
        self._names = () if missing else (*position, heading)
        self._speed_mps = speed
        follows = "curvature" if self._names else "measured"
        functions = compiled.load(_build_compiled, dt, horizon, len(path.segments), follows)
        self._call = compiled.BufferedFunction(functions["references"])
        segments = path.segments.T
        self._call.set(segments=segments, period_m=path.period_m, look_ahead_m=look_ahead_m)
        self._call.set(backwards=float(bool(self._names) and speed < 0))
        self._xi_ref = self._call.results["xi_ref"].reshape((3, -1), order="F")

    def restart(self) -> None:
        """Let the next search begin where the first one did, at the beginning of the path."""
        self._call.set(s_m=0.0, estimate=np.zeros(6), omega_measured=0.0)

    @property
    def s_m(self) -> float:
        """Arc length of the path's point closest to the last estimate [m]."""
        return self._call.results["s_m"].item()

    def references(
        self, estimate: Any, omega_measured: float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Desired states and yaw rates for an estimate.

        Args:
            estimate: (x, y, θ, ν, μ, κ), such as rhec.RHE() estimates. With names of states an
                Estimate of that Model, as its rhec.RHE and rhec.EKF return; while its pose is not
                finite, the last finite one counts.
            omega_measured: Measured yaw rate [rad/s]; if it is not finite, the last finite one.
                With names of states it is not taken.

        Returns:
            The paper's xi_ref (3, N+1) and omega_ref (N,), valid until the next call. With names
            of states x_ref (n_x, N+1), in which the other states are 0, and the yaw rates (N,) at
            which a robot turns that follows the path at `speed`.

        Raises:
            ValueError: If an argument is invalid.
        """
        if self._names:
            return self._references_of_model(estimate, omega_measured)
        if omega_measured is None:
            raise ValueError(
                "omega_measured was not given; references of the paper's robot need it"
            )
        if np.isfinite(omega_measured):
            self._call.set(omega_measured=omega_measured)
        self._call.set(estimate=_paper_estimate(estimate))
        self._follow()
        return self._xi_ref, self._call.results["omega_ref"]

    def _references_of_model(self, estimate, omega_measured):
        """References from an Estimate of a Model, by the names of its states."""
        if omega_measured is not None:
            expected = "PathTracker with names of states takes no measured yaw rate"
            refuse("omega_measured was", omega_measured, expected)
        if not isinstance(estimate, Estimate):
            expected = "it should be an Estimate, as rhec.RHE and rhec.EKF of a Model return"
            refuse("estimate was", estimate, expected)
        states = estimate.names[: len(estimate.x)]
        unknown = [name for name in self._names if name not in states]
        if unknown:
            expected = f"this estimate has the states {', '.join(states)}"
            raise ValueError(f"PathTracker was given the name {unknown[0]!r}; {expected}")
        places = [states.index(name) for name in self._names]
        pose = estimate.x[places]
        if np.isfinite(pose).all():
            self._call.set(estimate=(*pose, self._speed_mps, 1.0, 1.0))
        self._follow()
        x_ref = np.zeros((len(states), self._xi_ref.shape[1]))
        x_ref[places] = self._xi_ref
        return x_ref, self._call.results["omega_ref"].copy()

    def _follow(self):
        """Find the closest point, from which the next search begins."""
        self._call.call()
        self._call.set(s_m=self._call.results["s_m"])


def _paper_estimate(estimate):
    """The first six entries of an estimate of the paper's robot; refuse what has none."""
    if isinstance(estimate, Estimate) or len(estimate) < 6:
        expected = (
            "it should be (x, y, θ, ν, μ, κ); for a Model, PathTracker takes the names of its "
            "states, as in position=('x_m', 'y_m'), heading='theta_rad', speed=0.5"
        )
        refuse("estimate was", estimate, expected)
    return estimate[:6]
