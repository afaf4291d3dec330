"""Names of the columns of every log and table of samples; docs/log_columns.md says more."""

import functools
from itertools import chain

from rhec.tracked_robot import sensors

# Lists, so that log[ESTIMATE] selects these columns.
POSE = ["x_m", "y_m", "theta_rad"]
TRUTH = [*POSE, "nu_mps", "mu", "kappa"]
MEASUREMENTS = ["x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"]
ESTIMATE = ["x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"]
COMMAND = ["omega_cmd_radps"]

# One row of a run's log: the results of a sample of the closed loop, in this order, by column.
LOG = dict(
    truth=TRUTH,
    omega=["omega_radps"],
    yaw_drift=["yaw_drift_radpm"],
    z=MEASUREMENTS,
    estimate=ESTIMATE,
    command=COMMAND,
    s_m=["s_m"],
    curvature=["curvature_radpm"],
    kkt_rhe=["kkt_rhe"],
    kkt_rhc=["kkt_rhc"],
    deviance=["deviance"],
    ok=["ok"],
    accepted=["position_accepted", "encoders_accepted"],
    restart=["restarted"],
)
GATE = ["position_accepted", "encoders_accepted", "restarted"]
FLAGS = ["ok", *GATE]
COLUMNS = list(chain(*LOG.values()))

# Columns that a replay has besides those of a run.
TRUE_SPEEDS = ["v_true_mps", "yaw_rate_true_radps"]
LEVER_ARM = ["arm_forward_hat_m", "arm_left_hat_m"]
SIGMA = [
    "sigma_x_m",
    "sigma_y_m",
    "sigma_theta_rad",
    "sigma_nu_mps",
    "sigma_mu",
    "sigma_kappa",
    "sigma_arm_forward_m",
    "sigma_arm_left_m",
]
# Sensors besides GNSS and encoders: the columns of their measurements, of whether a replay uses
# these, of measured yaws, of all means over a sample, and of what is estimated of the sensors.
SENSORS = {name: sensor.column for name, sensor in sensors.SENSORS.items()}
ACCEPTED = {name: f"{name}_accepted" for name, of in sensors.SENSORS.items() if of.accepts}
YAWS = [of.column for of in sensors.SENSORS.values() if of.measures == sensors.YAW]
MEANS = [*MEASUREMENTS[2:], *(of.column for of in sensors.SENSORS.values() if of.is_mean)]
HATS_OF_SENSORS = {unknown.name: unknown.hat for unknown in sensors.UNKNOWNS}
SIGMAS_OF_SENSORS = {unknown.name: unknown.sigma_column for unknown in sensors.UNKNOWNS}
# The estimated yaw drift, of estimators that have it.
YAW_DRIFT_HAT = "yaw_drift_hat_radpm"
SIGMA_YAW_DRIFT = "sigma_yaw_drift_radpm"
INNOVATION = ["innovation_x_m", "innovation_y_m"]


def measured_of(sensors):
    """Columns of the measurements of a robot with these sensors, in the order of z."""
    return [*MEASUREMENTS, *(SENSORS[name] for name in sensors)]


@functools.cache
def of_run(sensors, has_yaw_drift):
    """Columns of a run's log: COLUMNS, those of its `sensors`, and an estimated yaw drift."""
    of_sensors = measured_of(sensors)[len(MEASUREMENTS) :]
    return [*COLUMNS, *of_sensors, *([YAW_DRIFT_HAT] if has_yaw_drift else [])]


# Columns of a recording, by their names in a run or a replay.
TRACKS = ["v_left_mps", "v_right_mps"]
RECORDED = dict(zip(MEASUREMENTS, ("x_m", "y_m", "speed_mps", "yaw_rate_radps")))
RECORDED_SENSORS = {of.column: of.recorded_column for of in sensors.SENSORS.values()}
RECORDED_TRUTH = dict(zip(POSE, ("x_true_m", "y_true_m", "yaw_true_rad"))) | {
    name: name for name in TRUE_SPEEDS
}
