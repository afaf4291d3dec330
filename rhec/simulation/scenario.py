"""A scenario: every choice behind one closed-loop run, validated (docs/interpretations.md).

`scenario_fields` says what each field means."""

from typing import Annotated, Literal

import casadi as ca
from pydantic import Field as Limits
from pydantic import SkipValidation

from rhec import paper
from rhec.core._casadi import validation as valid
from rhec.core.estimator.rhe import ArrivalMean
from rhec.simulation.faults import SENSOR_CHANNELS, Fault, as_python
from rhec.simulation.validated import validated
from rhec.tracked_robot import options
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import NAMES, ROBUST_NAMES, EstimatorName, estimator_of
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.soil_map import SoilMap
from rhec.tracked_robot.terrain import Patch, Seed, Terrain


@validated
class Scenario:
    # Pydantic skips a union with a class of ours; `_check_kinds` refuses in one sentence.
    estimator: Annotated[EstimatorName | ca.Function, SkipValidation] = "rhe"
    process_noise: options.ProcessNoise = "printed"
    sigma_w: tuple[valid.NotNegative, ...] | None = None
    sigma_v: options.SigmaV | None = None
    estimation_horizon: valid.Intervals = paper.HORIZON
    speed_model: options.SpeedModel = "parameter"
    slip: options.Slip | None = None
    arrival_mean: ArrivalMean | None = None
    robust: valid.Flag = False
    yaw_rate_interval: Literal["before", "after"] = "before"
    soil_map: Annotated[SoilMap | None, SkipValidation] = None
    sensors: options.Sensors = ()
    sigma_gyro: options.SigmaGyro | None = None
    sigma_heading: valid.Positive | None = None

    q: options.Weights = paper.Q3
    r: valid.Positive = paper.R
    r_speed: valid.Positive = 0.0066
    qn_factor: valid.NotNegative = paper.QN_FACTOR
    omega_max_radps: valid.Positive = paper.OMEGA_MAX_RADPS
    prediction_horizon: valid.Intervals = paper.HORIZON
    look_ahead_m: valid.NotNegative = 0.0
    input_reference: Literal["measured", "curvature"] = "measured"
    command_delay: Literal[0, 1] = 0
    traction_timing: Literal["feedback", "sample_before", "prepared_anew"] = "feedback"
    qp: options.Solver = "structured"
    controller: options.Controller = "rhc"
    disturbance_observer: valid.Flag = False
    observer_time_s: valid.Positive = 2.0
    cautious: valid.Flag = False
    caution: valid.NotNegative = 0.25

    # A track saturates at 1.5 m/s, and the outer one is faster in a curve.
    speed_mps: Annotated[valid.Positive, Limits(le=1.4)] = paper.SPEED_MPS
    duration_s: Annotated[valid.Positive, Limits(ge=paper.DT_S, le=1e6)] = 240.0
    backwards: valid.Flag = False
    path: Annotated[Path | None, SkipValidation] = None
    row_length_m: Annotated[valid.Positive, Limits(le=1e4)] = paper.ROW_LENGTH_M
    headland_radius_m: Annotated[valid.Positive, Limits(ge=1e-3, le=1e3)] = paper.HEADLAND_RADIUS_M
    start_offset_m: valid.Real = paper.START_OFFSET_M
    start_yaw_rad: valid.Real = 0.0
    guess_yaw_rad: valid.Real = 0.0

    # Soil, ground and sensors: the centre of the posterior under the paper's numbers
    # (`workbench.studies.inverse.centre`, notebook 12_which_worlds). The world that was the default
    # before is rhec.WORLDS["former"].
    terrain: Annotated[Terrain | None, SkipValidation] = None
    mu_mean: options.Traction = 0.975
    mu_deviation: valid.NotNegative = 0.008
    kappa_mean: options.Traction = 0.96
    kappa_deviation: valid.NotNegative = 0.013
    # Shorter ones than the grid's cells, 0.5 m, cannot be seen.
    correlation_length_m: Annotated[valid.Positive, Limits(ge=0.5)] = 4.0
    patches: tuple[Patch, ...] = ()
    soil_under: Literal["centre", "tracks"] = "tracks"
    slip_difference: Annotated[valid.Real, Limits(ge=-1, le=1)] = 0.005

    gnss_sigma_m: valid.NotNegative = 0.018
    gnss_slow_share: Annotated[valid.NotNegative, Limits(le=1)] = 0.55
    gnss_slow_time_s: valid.Positive = 170.0
    encoder_sigma_mps: valid.NotNegative = 0.02
    speed_sigma_mps: valid.NotNegative = 0.023
    bump_sigma_radps: valid.NotNegative = 0.007
    rut_length_m: valid.NotNegative = 0.5
    track_width_m: valid.Positive = paper.TRACK_WIDTH_M
    rotation_centre_m: valid.Real = 0.0
    side_slip_rad: valid.NotNegative = 0.0
    side_slip_time_s: valid.Positive = 1.5
    gyro_sigma_radps: valid.NotNegative = 0.01
    gyro_bias_radps: valid.Real = 0.01
    gyro_scale: valid.Positive = 1.01
    heading_sigma_rad: valid.NotNegative = 0.02
    faults: tuple[Fault, ...] = ()
    seed: Seed = 0

    __repr__ = as_python

    def __post_init__(self):
        _check_kinds(self)
        for name in ("mu", "kappa"):
            _check_deviation(self, name)
        _check_fits_estimator(self)
        _check_fits_controller(self)


