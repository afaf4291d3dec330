"""The simulated robot (paper, Sec. System Description): two tracks with a speed loop each,
encoders, RTK GNSS, bumps, on slipping soil.

It stands in for the field: what the paper's Kangaroo x2 does (50 Hz speed control from the
encoders), what its sensors report at 5 Hz, and the soil, which turns track speeds into motion by
eq. (2).
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function, packed_size
from rhec.core._casadi.sines import sines_by_addition
from rhec.tracked_robot.kinematics import f, rk4

__all__ = [
    "BODY",
    "MEMORY",
    "NOISE",
    "SENSORS",
    "SUBSTEPS",
    "body_speeds",
    "draw_noise",
    "drive",
    "init",
    "measure",
]

SUBSTEPS = round(paper.SPEED_LOOP_RATE_HZ / paper.GNSS_RATE_HZ)
_MOTOR_LAG_S = 0.1  # first-order lag from motor command to track speed
# the speed loop: from a standstill it settles in about half a second
_GAIN_P = 1.0
GAIN_I = 10.0
_SPEED_LIMIT_MPS = 1.5  # of a track: saturation of the motor driver

MEMORY = dict(pose=(3, 1), tracks=(2, 1), integral=(2, 1), drift=(2, 1), encoders=(2, 1))
# Standard normal, one sample.
NOISE = dict(white=(2, 1), slow=(2, 1), bump=(1, 1), encoder=(2, SUBSTEPS), speed=(1, 1))
SENSORS = dict.fromkeys(
    ("gnss_white_m", "gnss_slow_m", "gnss_slow_time_s", "speed_sigma_mps"), (1, 1)
)
BODY = dict(track_width_m=(1, 1), encoder_sigma_mps=(1, 1), bump_sigma_radps=(1, 1))


def draw_noise(seed, samples):
    """Standard normal noise (samples, n) of a seed; the first rows are those of fewer samples. The
    speed's, the last, is a stream of its own: without it, all else is the same.
    """

    def stream(number, n):
        bits = np.random.Philox(np.random.SeedSequence((seed, number)))
        return np.random.Generator(bits).standard_normal((samples, n))

    return np.hstack([stream(1, packed_size(NOISE) - 1), stream(4, 1)])


def measure(dt_s):
    """(pose, drift, encoders, noise) -> (z, drift): GNSS position with a white and a slowly varying
    error, and the encoders' last means, the speed with an error that both tracks share.

    The slow error is a first-order Gauss-Markov process of standard deviation gnss_slow_m and time
    constant gnss_slow_time_s (interpretation R4). Independent errors of two tracks make the yaw
    rate as noisy as the paper's, but the speed 18 times less: that is what speed_sigma_mps is for.
    """

    pieces = {name: MEMORY[name] for name in ("pose", "drift", "encoders")}
    noise = {name: NOISE[name] for name in ("white", "slow", "speed")}

    @casadi_function("measure", **pieces, **noise, **SENSORS)
    def measure(
        pose,
        drift,
        encoders,
        white,
        slow,
        speed,
        gnss_white_m,
        gnss_slow_m,
        gnss_slow_time_s,
        speed_sigma_mps,
    ):
        keep = ca.exp(-dt_s / gnss_slow_time_s)
        position = pose[:2] + gnss_white_m * white + gnss_slow_m * drift
        z = ca.vertcat(position, encoders[0] + speed_sigma_mps * speed, encoders[1])
        return dict(z=z, drift=keep * drift + ca.sqrt(1 - keep**2) * slow)

    return measure


def drive(dt_s):
    """One sample on soil of traction (2,): track speeds follow (speed_mps, omega_radps) at 50 Hz,
    the soil moves the robot.

    encoders are the means of ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b over the sample, as read. A
    bump turns the robot for one sample.
    """

    pieces = {name: MEMORY[name] for name in ("pose", "tracks", "integral")}
    noise = {name: NOISE[name] for name in ("bump", "encoder")}
    command = dict(speed_mps=(1, 1), omega_radps=(1, 1), traction=(2, 1))

    @casadi_function("drive", **pieces, **command, **noise, **BODY)
    def drive(
        pose,
        tracks,
        integral,
        speed_mps,
        omega_radps,
        traction,
        bump,
        encoder,
        track_width_m,
        encoder_sigma_mps,
        bump_sigma_radps,
    ):
        half = track_width_m / 2
        target = ca.vertcat(speed_mps - half * omega_radps, speed_mps + half * omega_radps)
        h = dt_s / SUBSTEPS
        readings = []
        for i in range(SUBSTEPS):
            reading = tracks + encoder_sigma_mps * encoder[:, i]
            readings.append(reading)
            command = target + _GAIN_P * (target - reading) + integral
            limited = ca.fmin(ca.fmax(command, -_SPEED_LIMIT_MPS), _SPEED_LIMIT_MPS)
            no_wind_up = command == limited
            integral = integral + h * GAIN_I * (target - reading) * no_wind_up
            nu, omega = body_speeds(tracks, track_width_m)
            pose = rk4(f, pose, omega, ca.vertcat(nu, traction), h)
            pose = pose + ca.vertcat(0, 0, h * bump_sigma_radps * bump)
            tracks = tracks + h / _MOTOR_LAG_S * (limited - tracks)
        (pose,) = sines_by_addition([pose])
        encoders = ca.vertcat(*body_speeds(sum(readings) / SUBSTEPS, track_width_m))
        return dict(pose=pose, tracks=tracks, integral=integral, encoders=encoders)

    return drive


def body_speeds(tracks, track_width_m):
    """ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b (paper, Sec. System Model)."""
    return (tracks[0] + tracks[1]) / 2, (tracks[1] - tracks[0]) / track_width_m


def init(pose, speed_mps):
    """Memory at the first sample: driving straight at the set speed."""
    return dict(
        pose=np.array(pose), tracks=np.full(2, speed_mps), integral=np.zeros(2), drift=np.zeros(2),
        encoders=np.array([speed_mps, 0.0]),
    )  # fmt: skip
