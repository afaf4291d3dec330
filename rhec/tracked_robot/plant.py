"""The simulated robot (paper, Sec. System Description): two tracks with a speed loop each,
encoders, RTK GNSS and bumps, on slipping soil.

It stands in for the field: the 50 Hz speed control of the paper's Kangaroo x2, the sensors at 5 Hz,
and the soil, which turns track speeds into motion by eq. (2). Beyond eq. (2), each track may have a
traction of its own, the robot may turn about a point ahead of its middle, and ruts may be long.
docs/world.md says which of these a world has, and why.
"""

import functools
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function, packed_size
from rhec.core._casadi.sines import sines_by_addition
from rhec.core.model.robot_model import rk4
from rhec.tracked_robot import terrain
from rhec.tracked_robot.kinematics import f_with_drift

SUBSTEPS = round(paper.SPEED_LOOP_RATE_HZ / paper.GNSS_RATE_HZ)
_MOTOR_LAG_S = 0.1  # first-order lag from motor command to track speed
# With these gains a standing track takes about half a second to the commanded speed.
_GAIN_P = 1.0
_GAIN_I = 10.0
_SPEED_LIMIT_MPS = 1.5  # of a track: saturation of the motor driver
_SHORTEST_RUT_M = 1e-9  # instead of 0, by which no distance can be divided

# Shapes by name: what one sample hands to the next, and the standard normal noise of one sample.
MEMORY = dict(pose=(3, 1), tracks=(2, 1), integral=(2, 1), drift=(2, 1), encoders=(2, 1))
MEMORY |= dict(rut=(1, 1), running=(1, 1))
NOISE = dict(white=(2, 1), slow=(2, 1), bump=(1, 1), encoder=(2, SUBSTEPS), speed=(1, 1))
_N_SPEED = packed_size({"speed": NOISE["speed"]})
_N_OTHERS = packed_size(NOISE) - _N_SPEED
# Settings of the sensors, by the names of Scenario's parameters.
SENSORS = dict.fromkeys(
    ("gnss_sigma_m", "gnss_slow_share", "gnss_slow_time_s", "speed_sigma_mps"), (1, 1)
)
# Settings of the robot's body and the ground, by the names of Scenario's parameters.
BODY = dict.fromkeys(
    (
        "track_width_m",
        "rotation_centre_m",
        "encoder_sigma_mps",
        "bump_sigma_radps",
        "rut_length_m",
        "slip_difference",
    ),
    (1, 1),
)

# Random streams of a seed; others belong to the sensors that not every robot has
# (`sensors`), and to the faults.
_STREAM_OF_ALL_BUT_SPEED = 1
_STREAM_OF_SPEED = 4


class Normal(NamedTuple):
    """Standard normal numbers of one of a seed's random streams; no fault is in them."""

    stream: int

    def __call__(self, seed, samples, faults=()):
        """The numbers (samples, 1)."""
        return standard_normal(seed, self.stream, samples, 1)


def draw_noise(seed, samples, faults=()):
    """Standard normal noise of a seed, (samples, n), each row NOISE packed; no fault is in it.

    The first rows are those of fewer samples. The noise of the speed comes last and from a separate
    stream, so that all else is the same with and without it.
    """
    return np.hstack(
        [
            standard_normal(seed, _STREAM_OF_ALL_BUT_SPEED, samples, _N_OTHERS),
            standard_normal(seed, _STREAM_OF_SPEED, samples, _N_SPEED),
        ]
    )


@functools.lru_cache(maxsize=4)  # the estimators of a field, and each move of a slider, share it
def standard_normal(seed, stream, samples, n):
    """Independent standard normal numbers (samples, n) of one of a seed's random streams."""
    bits = np.random.Philox(np.random.SeedSequence((seed, stream)))
    numbers = np.random.Generator(bits).standard_normal((samples, n))
    numbers.flags.writeable = False
    return numbers


def truth():
    """The state (x, y, θ, ν, μ, κ) of the robot and its tracks' yaw rate ω, as a Function."""

    @casadi_function(
        "truth",
        pose=MEMORY["pose"],
        tracks=MEMORY["tracks"],
        traction=(2, 1),
        track_width_m=BODY["track_width_m"],
    )
    def truth(pose, tracks, traction, track_width_m):
        nu, omega = body_speeds(tracks, track_width_m)
        return dict(truth=ca.vertcat(pose, nu, traction), omega=omega)

    return truth


