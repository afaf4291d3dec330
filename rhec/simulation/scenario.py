"""A scenario: every choice behind one closed-loop run, validated (docs/interpretations.md).

The annotation of a parameter says which values it may have, and in a `Doc` what it means, its unit
and its group. `scenario_fields` makes the help of Scenario, and menus, from these.
"""

from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

import casadi as ca
from pydantic import Field as Limits
from pydantic import SkipValidation

from rhec import paper
from rhec.core._casadi import validation as valid
from rhec.core.estimator.rhe import ArrivalMean
from rhec.simulation.controller import Controller, check_fits
from rhec.simulation.faults import Fault, as_python
from rhec.tracked_robot import options, tuning
from rhec.tracked_robot.estimators import NAMES, Choice, EstimatorName, estimator_of
from rhec.tracked_robot.own_estimator import Estimator
from rhec.tracked_robot.path import Path, Turns, path_of
from rhec.tracked_robot.sensors import SENSORS
from rhec.tracked_robot.speed_models import refuse_drift_with
from rhec.tracked_robot.terrain import Patch, Seed, Terrain, box_of

if TYPE_CHECKING:
    import pandas as pd

of_estimator = partial(valid.Doc, group="the estimator")
of_controller = partial(valid.Doc, group="the controller")
of_drive = partial(valid.Doc, group="the drive")
of_soil = partial(valid.Doc, group="the soil")
of_robot = partial(valid.Doc, group="the robot")
of_sensors = partial(valid.Doc, group="the sensors")


