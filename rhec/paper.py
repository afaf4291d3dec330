"""The paper's constants and reported results, each with its place. SI units; angles in radians.

Where the paper gives no number, the value is this project's choice and stands under "Not in the
paper" (interpretations G3 and G4).
"""

# Sec. Introduction: the row and the tolerance
ROBOT_WIDTH_M = 0.48
ROW_SPACING_M = 0.78
STEM_WIDTH_M = 0.03
GNSS_ACCURACY_M = 0.03
TOLERANCE_M = 0.12

# Sec. System Description
ROBOT_LENGTH_M = 1.02
ROBOT_MASS_KG = 45.0
GNSS_RATE_HZ = 5.0
ENCODER_ACCURACY_MPS = 0.035
SPEED_LOOP_RATE_HZ = 50.0
DT_S = 1 / GNSS_RATE_HZ

# Sec. Experimental Results: "prediction and estimation horizons are set to 3 seconds"; Table 1's
# text: 15 intervals
HORIZON = 15

# Sec. Implementation of Nonlinear RHE: standard deviations behind H_k = V_k⁻¹ and W, eq. (15)
SIGMA_V = (0.03, 0.03, 0.05, 0.0175)  # x, y [m], ν [m/s], ω [rad/s]
SIGMA_W_RHE = (10.0, 10.0, 0.1, 1.0, 0.25, 0.25)  # x, y [m], θ [rad], ν [m/s], μ, κ, per sample
# Sec. Extended Kalman Filter, eq. (26)
SIGMA_W_EKF = (10.0, 10.0, 0.1, 1.0)  # x, y [m], θ [rad], ν [m/s], per sample

# Sec. Implementation of Nonlinear RHC
OMEGA_MAX_RADPS = 0.1  # eq. (16): 5.73 °/s
Q1 = (1.0, 1.0, 10.0)
Q2 = (1.0, 1.0, 0.0)
Q3 = (1.0, 1.0, 1.0)
R = 10.0  # eq. (22)
QN_FACTOR = 10.0

# Sec. Experimental Results: what the paper reports
MEAN_ERROR_RHE_M = 0.0423
MEAN_ERROR_EKF_M = 0.0514
VIOLATIONS_RHE = 0
VIOLATIONS_EKF = 17
TABLE_1_MS = {  # minimum, average, maximum on a Raspberry Pi 3
    ("RHE", "preparation"): (0.2921, 0.3523, 1.0075),
    ("RHE", "feedback"): (0.0766, 0.1309, 0.4925),
    ("RHE", "overall"): (0.3687, 0.4832, 1.5000),
    ("RHC", "preparation"): (0.2725, 0.3751, 1.2077),
    ("RHC", "feedback"): (0.0149, 0.0215, 0.1457),
    ("RHC", "overall"): (0.2874, 0.3966, 1.3534),
}
STEP_MEAN_MS = 0.88
STEP_MAX_MS = 2.8534

# Not in the paper
TRACK_WIDTH_M = 0.40  # b: 0.48 m outside, tracks of about 0.08 m
SPEED_MPS = 0.5  # G3: chosen since Scenario A looks here as the paper describes it
ROW_LENGTH_M = 30.0
HEADLAND_RADIUS_M = 10 * ROW_SPACING_M  # into the 20th row over: 70 % of the yaw rate bound
START_OFFSET_M = 1.0  # "starts off-track"
ENCODER_SIGMA_MPS = ENCODER_ACCURACY_MPS / 2  # as a 95 % bound of one 50 Hz measurement

__all__ = [name for name in dir() if name.isupper()]
