"""Every tuned process noise W in one place, with its source: standard deviations per sample.

Each is named by the rule that picked it. All but the last were tuned in the default world, with the
arrival mean "filtered", on training seeds that no result uses (`notebooks/studies/calibration.py`):

- "printed" is the paper's, to the letter (interpretations G1, G2).
- "likelihood" maximises the likelihood of the innovations, seeds 1000 to 1009.
- "consistent" has the least true error among those whose covariance matches the errors (NEES ≈ 1),
  same seeds.
- "tracking" has the least true error of a robot that drives with the paper's weights, R = 10, seeds
  1000 to 1023.
- "soft_soil" is as "likelihood" on soil that slips as much as that under recorded robots, which
  they are used on (`calibration.SOFT_SOIL`). There "likelihood" loses its heading.
"""

import numpy as np

from rhec import paper

# Of (x, y, θ, ν, μ, κ) [m, m, rad, m/s, 1, 1], or of the first four where the traction is not
# estimated. The first of an estimator is its default: an RHE has the paper's; a filter that moves
# its position by 10 m a sample to each fix, as printed, loses its heading.
SIGMA_W = {
    "rhe": {
        "printed": paper.SIGMA_W_RHE,
        "likelihood": (0.001, 0.001, 0.015, 0.001, 0.001, 0.001),
        "consistent": (0.0065, 0.0065, 0.0028, 0.22, 0.001, 0.0014),
        "tracking": (0.0033, 0.0033, 0.011, 0.19, 0.039, 0.12),
        "soft_soil": (0.001, 0.001, 0.0065, 0.001, 0.0098, 0.0053),
    },
    "rhe_fixed_traction": {
        "printed": paper.SIGMA_W_RHE[:4],
        "likelihood": (0.001, 0.001, 0.019, 0.001),
    },
    "rhe_no_slip": {"printed": paper.SIGMA_W_RHE[:4], "likelihood": (0.001, 0.001, 0.018, 0.001)},
    "ekf": {
        "likelihood": (0.001, 0.001, 0.0072, 0.001),
        "printed": paper.SIGMA_W_EKF,
        "consistent": (0.0045, 0.0045, 0.0072, 0.0047),
        "tracking": (0.0013, 0.0013, 0.18, 0.0041),
        "soft_soil": (0.017, 0.017, 0.013, 0.001),
    },
    "augmented_ekf": {
        "likelihood": (0.001, 0.001, 0.0071, 0.001, 0.001, 0.0027),
        "printed": paper.SIGMA_W_RHE,
        "soft_soil": (0.001, 0.001, 0.0054, 0.001, 0.0058, 0.0044),
    },
    "bounded_ekf": {
        "likelihood": (0.001, 0.001, 0.007, 0.001, 0.001, 0.001),
        "printed": paper.SIGMA_W_RHE,
        "tracking": (0.0057, 0.0057, 0.28, 0.018, 0.15, 0.052),
    },
    "fixed_traction": {"likelihood": (0.001, 0.001, 0.0075, 0.001)},
    "traction_oracle": {"likelihood": (0.001, 0.001, 0.0075, 0.001)},
    "drift_oracle": {"likelihood": (0.001, 0.001, 0.0053, 0.001)},
    # With the yaw drift [rad/m] as one more state.
    "yaw_drift_ekf": {"likelihood": (0.001, 0.001, 0.0034, 0.001, 0.001, 0.001, 0.0021)},
}
# Measurement noise of (x, y, ν, ω) [m, m, m/s, rad/s]. Inside its window an RHE has process noise
# only through its inputs. So the rules that look at errors tune σ_ω along with the RHE's W: it then
# includes all turning that no encoder measures. The filters do not use σ_ω.
SIGMA_V = dict(
    printed=paper.SIGMA_V,
    likelihood=paper.SIGMA_V,
    consistent=(*paper.SIGMA_V[:3], 0.039),
    tracking=(*paper.SIGMA_V[:3], 1.0),
    soft_soil=paper.SIGMA_V,
)
# The speed model "slipping". Source: in the middle of what `rhec.calibrate` finds for four recorded
# robots, three wheeled and one tracked. The noise grows with the motion of the tracks.
# Of (μ, κ), with the distance d that the tracks ran, as √d [1/√m].
SIGMA_W_SLIPPING = (0.006, 0.01)
SLIP = dict(
    # Standard deviation of the slip speed ahead, as a share of ν [1].
    share_nu=0.1,
    # Standard deviation of the slip in turning, as a share of ω [1].
    share_omega=0.17,
    # Standard deviation of the slip speed to the side, as a share of bω [1].
    share_side=0.09,
    # Standard deviation of the yaw from bumps, growing as √d [rad/√m].
    sigma_bumps=0.015,
    # The mean slip speed to the side is -side_slip_s·νω [s].
    side_slip_s=0.05,
)
# Gyro and heading (`rhec.tracked_robot.sensors`).
SIGMA_GYRO = 0.02  # [rad/s]
SIGMA_HEADING = 0.03  # [rad]
GYRO = dict(
    # Standard deviation of the gyro's error in proportion to the yaw rate of the tracks [1].
    gyro_share=0.05,
    # Random walk of the gyro's bias [rad/s/√s].
    gyro_bias_walk=2e-4,
)
SIGMA_SIDE_SLIP_AT_REST = 1e-3  # [m/s], by choice: keeps the variance above 0


def process_noise_of(scenario):
    """The name of the W of a Scenario: its own, or the default of its estimator."""
    # An oracle and an estimator of the user's have no W.
    of_estimator = SIGMA_W.get(scenario.estimator, SIGMA_W["rhe"])
    return scenario.process_noise or next(iter(of_estimator))


def sigma_v_of(scenario):
    """Standard deviations of the measurements that a Scenario's estimator assumes."""
    return scenario.sigma_v or SIGMA_V[process_noise_of(scenario)]


def sigma_of_sensors(sensors, sigma_gyro, sigma_heading):
    """Standard deviations of the sensors' measurements, in their order as outputs."""
    sigma = dict(gyro=(sigma_gyro or (SIGMA_GYRO,))[0], heading=sigma_heading or SIGMA_HEADING)
    return tuple(sigma[name] for name in sigma if name in sensors)


def gyro_constants(sensors, sigma_gyro):
    """The constants of the gyro's noise that are not the default ones, by name."""
    if "gyro" not in sensors or sigma_gyro is None:
        return {}
    return dict(gyro_share=sigma_gyro[1])


def variances_of(name, scenario):
    """The settings V and W of a Scenario's estimator, by its name."""
    sigma_w = scenario.sigma_w
    if sigma_w is None:
        sigma_w = SIGMA_W[name][process_noise_of(scenario)]
    return dict(V=np.square(sigma_v_of(scenario)), W=np.square(sigma_w))