@valid.validated
class Scenario:
    # What is no parameter, but is looked for here.
    INSTEAD = dict(world="a world is a set of them, as in Scenario(**rhec.WORLDS['soft'])")

    # Pydantic skips a union with a class of ours; `_check_types` refuses in one sentence.
    estimator: Annotated[
        EstimatorName | Estimator | ca.Function,
        SkipValidation,
        of_estimator("""The paper's "rhe" or "ekf". Not in the paper: "bounded_ekf" (μ and κ are
            states, kept between 0 and 1) and "oracle" (has the true pose and traction). Or
            one's own: a rhec.Estimator, or its CasADi Function (memory, z) -> (memory,
            estimate) alone."""),
    ] = "rhe"
    process_noise: Annotated[
        options.ProcessNoise | None,
        of_estimator("""The rule that picked W, and sigma_v where that is None (G1, G2).
            "printed": the paper's; "consistent": the covariance is as large as the errors on
            training seeds; "prediction": predicts their next measurements best; "tracking": has
            the least true error there with the paper's controller; "soft_soil": as "prediction"
            on soil that slips more, as under recorded robots. None: "prediction" for every
            estimator, the one rule that needs no truth, so that it could have been followed in
            the field."""),
    ] = None
    sigma_w: Annotated[
        tuple[valid.NotNegative, ...] | None,
        of_estimator("""Standard deviations behind W, instead of process_noise: (x, y, θ, ν, μ,
            κ). Without (μ, κ) where they are not estimated, without ν where it is an input; (μ,
            κ) per √m for speed_model "slipping"; with the yaw drift in rad/m last where that is
            estimated."""),
    ] = None
    sigma_v: Annotated[
        options.SigmaV | None,
        of_estimator(
            """Measurement noise that the estimator assumes, standard deviations of (x, y, ν,
            ω).""",
            unit="m, m, m/s, rad/s",
        ),
    ] = None
    estimation_horizon: Annotated[
        valid.Intervals,
        of_estimator("""Intervals of the estimation window. N intervals have N + 1 nodes, so 14
            gives the paper's sum of N = 15 terms (G5)."""),
    ] = paper.HORIZON
    speed_model: Annotated[
        options.SpeedModel,
        of_estimator("""How the RHE models ν. "parameter": one ν over the window, as in the
            paper; "input": one ν an interval, from the encoders (G6, G13); "slipping": the
            same, with process noise that grows with the distance of the tracks, also sideways,
            which is not in the paper."""),
    ] = "parameter"
    slip: Annotated[
        options.Slip | None,
        of_estimator("""Constants of the speed model "slipping", in the order of `tuning.SLIP`."""),
    ] = None
    arrival_mean: Annotated[
        ArrivalMean,
        of_estimator("""Prior mean of the arrival cost of the RHE. "filtered": from the EKF
            update, as in the code of ACADO, the paper's tool; "smoothed": from the previous
            solution, as in its text (G7)."""),
    ] = "filtered"
    yaw_drift: Annotated[
        valid.Flag,
        of_estimator("""Whether an RHE also estimates the yaw drift δ of soil that turns the
            robot without a yaw rate of its tracks, θ' = κω + μνδ, which the controller then
            cancels. Not in the paper; for the speed models "parameter" and "input"."""),
    ] = False
    sigma_gyro: Annotated[
        options.SigmaGyro | None,
        of_estimator(
            """Noise of the gyro that the estimator assumes, standard deviations: constant, and
            as a share of the yaw rate of the tracks. The share counts for the speed model
            "slipping" alone.""",
            unit="rad/s",
        ),
    ] = None
    sigma_heading: Annotated[
        valid.Positive | None,
        of_estimator(
            "Noise of the heading that the estimator assumes, standard deviation.", unit="rad"
        ),
    ] = None

    q: Annotated[
        options.Weights, of_controller("Diagonal of the weight Q_k, eq. (22), of (x, y, θ).")
    ] = paper.Q3
    r: Annotated[valid.Positive, of_controller("Weight R of the yaw rate, eq. (22).")] = paper.R
    qn_factor: Annotated[
        valid.NotNegative,
        of_controller("Weight of the last node over the others, Q_N = qn_factor · Q_k."),
    ] = paper.QN_FACTOR
    omega_max_radps: Annotated[
        valid.Positive, of_controller("Bound on the commanded yaw rate, eq. (16).", unit="rad/s")
    ] = paper.OMEGA_MAX_RADPS
    prediction_horizon: Annotated[
        valid.Intervals, of_controller("Intervals of the prediction.")
    ] = paper.HORIZON
    look_ahead_m: Annotated[
        valid.NotNegative,
        of_controller(
            "How far beyond the closest point of the path the desired points begin.", unit="m"
        ),
    ] = 0.0
    input_reference: Annotated[
        Literal["measured", "curvature"],
        of_controller("""Desired yaw rate. "measured": the measured one over the horizon, as in
            the paper; "curvature": the one that the path's curvature asks for (G8)."""),
    ] = "measured"
    command_delay: Annotated[
        Literal[0, 1],
        of_controller(
            "0: the command computed at t_k is applied at once; 1: one sample later (G10)."
        ),
    ] = 0
    traction_timing: Annotated[
        Literal["feedback", "sample_before", "prepared_anew"],
        of_controller("""When ν̂, μ̂ and κ̂ reach the RHC. "feedback": those of the newest
            sample act through the linearised model; "sample_before": the preparation uses those
            of the sample before; "prepared_anew": the preparation waits for those of the newest
            sample (G15)."""),
    ] = "feedback"
    controller: Annotated[
        Literal["rhc"] | Controller,
        SkipValidation,
        of_controller("""The paper's "rhc", or one's own, a rhec.Controller, which takes what it
            likes of the parameters above and of what the loop knows."""),
    ] = "rhc"

    # A track saturates at 1.5 m/s, and the outer one is faster in a curve.
    speed_mps: Annotated[valid.Positive, Limits(le=1.4), of_drive("Set speed.", unit="m/s")] = (
        paper.SPEED_MPS
    )
    duration_s: Annotated[
        valid.Positive, Limits(ge=paper.DT_S, le=1e6), of_drive("Length of the run.", unit="s")
    ] = 240.0
    backwards: Annotated[
        valid.Flag, of_drive("Whether the robot drives in reverse, λ = 1 in eq. (18) (G9).")
    ] = False
    path: Annotated[
        Path | None,
        SkipValidation,
        of_drive("""Path to follow. None: rows that are joined by turns, as the next three
            parameters say."""),
    ] = None
    turns: Annotated[
        Turns,
        of_drive("""Which way the path turns at the ends of its rows (G18). "alternate": to
            alternate sides, as a field of four rows is worked, then back along the headland;
            "left" and "right": always to that side, between two rows; "figure_of_eight": to
            alternate sides, between two rows that cross."""),
    ] = "alternate"
    row_length_m: Annotated[
        valid.Positive, Limits(le=1e4), of_drive("Length of each of these rows.", unit="m")
    ] = paper.ROW_LENGTH_M
    headland_radius_m: Annotated[
        valid.Positive, Limits(ge=1e-3, le=1e3), of_drive("Radius of these turns.", unit="m")
    ] = paper.HEADLAND_RADIUS_M
    start_offset_m: Annotated[
        valid.Real,
        of_drive("Where the robot starts, to the left of the path's beginning (G3).", unit="m"),
    ] = paper.START_OFFSET_M
    start_yaw_rad: Annotated[
        valid.Real, of_drive("Yaw at the start relative to the path.", unit="rad")
    ] = 0.0
    guess_yaw_rad: Annotated[
        valid.Real, of_drive("Error of the estimator's first guess of the yaw.", unit="rad")
    ] = 0.0

    # In this soil and ground, and with these sensors, the paper's numbers are possible
    # (docs/world.md). `rhec.WORLDS` has other worlds.

    terrain: Annotated[
        Terrain | None,
        SkipValidation,
        of_soil("Traction of the soil. None: random fields with the following statistics."),
    ] = None
    mu_mean: Annotated[options.Traction, of_soil("Mean of μ.")] = 0.975
    mu_deviation: Annotated[
        valid.NotNegative, of_soil("Standard deviation of μ over the field.")
    ] = 0.008
    kappa_mean: Annotated[options.Traction, of_soil("Mean of κ.")] = 0.96
    kappa_deviation: Annotated[
        valid.NotNegative, of_soil("Standard deviation of κ over the field.")
    ] = 0.013
    # Shorter ones than the grid's cells, 0.5 m, cannot be seen.
    correlation_length_m: Annotated[
        valid.Positive, Limits(ge=0.5), of_soil("Correlation length of the traction.", unit="m")
    ] = 4.0
    patches: Annotated[
        tuple[Patch, ...],
        of_soil("Discs of sudden change, ((x, y, radius, μ, κ), …).", unit="m, m, m, -, -"),
    ] = ()
    soil_under: Annotated[
        Literal["centre", "tracks"],
        of_soil("""Where the soil is looked up. "centre": for both tracks below the robot's
            middle, as in the paper; "tracks": for each track below its own middle."""),
    ] = "tracks"
    slip_difference: Annotated[
        valid.Real,
        Limits(ge=-1, le=1),
        of_soil("""Share by which the left track slips more than the right one, everywhere: d in
            μ_l = μ (1 - d/2), μ_r = μ (1 + d/2), where the latter is at most 1."""),
    ] = 0.005
    bump_sigma_radps: Annotated[
        valid.NotNegative,
        of_soil("Standard deviation of the yaw rate that bumps add.", unit="rad/s"),
    ] = 0.007
    rut_length_m: Annotated[
        valid.NotNegative,
        of_soil(
            """Correlation length of the bumps along the way. 0: one bump a sample; else they
            turn the robot the faster it drives, and their deviation is that at the paper's
            speed.""",
            unit="m",
        ),
    ] = 0.5
    track_width_m: Annotated[
        valid.Positive, of_robot("Distance b between the tracks.", unit="m")
    ] = paper.TRACK_WIDTH_M
    rotation_centre_m: Annotated[
        valid.Real,
        of_robot(
            """How far the point about which the robot turns lies ahead of its middle, where the
            antenna of the GNSS is.""",
            unit="m",
        ),
    ] = 0.0

    gnss_sigma_m: Annotated[
        valid.NotNegative, of_sensors("Standard deviation of the GNSS position's error.", unit="m")
    ] = 0.018
    gnss_slow_share: Annotated[
        valid.NotNegative,
        Limits(le=1),
        of_sensors("Share of the variance of that error that varies slowly (G4)."),
    ] = 0.55
    gnss_slow_time_s: Annotated[
        valid.Positive, of_sensors("Time constant of the slow part (G4).", unit="s")
    ] = 170.0
    encoder_sigma_mps: Annotated[
        valid.NotNegative,
        of_sensors("Standard deviation of one track's encoder at 50 Hz.", unit="m/s"),
    ] = 0.02
    speed_sigma_mps: Annotated[
        valid.NotNegative,
        of_sensors(
            "Standard deviation of the error of the measured speed that both tracks share.",
            unit="m/s",
        ),
    ] = 0.023
    sensors: Annotated[
        options.Sensors,
        of_sensors("""What the robot has besides GNSS and encoders, ("gyro",), ("heading",) or
            both; for "rhe", "oracle", which does not need them, and a rhec.Estimator that reads
            just these."""),
    ] = ()
    gyro_sigma_radps: Annotated[
        valid.NotNegative,
        of_sensors(
            """Standard deviation of the error of the gyro's mean over a sample, where `sensors`
            has a gyro.""",
            unit="rad/s",
        ),
    ] = 0.01
    gyro_bias_radps: Annotated[valid.Real, of_sensors("Bias of the gyro.", unit="rad/s")] = 0.01
    gyro_scale: Annotated[
        valid.Positive,
        of_sensors("""Scale of the gyro: it measures this multiple of the yaw rate over ground,
            plus its bias."""),
    ] = 1.01
    heading_sigma_rad: Annotated[
        valid.NotNegative,
        of_sensors(
            """Standard deviation of the error of the measured heading, where `sensors` has one.""",
            unit="rad",
        ),
    ] = 0.02
    faults: Annotated[tuple[Fault, ...], of_sensors("Sensor faults, (rhec.Fault, …).")] = ()
    seed: Annotated[Seed, of_sensors("Fixes the soil and all noise.")] = 0

    __repr__ = as_python

    @classmethod
    def describe(cls) -> "pd.DataFrame":
        """What may be chosen, as a table.

        Returns:
            A DataFrame with one row for each parameter, by its name: its default, unit and group
            ("the estimator", "the controller", …), and what it does.
        """
        import pandas as pd  # imported here, because it takes as long as the rest of the package

        from rhec.simulation.scenario_fields import fields_of

        fields = fields_of(cls)
        rows = [(getattr(cls, name), of.unit, of.group, of.text) for name, of in fields.items()]
        columns = ["default", "unit", "group", "what it does"]
        return pd.DataFrame(rows, pd.Index([*fields], name="name"), columns)

    def __post_init__(self):
        if isinstance(self.estimator, ca.Function):
            object.__setattr__(self, "estimator", Estimator(self.estimator))
        _check_types(self)
        for name in ("mu", "kappa"):
            _check_deviation(self, name)
        _check_fits_estimator(self)
        if isinstance(self.controller, Controller):
            check_fits(self)
        if self.terrain is None:
            box_of(self, path_of(self))


