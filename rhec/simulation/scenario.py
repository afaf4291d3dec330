"""A scenario: every choice behind one closed-loop run, validated (docs/interpretations.md)."""

from typing import Annotated, Any, Literal

import casadi as ca
from pydantic import Field

from rhec import paper
from rhec.core._casadi import validation as valid
from rhec.extensions.faults import Fault
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import NAMES, ROBUST_NAMES, estimator_of
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.terrain import Patch, Seed, Terrain

__all__ = ["Scenario"]


@valid.validated
class Scenario:
    """One closed-loop run. SI units; angles in radians.

    The estimator
        estimator          "rhe", "ekf": the paper's; "oracle" (true pose and traction); not in
                           the paper: "augmented_ekf" (μ, κ are states, too), "bounded_ekf" (the
                           same, kept within [0, 1]); told the traction: "traction_oracle" (an EKF,
                           the true one), "fixed_traction" (an EKF, the field's mean),
                           "rhe_fixed_traction" (an RHE, the same), "rhe_no_slip" (an RHE, μ = κ =
                           1); "dual" (traction by the RHE, pose by an EKF that is told it); or a
                           CasADi Function (memory, z) -> (memory, estimate) of one's own, whose
                           memory starts as the first guess (x, y, θ, ν, μ, κ), then zeros
        process_noise      "printed": the paper's W; "calibrated": by likelihood (R1, R2); of an RHE
                           "consistent": as sure as it may be; it sets sigma_v, arrival_mean if None
        sigma_w            W's standard deviations instead: (x, y, θ, ν, μ, κ), without (μ, κ)
                           where they are not estimated, without ν where that is an input, (μ, κ)
                           per √m where tracks slip; the RHE's, then the EKF's for "dual"
        sigma_v            measurement noise the estimator assumes: (x, y [m], ν [m/s], ω [rad/s])
        estimation_horizon intervals of the window; N intervals have N + 1 nodes, so 14 is the
                           paper's sum of N terms (R5)
        speed_model        "parameter": one ν over the window, as in the paper; "input": one ν an
                           interval, from the encoders (R6, R13); "slipping": the same, with process
                           noise in proportion to how far the tracks ran, sideways, too: not in the
                           paper
        slip               where tracks slip: the numbers that stand in `tuning.SLIP`, in that order
        arrival_mean       "smoothed": prior mean from the previous RHE solution, as in the paper;
                           "filtered": from the EKF update itself (R7); None: that of process_noise
        robust             trust contradicted measurements less (`rhec.tracked_robot.robust`)
    The controller
        q, r, qn_factor    weights Q_k (x, y, θ), R, and Q_N = qn_factor · Q_k
        omega_max_radps    bound on the commanded yaw rate
        prediction_horizon intervals of the prediction
        look_ahead_m       the desired points begin this far beyond the closest point
        input_reference    "measured": the measured yaw rate held, as in the paper; "curvature":
                           what the path asks for (R8)
        command_delay      0: the command computed at t_k is applied at once; 1: one sample later
                           (R10)
        qp                 "structured": by Riccati recursion, the fastest at every horizon; or the
                           condensed QP by "daqp" or "qpoases" (the paper's; on the virtual machine)
        cautious           slow down where the estimate is unsure, or a curve asks for more yaw rate
                           than the soil gives (`rhec.extensions.cautious`), by that many standard
        caution            deviations of the estimate
    The drive
        speed_mps, duration_s, backwards   set speed, length of the run, λ = 1 of eq. (18)
                                           (R3, R9)
        path               a rhec.Path; else two rows of row_length_m joined by half circles of
                           headland_radius_m
        start_offset_m, start_yaw_rad      where the robot starts, left of the path's beginning and
                                           turned from it (R3)
        guess_yaw_rad      error of the estimator's first guess of the yaw
    The field
        terrain            a rhec.Terrain; else random fields from seed with these statistics:
        mu_mean, mu_deviation, kappa_mean, kappa_deviation, correlation_length_m
        patches            ((x_m, y_m, radius_m, mu, kappa), …): discs of sudden change
    The sensors and the ground
        gnss_sigma_m       standard deviation of the position error, of which the share
                           gnss_slow_share (of the variance) varies slowly, with time constant
                           gnss_slow_time_s (R4)
        encoder_sigma_mps  of one track at 50 Hz; speed_sigma_mps: of the speed as read at 5 Hz
        bump_sigma_radps   yaw rate a bump adds for one sample
        track_width_m      b
        faults             (rhec.Fault, …): what is wrong with the sensors, and when
        seed               fixes terrain and noise together
    """

    estimator: Any = "rhe"
    process_noise: valid.ProcessNoise = "printed"
    sigma_w: tuple[valid.NotNegative, ...] | None = None
    sigma_v: valid.SigmaV | None = None
    estimation_horizon: valid.Intervals = paper.HORIZON
    speed_model: valid.SpeedModel = "parameter"
    slip: valid.Slip | None = None
    arrival_mean: valid.ArrivalMean | None = None
    robust: valid.Flag = False

    q: valid.Weights = paper.Q3
    r: valid.Positive = paper.R
    qn_factor: valid.NotNegative = paper.QN_FACTOR
    omega_max_radps: valid.Positive = paper.OMEGA_MAX_RADPS
    prediction_horizon: valid.Intervals = paper.HORIZON
    look_ahead_m: valid.NotNegative = 0.0
    input_reference: Literal["measured", "curvature"] = "measured"
    command_delay: Literal[0, 1] = 0
    qp: valid.Solver = "structured"
    cautious: valid.Flag = False
    caution: valid.NotNegative = 0.25

    speed_mps: Annotated[valid.Positive, Field(le=1.4)] = paper.SPEED_MPS
    duration_s: Annotated[valid.Positive, Field(ge=paper.DT_S, le=1e6)] = 240.0
    backwards: valid.Flag = False
    path: Any = None
    row_length_m: Annotated[valid.Positive, Field(le=1e4)] = paper.ROW_LENGTH_M
    headland_radius_m: Annotated[valid.Positive, Field(ge=1e-3, le=1e3)] = paper.HEADLAND_RADIUS_M
    start_offset_m: valid.Real = paper.START_OFFSET_M
    start_yaw_rad: valid.Real = 0.0
    guess_yaw_rad: valid.Real = 0.0

    terrain: Any = None
    mu_mean: valid.Traction = 0.9
    mu_deviation: valid.NotNegative = 0.04
    kappa_mean: valid.Traction = 0.8
    kappa_deviation: valid.NotNegative = 0.08
    correlation_length_m: Annotated[valid.Positive, Field(ge=0.5)] = 4.0
    patches: tuple[Patch, ...] = ()

    gnss_sigma_m: valid.NotNegative = paper.SIGMA_V[0]
    gnss_slow_share: Annotated[valid.NotNegative, Field(le=1)] = 0.0
    gnss_slow_time_s: valid.Positive = 60.0
    encoder_sigma_mps: valid.NotNegative = paper.ENCODER_SIGMA_MPS
    speed_sigma_mps: valid.NotNegative = paper.SIGMA_V[2]
    bump_sigma_radps: valid.NotNegative = 0.02
    track_width_m: valid.Positive = paper.TRACK_WIDTH_M
    faults: tuple[Fault, ...] = ()
    seed: Seed = 0

    def __post_init__(self):
        estimator = self.estimator
        own = isinstance(self.estimator, ca.Function)
        if not own and not (isinstance(estimator, str) and estimator in NAMES):
            wanted = f"it should be one of {NAMES} or a CasADi Function"
            raise ValueError(f"estimator was {valid.shown(estimator)}; {wanted}")
        for name, kind in (("path", Path), ("terrain", Terrain)):
            value = getattr(self, name)
            if not isinstance(value, kind | None):
                wanted = f"it should be a rhec.{kind.__name__} or None"
                raise ValueError(f"{name} was {valid.shown(value)}; {wanted}")
        for name in ("mu", "kappa"):
            mean = getattr(self, f"{name}_mean")
            deviation = getattr(self, f"{name}_deviation")
            most = (mean * (1 - mean)) ** 0.5
            if deviation and deviation >= most:
                wanted = f"with {name}_mean {mean} it should be below {most:.3g}"
                limit = "the most a quantity between 0 and 1 can vary"
                raise ValueError(f"{name}_deviation was {deviation!r}; {wanted}, {limit}")
        if self.robust and (own or estimator not in ROBUST_NAMES):
            wanted = f"for the estimator {valid.shown(estimator)} it should be False"
            raise ValueError(f"robust was True; {wanted}")
        expected = estimator_of("own" if own else estimator).n_sigma_w(Choice.of(self))
        if self.sigma_w is not None and len(self.sigma_w) != expected:
            wanted = f"for the estimator {valid.shown(estimator)} it should have {expected} entries"
            raise ValueError(f"sigma_w was {valid.shown(self.sigma_w)}; {wanted}")
