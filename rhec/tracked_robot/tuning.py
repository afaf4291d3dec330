"""Every tuned process noise W in one place, with its source: standard deviations per sample.

"printed" is the paper's, to the letter (interpretations R1, R2). "calibrated" maximises the
likelihood of the innovations on training seeds 1000 to 1009, by `rhec.studies.calibration`; the
others say what they were tuned for.
"""

from rhec import paper

__all__ = [
    "SHARES_SLIPPING", "SIGMA_BUMPS", "SIGMA_SIDE_SLIP_AT_REST", "SIGMA_W", "SIGMA_W_FILTERED",
    "SIGMA_W_SLIPPING", "SIGMA_W_TRACKING"
]  # fmt: skip


def _not_the_papers(calibrated):
    """W of an estimator for which the paper prints none: by likelihood, whatever is asked for."""
    return dict(printed=calibrated, calibrated=calibrated)


# Of (x, y, θ, ν, μ, κ), or of (x, y, θ, ν) where the traction is not estimated. Where the paper has
# such an estimator but for the bounds, or but for what is estimated, printed is its W.
SIGMA_W = {
    "rhe": {
        "printed": paper.SIGMA_W_RHE,
        "calibrated": (0.001, 0.001, 0.001, 0.001, 0.0034, 0.001),
    },
    "rhe_fixed_traction": {
        "printed": paper.SIGMA_W_RHE[:4],
        "calibrated": (0.001, 0.001, 0.001, 0.0015),
    },
    "rhe_no_slip": {"printed": paper.SIGMA_W_RHE[:4], "calibrated": (0.001, 0.001, 0.01, 0.001)},
    "ekf": {"printed": paper.SIGMA_W_EKF, "calibrated": (0.017, 0.017, 0.013, 0.001)},
    "augmented_ekf": {
        "printed": paper.SIGMA_W_RHE,
        "calibrated": (0.001, 0.001, 0.005, 0.001, 0.0058, 0.0057),
    },
    "bounded_ekf": {
        "printed": paper.SIGMA_W_RHE,
        "calibrated": (0.001, 0.001, 0.005, 0.001, 0.0058, 0.0057),
    },
    "fixed_traction": _not_the_papers((0.0073, 0.0073, 0.0052, 0.0018)),
    "traction_oracle": _not_the_papers((0.001, 0.001, 0.0049, 0.001)),
}
# The RHE whose arrival cost takes the filter's own mean: by likelihood, like "calibrated"
# (`calibrate("rhe", arrival_mean="filtered")`).
SIGMA_W_FILTERED = (0.001, 0.001, 0.005, 0.001, 0.0097, 0.0091)
# Least true error of robots that drive training seeds 1000 to 1023 by the estimator, by
# `rhec.studies.calibration`. Dual estimation: the RHE's six, then the EKF's four.
SIGMA_W_TRACKING = {
    "rhe": (0.02, 0.02, 0.0017, 0.0022, 0.036, 0.021),
    "ekf": (0.001, 0.001, 0.033, 10.0),
    "augmented_ekf": (0.001, 0.001, 0.0079, 0.0042, 0.0077, 0.016),
    "bounded_ekf": (0.001, 0.001, 0.014, 0.023, 0.011, 0.053),
    "fixed_traction": (0.001, 0.001, 0.031, 0.0068),
    "traction_oracle": (0.001, 0.001, 0.024, 0.045),
    "dual": (0.001, 0.001, 0.001, 0.001, 0.0053, 0.025, 0.0058, 0.0058, 0.028, 0.0054),
}
# Tracks that slip: found on two recorded skid-steered robots, a wheeled and a tracked one. Noise
# grows with the motion: of (μ, κ) with the distance d that the tracks ran, like √d [1/√m]; of ν,
# ω and bω (the side slip speed) by shares of themselves; bumps turn the robot, like √d [rad/√m].
SIGMA_W_SLIPPING = (0.01, 0.015)
SHARES_SLIPPING = (0.1, 0.25, 0.08)
SIGMA_BUMPS = 0.02
SIGMA_SIDE_SLIP_AT_REST = 1e-3  # [m/s]