def _check_types(scenario):
    """Refuse an estimator, controller, path or terrain of another type."""
    estimator = scenario.estimator
    if not _is_one_of(NAMES, estimator) and not isinstance(estimator, Estimator):
        expected = f"it should be one of {NAMES}, a rhec.Estimator or a CasADi Function"
        raise ValueError(f"estimator was {valid.shown(estimator)}; {expected}")
    controller = scenario.controller
    if not _is_one_of(("rhc",), controller) and not isinstance(controller, Controller):
        expected = "it should be 'rhc' or a rhec.Controller"
        raise ValueError(f"controller was {valid.shown(controller)}; {expected}")
    for name, expected_type in (("path", Path), ("terrain", Terrain)):
        value = getattr(scenario, name)
        if not isinstance(value, expected_type | None):
            expected = f"it should be a rhec.{expected_type.__name__} or None"
            raise ValueError(f"{name} was {valid.shown(value)}; {expected}")


def _is_one_of(names, value):
    return isinstance(value, str) and value in names


def _check_deviation(scenario, name):
    """Refuse a deviation that no distribution between 0 and 1 with this mean has."""
    mean = getattr(scenario, f"{name}_mean")
    deviation = getattr(scenario, f"{name}_deviation")
    # Of all distributions on [0, 1] with this mean, the one on 0 and 1 alone varies most.
    largest = (mean * (1 - mean)) ** 0.5
    if deviation and deviation >= largest:
        expected = f"with {name}_mean {mean} it should be below {largest:.3g}"
        reason = "the most a quantity between 0 and 1 can vary"
        raise ValueError(f"{name}_deviation was {deviation!r}; {expected}, {reason}")


