"""Every tuned process noise W in one place, with its source: standard deviations per sample.

"printed" is the paper's, to the letter (interpretations R1, R2). "calibrated" maximises the
likelihood of the innovations on training seeds 1000 to 1009, by `rhec.workbench.studies.calibration`.
"consistent" is by `rhec.workbench.studies.consistency`, on training seeds, too: the least true error among
RHEs that are as sure as they may be. The others say what they were tuned for.
"""

from rhec import paper

__all__ = [
    "ARRIVAL_MEAN",
    "SIGMA_SIDE_SLIP_AT_REST",
    "SIGMA_V",
    "SIGMA_W",
    "SIGMA_W_FILTERED",
    "SIGMA_W_SLIPPING",
    "SIGMA_W_TRACKING",
    "SLIP",
    "sigma_v_of",
]


def _not_the_papers(calibrated):
    """W of an estimator for which the paper prints none: by likelihood, whatever is asked for."""
    return dict(printed=calibrated, calibrated=calibrated)


# Of (x, y, θ, ν, μ, κ), or of (x, y, θ, ν) where the traction is not estimated. Where the paper has
# such an estimator but for the bounds, or but for what is estimated, printed is its W.
SIGMA_W = {
    "rhe": {
        "printed": paper.SIGMA_W_RHE,
        "calibrated": (0.001, 0.001, 0.001, 0.001, 0.0033, 0.001),
        "consistent": (0.075, 0.075, 0.001, 0.001, 0.017, 0.0079),
    },
    "rhe_fixed_traction": {
        "printed": paper.SIGMA_W_RHE[:4],
        "calibrated": (0.001, 0.001, 0.001, 0.0012),
    },
    "rhe_no_slip": {"printed": paper.SIGMA_W_RHE[:4], "calibrated": (0.001, 0.001, 0.01, 0.001)},
    "ekf": {"printed": paper.SIGMA_W_EKF, "calibrated": (0.017, 0.017, 0.013, 0.001)},
    "augmented_ekf": {
        "printed": paper.SIGMA_W_RHE,
        "calibrated": (0.001, 0.001, 0.0051, 0.001, 0.0059, 0.0049),
    },
    "bounded_ekf": {
        "printed": paper.SIGMA_W_RHE,
        "calibrated": (0.001, 0.001, 0.0051, 0.001, 0.0059, 0.0052),
    },
    "fixed_traction": _not_the_papers((0.0073, 0.0073, 0.0052, 0.0019)),
    "traction_oracle": _not_the_papers((0.001, 0.001, 0.0048, 0.001)),
}
# What goes with them: measurement noise, and the arrival cost's mean (interpretation R7). An RHE
# has process noise inside its window only through its inputs: σ_ω stands for all that turns the
# robot and no encoder measures.
SIGMA_V = dict(
    printed=paper.SIGMA_V, calibrated=paper.SIGMA_V, consistent=(*paper.SIGMA_V[:3], 0.05)
)
ARRIVAL_MEAN = dict(printed="smoothed", calibrated="smoothed", consistent="filtered")
# The RHE whose arrival cost takes the filter's own mean: by likelihood, like "calibrated"
# (`calibrate("rhe", arrival_mean="filtered")`).
SIGMA_W_FILTERED = (0.001, 0.001, 0.0058, 0.001, 0.0098, 0.0062)
# Least true error of robots that drive training seeds 1000 to 1023 by the estimator, by
# `rhec.workbench.studies.calibration`. Dual estimation: the RHE's six, then the EKF's four.
SIGMA_W_TRACKING = {
    "rhe": (0.017, 0.017, 0.0022, 10.0, 0.001, 0.018),
    "ekf": (0.001, 0.001, 0.033, 10.0),
    "rhe_fixed_traction": (10.0, 10.0, 10.0, 10.0),
    "rhe_no_slip": (10.0, 10.0, 10.0, 10.0),
    "augmented_ekf": (0.001, 0.001, 0.01, 0.0036, 0.008, 0.011),
    "bounded_ekf": (0.001, 0.001, 0.014, 0.0088, 0.0081, 0.053),
    "fixed_traction": (0.001, 0.001, 0.031, 0.005),
    "traction_oracle": (0.001, 0.001, 0.024, 0.005),
    "dual": (0.001, 0.001, 0.001, 0.001, 0.0037, 0.033, 0.0052, 0.0052, 0.029, 0.0097),
}
# Tracks that slip: between what `rhec.calibrate` finds for four recorded robots, three wheeled and
# one tracked. Noise grows with the motion: of (μ, κ) with the distance d that the tracks ran, like
# √d [1/√m]; slip over ground, by shares of ν, of ω and, to the side, of bω; bumps turn the robot,
# like √d [rad/√m]. The side slip speed is in the mean -side_slip_s·νω.
SIGMA_W_SLIPPING = (0.006, 0.01)
SLIP = dict(share_nu=0.1, share_omega=0.17, share_side=0.09, sigma_bumps=0.015, side_slip_s=0.05)
SIGMA_SIDE_SLIP_AT_REST = 1e-3  # [m/s]


def sigma_v_of(scenario):
    """Measurement noise that a Scenario's estimator assumes."""
    return scenario.sigma_v or SIGMA_V[scenario.process_noise]