def measure(dt_s):
    """The sensors as a Function (pose, drift, encoders, running, noise, settings) -> (z, drift).

    z is the GNSS position, with a white and a slowly varying error, and the last means of the
    encoders, of which the speed has an error that both tracks share.

    gnss_slow_share is the slow part's share of the variance of the position. This part d is a
    first-order Gauss-Markov process of the time constant T = gnss_slow_time_s,
    d = e^{-Δt/T} d⁻ + √(1 - e^{-2Δt/T}) w (interpretation G4), stationary from the first sample on.
    Independent errors of two tracks would make the yaw rate as noisy as the paper's, but the speed
    18 times less noisy: hence speed_sigma_mps.
    """
    pieces = {name: MEMORY[name] for name in ("pose", "drift", "encoders", "running")}
    noise = {name: NOISE[name] for name in ("white", "slow", "speed")}

    @casadi_function("measure", **pieces, **noise, **SENSORS)
    def measure(
        pose,
        drift,
        encoders,
        running,
        white,
        slow,
        speed,
        gnss_sigma_m,
        gnss_slow_share,
        gnss_slow_time_s,
        speed_sigma_mps,
    ):
        drift = gauss_markov(running * ca.exp(-dt_s / gnss_slow_time_s), drift, slow)
        # Shares of a variance: the standard deviations go with their square roots.
        white_m = gnss_sigma_m * ca.sqrt(1 - gnss_slow_share)
        slow_m = gnss_sigma_m * ca.sqrt(gnss_slow_share)
        position = pose[:2] + white_m * white + slow_m * drift
        z = ca.vertcat(position, encoders[0] + speed_sigma_mps * speed, encoders[1])
        return dict(z=z, drift=drift)

    return measure


def gauss_markov(keep, before, w):
    """A Gauss-Markov process of standard deviation 1: a⁺ = k a + √(1 - k²) w; w itself for k = 0.

    `running` is 0 in the first sample only. With it as a factor of k, the process is stationary
    from there on, although the memory before the first sample is the same for every seed.
    """
    return keep * before + ca.sqrt(1 - keep**2) * w


def soil(shape, under):
    """The soil below the robot as a Function (pose, slip fields, settings) -> (traction, drift).

    traction (2,) is (μ, κ), the means of both tracks. The yaw drift is
    δ = (μ_r - μ_l) / (b μ) [rad/m], so that the robot turns at κω + μνδ: each track moves over
    ground at its own μ times its own speed, of which eq. (2) keeps the mean alone.

    Args:
        shape: Shape of the slip fields' grid.
        under: "centre": both tracks have the traction below the robot's middle. "tracks": each has
            that below its own middle.
    """
    lookup = terrain.lookup(shape)
    middles = _build_middles()
    both = _build_both_tracks()
    settings = {name: lookup.size_in(name) for name in ("origin_m", "cell_m", "slip")}
    settings |= {name: BODY[name] for name in ("slip_difference", "track_width_m")}

    @casadi_function("soil", ca.MX, pose=MEMORY["pose"], **settings)
    def soil(pose, origin_m, cell_m, slip, slip_difference, track_width_m):
        places = middles(pose, track_width_m) if under == "tracks" else [pose[:2]]
        found = [lookup(place, origin_m, cell_m, slip) for place in places]
        traction, yaw_drift = both(found[0], found[-1], slip_difference, track_width_m)
        return dict(traction=traction, yaw_drift_radpm=yaw_drift)

    return soil


def _build_middles():
    """The middles of both tracks as a Function (pose, track_width_m) -> (left, right)."""

    @casadi_function("middles", pose=MEMORY["pose"], track_width_m=(1, 1))
    def middles(pose, track_width_m):
        to_the_left = track_width_m / 2 * ca.vertcat(-ca.sin(pose[2]), ca.cos(pose[2]))
        return dict(left_m=pose[:2] + to_the_left, right_m=pose[:2] - to_the_left)

    return middles


def _build_both_tracks():
    """Traction and yaw drift of a robot from (μ, κ) below its tracks, as a Function.

    The left track has its μ times (1 - d/2), the right one times (1 + d/2), at most 1.
    """
    one = (1, 1)

    @casadi_function("both", left=(2, 1), right=(2, 1), slip_difference=one, track_width_m=one)
    def both(left, right, slip_difference, track_width_m):
        mu_left = ca.fmin(left[0] * (1 - slip_difference / 2), 1)
        mu_right = ca.fmin(right[0] * (1 + slip_difference / 2), 1)
        mu = (mu_left + mu_right) / 2
        yaw_drift = (mu_right - mu_left) / (track_width_m * mu)
        return dict(traction=ca.vertcat(mu, (left[1] + right[1]) / 2), yaw_drift_radpm=yaw_drift)

    return both