def _check_fits_estimator(scenario):
    """Refuse `sensors`, `yaw_drift`, `faults` and `sigma_w` that do not fit the estimator."""
    estimator = scenario.estimator
    read = estimator_of(estimator).sensors
    if read not in (None, scenario.sensors):
        expected = f"for the estimator {valid.shown(estimator)} it should be {read!r}"
        raise ValueError(f"sensors was {scenario.sensors!r}; {expected}")
    if scenario.yaw_drift and not estimator_of(estimator).takes_yaw_drift:
        expected = f"for the estimator {valid.shown(estimator)} it should be False"
        raise ValueError(f"yaw_drift was True; {expected}")
    if scenario.yaw_drift:
        refuse_drift_with(scenario.speed_model)
    for fault in scenario.faults:
        if fault.channel in SENSORS and fault.channel not in scenario.sensors:
            raise ValueError(
                f"faults was {valid.shown(scenario.faults)}, with a {fault.channel} that fails; "
                f"sensors should have {fault.channel!r}, too, and was {scenario.sensors!r}"
            )
    entries = estimator_of(estimator).n_sigma_w(Choice.of(scenario))
    if scenario.sigma_w is not None and len(scenario.sigma_w) != entries:
        expected = f"for the estimator {valid.shown(estimator)} it should have {entries} entries"
        raise ValueError(f"sigma_w was {valid.shown(scenario.sigma_w)}; {expected}")
    if isinstance(estimator, Estimator) and entries and scenario.sigma_w is None:
        rule = tuning.process_noise_of(scenario)
        if rule not in estimator.noises:
            expected = f"it should have {entries} entries, since {rule!r} picked none for it"
            raise ValueError(f"sigma_w was None for the estimator {estimator!r}; {expected}")


class _TextsAsDocstring:
    """The texts, made into a docstring when it is read, because no run needs them."""

    def __get__(self, scenario, owner):
        from rhec.simulation.scenario_fields import docstring

        return docstring(owner)


Scenario.__doc__ = _TextsAsDocstring()