def _check_kinds(scenario):
    """Refuse an estimator, path, terrain or map of another kind."""
    estimator = scenario.estimator
    if not _is_users_own(estimator) and not (isinstance(estimator, str) and estimator in NAMES):
        expected = f"it should be one of {NAMES} or a CasADi Function"
        raise ValueError(f"estimator was {valid.shown(estimator)}; {expected}")
    for name, kind in (("path", Path), ("terrain", Terrain), ("soil_map", SoilMap)):
        value = getattr(scenario, name)
        if not isinstance(value, kind | None):
            expected = f"it should be a rhec.{kind.__name__} or None"
            raise ValueError(f"{name} was {valid.shown(value)}; {expected}")


def _is_users_own(estimator):
    return isinstance(estimator, ca.Function)


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
    """Refuse `robust`, `soil_map` and `sigma_w` that do not fit the estimator."""
    estimator = scenario.estimator
    if scenario.soil_map is not None and (_is_users_own(estimator) or estimator != "map_ekf"):
        expected = f"for the estimator {valid.shown(estimator)} it should be None"
        raise ValueError(
            f"soil_map was {scenario.soil_map!r}; {expected}, since only 'map_ekf' uses a map"
        )
    # A user's Function has no name; any name that is not in NAMES stands for it.
    name = "own" if _is_users_own(estimator) else estimator
    if scenario.robust and name not in ROBUST_NAMES:
        expected = f"for the estimator {valid.shown(estimator)} it should be False"
        raise ValueError(f"robust was True; {expected}")
    if scenario.sensors and name != "rhe":
        expected = f"for the estimator {valid.shown(estimator)} it should be ()"
        raise ValueError(f"sensors was {scenario.sensors!r}; {expected}")
    for fault in scenario.faults:
        if fault.channel in SENSOR_CHANNELS and fault.channel not in scenario.sensors:
            raise ValueError(
                f"faults was {valid.shown(scenario.faults)}, with a {fault.channel} that fails; "
                f"sensors should have {fault.channel!r}, too, and was {scenario.sensors!r}"
            )
    entries = estimator_of(name).n_sigma_w(Choice.of(scenario))
    if scenario.sigma_w is not None and len(scenario.sigma_w) != entries:
        expected = f"for the estimator {valid.shown(estimator)} it should have {entries} entries"
        raise ValueError(f"sigma_w was {valid.shown(scenario.sigma_w)}; {expected}")


def _check_fits_controller(scenario):
    """Refuse fields that the controller does not have, and pure pursuit without a goal ahead."""
    if scenario.controller == "pure_pursuit" and scenario.look_ahead_m == 0:
        expected = "for the controller 'pure_pursuit' it should be above 0, such as 1.0"
        raise ValueError(f"look_ahead_m was {scenario.look_ahead_m!r}; {expected}")
    if scenario.controller != "rhc" and scenario.traction_timing != "feedback":
        expected = f"for the controller {scenario.controller!r} it should be 'feedback'"
        raise ValueError(f"traction_timing was {scenario.traction_timing!r}; {expected}")
    if scenario.controller == "speed_rhc" and scenario.cautious:
        expected = "for the controller 'speed_rhc', which chooses the speed, it should be False"
        raise ValueError(f"cautious was True; {expected}")
    if scenario.controller == "speed_rhc" and scenario.qp != "structured":
        expected = "for the controller 'speed_rhc' it should be 'structured'"
        raise ValueError(f"qp was {scenario.qp!r}; {expected}")


class _FieldsAsDocstring:
    """Scenario's docstring, made when it is read, because no run needs the texts of the fields."""

    def __get__(self, scenario, kind):
        from rhec.simulation.scenario_fields import docstring

        return docstring()


Scenario.__doc__ = _FieldsAsDocstring()