def drive(dt_s):
    """One sample of driving as a Function.

    The track speeds follow (speed_mps, omega_radps) at 50 Hz by a PI loop with saturation and a
    motor of first order; soil of the traction (2,) turns them into motion, eq. (2), and turns the
    robot by yaw_drift_radpm per metre over ground. The result `encoders` holds the means of
    ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b over the sample, as measured.

    The robot turns about the point c = rotation_centre_m ahead of its middle: that point p moves as
    eq. (2) says, and the middle is at p - c (cos θ, sin θ).

    Bumps turn the robot. Without rut_length_m each does so for one sample. With it, they are the
    shape of the ground: a Gauss-Markov process of the distance driven, of that correlation length,
    the usual model of a soil's random roughness. Its yaw rate grows with the speed of the tracks;
    bump_sigma_radps is its standard deviation at the paper's speed.
    """
    names = ("pose", "tracks", "integral", "rut", "running")
    pieces = {name: MEMORY[name] for name in names}
    noise = {name: NOISE[name] for name in ("bump", "encoder")}
    command = dict(speed_mps=(1, 1), omega_radps=(1, 1), traction=(2, 1), yaw_drift_radpm=(1, 1))
    body = {name: shape for name, shape in BODY.items() if name != "slip_difference"}

    @casadi_function("drive", **pieces, **command, **noise, **body)
    def drive(
        pose,
        tracks,
        integral,
        rut,
        running,
        speed_mps,
        omega_radps,
        traction,
        yaw_drift_radpm,
        bump,
        encoder,
        track_width_m,
        rotation_centre_m,
        encoder_sigma_mps,
        bump_sigma_radps,
        rut_length_m,
    ):
        half = track_width_m / 2
        target = ca.vertcat(speed_mps - half * omega_radps, speed_mps + half * omega_radps)
        heading = _heading(pose)
        first_mps = ca.fabs(body_speeds(tracks, track_width_m)[0])
        moved_m = dt_s * traction[0] * first_mps
        keep = running * ca.exp(-moved_m / ca.fmax(rut_length_m, _SHORTEST_RUT_M))
        rut = gauss_markov(keep, rut, bump)
        bumps = ca.if_else(rut_length_m > 0, rut * first_mps / paper.SPEED_MPS, bump)
        h = dt_s / SUBSTEPS
        measured = []
        for i in range(SUBSTEPS):
            measured.append(tracks + encoder_sigma_mps * encoder[:, i])
            limited, integral = _speed_loop(target, measured[-1], integral, h)
            nu, omega = body_speeds(tracks, track_width_m)
            pose = rk4(f_with_drift, pose, omega, ca.vertcat(nu, traction, yaw_drift_radpm), h)
            pose = pose + ca.vertcat(0, 0, h * bump_sigma_radps * bumps)
            tracks = tracks + h / _MOTOR_LAG_S * (limited - tracks)
        around_m = rotation_centre_m * (heading - _heading(pose))
        # The yaws of the substeps are near each other: fewer sines, the same up to rounding.
        (pose,) = sines_by_addition([pose + ca.vertcat(around_m, 0)])
        encoders = ca.vertcat(*body_speeds(sum(measured) / SUBSTEPS, track_width_m))
        driven = dict(pose=pose, tracks=tracks, integral=integral, encoders=encoders)
        return driven | dict(rut=rut, running=1)

    return drive


def _heading(pose):
    return ca.vertcat(ca.cos(pose[2]), ca.sin(pose[2]))


def _speed_loop(target, measured, integral, h):
    """The limited command of both PI speed loops, and their integrals after h seconds."""
    command = target + _GAIN_P * (target - measured) + integral
    limited = ca.fmin(ca.fmax(command, -_SPEED_LIMIT_MPS), _SPEED_LIMIT_MPS)
    # The integral stands still while the command is limited, so that it does not wind up.
    is_free = command == limited
    return limited, integral + h * _GAIN_I * (target - measured) * is_free


def body_speeds(tracks, track_width_m):
    """ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b (paper, Sec. System Model)."""
    return (tracks[0] + tracks[1]) / 2, (tracks[1] - tracks[0]) / track_width_m


def init(pose, speed_mps):
    """Memory at the first sample: driving straight at the set speed."""
    return dict(
        pose=np.array(pose),
        tracks=np.full(2, speed_mps),
        integral=np.zeros(2),
        encoders=np.array([speed_mps, 0.0]),
        rut=0.0,
        running=0.0,
    )
