"""The simulated robot (paper, Sec. System Description): two tracks with a speed loop each,
encoders, RTK GNSS and bumps, on slipping soil.

It stands in for the field: the 50 Hz speed control of the paper's Kangaroo x2, the sensors at 5 Hz,
and the soil, which turns track speeds into motion by eq. (2).
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function, packed_size
from rhec.core._casadi.sines import sines_by_addition
from rhec.core.model.base import rk4
from rhec.tracked_robot.kinematics import f

SUBSTEPS = round(paper.SPEED_LOOP_RATE_HZ / paper.GNSS_RATE_HZ)
_MOTOR_LAG_S = 0.1  # first-order lag from motor command to track speed
# With these gains a standing track takes about half a second to the commanded speed.
_GAIN_P = 1.0
_GAIN_I = 10.0
_SPEED_LIMIT_MPS = 1.5  # of a track: saturation of the motor driver

# Shapes by name: what one sample hands to the next, and the standard normal noise of one sample.
MEMORY = dict(pose=(3, 1), tracks=(2, 1), integral=(2, 1), drift=(2, 1), encoders=(2, 1))
NOISE = dict(white=(2, 1), slow=(2, 1), bump=(1, 1), encoder=(2, SUBSTEPS), speed=(1, 1))
# Where a measured ω belongs to the interval that begins at its sample: it waits for that one's end.
PAIRED = dict(newest_omega=(1, 1))
# Settings of the sensors and of the robot's body.
SENSORS = dict.fromkeys(
    ("gnss_white_m", "gnss_slow_m", "gnss_slow_time_s", "speed_sigma_mps"), (1, 1)
)
BODY = dict(track_width_m=(1, 1), encoder_sigma_mps=(1, 1), bump_sigma_radps=(1, 1))

# Random streams of a seed; others belong to the faults.
_STREAM_OF_ALL_BUT_SPEED = 1
_STREAM_OF_SPEED = 4


def draw_noise(seed, samples):
    """Standard normal noise of a seed, (samples, n), each row NOISE packed.

    The first rows are those of fewer samples. The noise of the speed comes last and from a separate
    stream, so that all else is the same with and without it.
    """
    n_speed = packed_size({"speed": NOISE["speed"]})
    n_others = packed_size(NOISE) - n_speed
    return np.hstack(
        [
            _normal(seed, _STREAM_OF_ALL_BUT_SPEED, samples, n_others),
            _normal(seed, _STREAM_OF_SPEED, samples, n_speed),
        ]
    )


def _normal(seed, stream, samples, n):
    bits = np.random.Philox(np.random.SeedSequence((seed, stream)))
    return np.random.Generator(bits).standard_normal((samples, n))


def measure(dt_s):
    """The sensors as a Function (pose, drift, encoders, noise, settings) -> (z, drift).

    z is the GNSS position, with a white and a slowly varying error, and the last means of the
    encoders, of which the speed has an error that both tracks share.

    The slow error is a first-order Gauss-Markov process of standard deviation gnss_slow_m and time
    constant T = gnss_slow_time_s: d⁺ = e^{-Δt/T} d + √(1 - e^{-2Δt/T}) w (interpretation R4).
    Independent errors of two tracks would make the yaw rate as noisy as the paper's, but the speed
    18 times less noisy: hence speed_sigma_mps.
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


def pair_with_next_interval():
    """Interpretation R16 as a Function (z, newest_omega) -> (z, newest_omega).

    An estimator takes the ω in z for that of the interval that ends at the sample. With the ω of
    the sample before in its place, the ω measured at t_i belongs to the interval from t_i on, and
    the newest one, `newest_omega`, is not used yet.
    """

    @casadi_function("pair", z=(4, 1), **PAIRED)
    def pair(z, newest_omega):
        return dict(z=ca.vertcat(z[:3], newest_omega), newest_omega=z[3])

    return pair


def drive(dt_s):
    """One sample of driving as a Function.

    The track speeds follow (speed_mps, omega_radps) at 50 Hz by a PI loop with saturation and a
    motor of first order; soil of the traction (2,) turns them into motion, eq. (2). A bump turns
    the robot for one sample. The result `encoders` holds the means of ν = (ν_l + ν_r)/2 and
    ω = (ν_r - ν_l)/b over the sample, as measured.
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
        measured = []
        for i in range(SUBSTEPS):
            measured.append(tracks + encoder_sigma_mps * encoder[:, i])
            limited, integral = _speed_loop(target, measured[-1], integral, h)
            nu, omega = body_speeds(tracks, track_width_m)
            pose = rk4(f, pose, omega, ca.vertcat(nu, traction), h)
            pose = pose + ca.vertcat(0, 0, h * bump_sigma_radps * bump)
            tracks = tracks + h / _MOTOR_LAG_S * (limited - tracks)
        # The yaws of the substeps are near each other: fewer sines, the same up to rounding.
        (pose,) = sines_by_addition([pose])
        encoders = ca.vertcat(*body_speeds(sum(measured) / SUBSTEPS, track_width_m))
        return dict(pose=pose, tracks=tracks, integral=integral, encoders=encoders)

    return drive


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
        drift=np.zeros(2),
        encoders=np.array([speed_mps, 0.0]),
    )
