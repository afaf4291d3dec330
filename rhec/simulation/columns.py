"""Columns of every log and table of samples, with their units: SI, angles in radians, yaw
counter-clockwise and unwrapped, NaN where nothing is known.

A run (`rhec.Run.log`, one row a sample) has
    t_s                              time of the measurement [s]
  truth, which no estimator sees
    x_m, y_m, theta_rad              pose of the robot [m, m, rad]
    nu_mps, omega_radps              speed and yaw rate of the tracks [m/s, rad/s]; over ground the
                                     robot moves with mu * nu and kappa * omega
    mu, kappa                        traction coefficients, between 0 and 1
  measurements z
    x_meas_m, y_meas_m               GNSS position [m]
    nu_meas_mps, omega_meas_radps    by the encoders, means since the last sample [m/s, rad/s]
  estimates
    x_hat_m, y_hat_m, theta_hat_rad, nu_hat_mps, mu_hat, kappa_hat
  control
    omega_cmd_radps                  commanded yaw rate [rad/s]
    s_m, curvature_radpm             arc length and curvature of the path at its closest point to
                                     the estimate [m, rad/m]; with a look-ahead, so far beyond it
    on_straight                      whether the path is straight at its closest point to the robot
    error_m                          distance of the measured position from the path, as in the
                                     paper [m]
    error_true_m                     distance of the robot from the path [m]
  solvers
    kkt_rhe, kkt_rhc                 KKT tolerances
    deviance                         -2 log likelihood of the measurement, up to a constant
    ok                               whether RHE and RHC solved their QPs
    position_accepted, encoders_accepted
                                     whether the measurement was used: False where it was missing
                                     or, with robust=True, rejected
    restarted                        with robust=True: whether the estimator restarted

A recording (the log of a real robot, which `rhec.replay` takes) has
    t_s                              time [s], rows at most 0.2 s apart
    x_m, y_m                         measured position of the antenna [m]
    speed_mps, yaw_rate_radps        by the encoders at that instant, not corrected for slip; or, of
    v_left_mps, v_right_mps          each track [m/s], together with a track_width_m
  and may have
    segment                          the robot was never driven through where this changes
    pos_ok, encoders_ok              0 or False where that measurement is to be ignored
    x_true_m, y_true_m, yaw_true_rad, v_true_mps, yaw_rate_true_radps
                                     the truth, over ground; no estimator sees it
Other columns are ignored.

A replay (`rhec.replay`) returns `segment`, `t_s`, measurements, estimates, `deviance`, `kkt_rhe`,
`ok` and the truth that is known (x_m, y_m, theta_rad, v_true_mps, yaw_rate_true_radps, and mu,
kappa of a simulated log) under the names above, and
    arm_forward_hat_m, arm_left_hat_m      estimated place of the antenna [m]
    sigma_x_m, sigma_y_m, sigma_theta_rad, sigma_nu_mps, sigma_mu, sigma_kappa,
    sigma_arm_forward_m, sigma_arm_left_m  standard deviations of the estimates
    x_meas_m_age_s, y_meas_m_age_s         how old the position was when it was used [s]
    innovation_x_m, innovation_y_m         measured position less the predicted one [m]
    lost                                   whether the estimate is lost, by innovations and bounds
    position_accepted, encoders_accepted, restarted
                                           as above, False in rows between the estimator's samples
A replay with a Model returns `segment`, `t_s`, the measurements under the names of its outputs, and
    <name>_hat                             estimate of each state, input and parameter
    <name>_sigma                           standard deviation of that of each state and parameter
    <name>_age_s                           how old an output was when it was used [s]
    ok                                     whether the estimator solved its QP
"""

from itertools import chain

__all__ = [
    "AGE",
    "COLUMNS",
    "COMMAND",
    "ESTIMATE",
    "FLAGS",
    "GATE",
    "INNOVATION",
    "LEVER_ARM",
    "LOG",
    "MEASUREMENTS",
    "POSE",
    "RECORDED",
    "RECORDED_TRUTH",
    "SIGMA",
    "TRACKS",
    "TRUE_SPEEDS",
    "TRUTH",
]

# Lists, so that log[ESTIMATE] selects these columns.
POSE = ["x_m", "y_m", "theta_rad"]
TRUTH = [*POSE, "nu_mps", "mu", "kappa"]
MEASUREMENTS = ["x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"]
ESTIMATE = ["x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"]
COMMAND = ["omega_cmd_radps"]

# One row of a run's log: results of a sample of the closed loop, in order, and their columns
LOG = dict(
    truth=TRUTH,
    omega=["omega_radps"],
    z=MEASUREMENTS,
    estimate=ESTIMATE,
    command=COMMAND,
    s=["s_m"],
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

# A replay has besides
TRUE_SPEEDS = ["v_true_mps", "yaw_rate_true_radps"]
LEVER_ARM = ["arm_forward_hat_m", "arm_left_hat_m"]
SIGMA = ["sigma_x_m", "sigma_y_m", "sigma_theta_rad", "sigma_nu_mps", "sigma_mu", "sigma_kappa"]
SIGMA += ["sigma_arm_forward_m", "sigma_arm_left_m"]
AGE = ["x_meas_m_age_s", "y_meas_m_age_s"]
INNOVATION = ["innovation_x_m", "innovation_y_m"]

# Columns of a recording, by what they are called in a run or a replay
TRACKS = ["v_left_mps", "v_right_mps"]
RECORDED = dict(zip(MEASUREMENTS, ("x_m", "y_m", "speed_mps", "yaw_rate_radps")))
RECORDED_TRUTH = dict(zip(POSE, ("x_true_m", "y_true_m", "yaw_true_rad")))
RECORDED_TRUTH |= {name: name for name in TRUE_SPEEDS}
