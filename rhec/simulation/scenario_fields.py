"""What each field of Scenario means: its group, text, unit and range, for help and menus.

No run imports this module.
"""

import re
import textwrap
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo

from rhec.simulation.scenario import Scenario

# The meaning of each field, with its unit in brackets; what values it takes, its annotation says.
# Scenario's docstring and FIELDS are made of both. Empty lines separate the groups.
_GROUPS = ("the estimator", "the controller", "the drive", "the field", "the sensors")
_TEXTS = """
estimator: The paper's "rhe" or "ekf". Not in the paper: "oracle" (has the true pose and traction);
    "augmented_ekf" (μ and κ are states), "bounded_ekf" (the same, kept between 0 and 1);
    "traction_oracle" (an EKF with the true traction), "fixed_traction" (an EKF with the mean
    traction of the field), "rhe_fixed_traction" (an RHE with that mean), "rhe_no_slip" (an RHE
    with μ = κ = 1); "yaw_drift_ekf" and "yaw_drift_rhe" (a bounded EKF and an RHE that also
    estimate how much the robot turns for each metre without a yaw rate of its tracks, which the
    controller cancels); "map_ekf" (such an EKF that is told what earlier drives found, `soil_map`);
    "drift_oracle" (an EKF with the true traction and yaw drift).
    Or a CasADi Function (memory, z) -> (memory, estimate), whose memory starts as the first guess
    (x, y, θ, ν, μ, κ) followed by zeros.
process_noise: W by name. "printed" is the paper's; "calibrated" is the likeliest for training seeds
    (R1, R2); "consistent" makes the covariance of the RHE match its errors, and sets sigma_v and
    arrival_mean, too, where these are None.
sigma_w: Standard deviations behind W, instead of process_noise: (x, y, θ, ν, μ, κ). Without (μ, κ)
    where they are not estimated, without ν where it is an input; (μ, κ) per √m for speed_model
    "slipping"; with the yaw drift in rad/m last where that is estimated.
sigma_v: Measurement noise that the estimator assumes, standard deviations of (x, y, ν, ω)
    [m, m, m/s, rad/s].
estimation_horizon: Intervals of the estimation window. N intervals have N + 1 nodes, so 14 gives
    the paper's sum of N = 15 terms (R5).
speed_model: How the RHE models ν. "parameter": one ν over the window, as in the paper; "input": one
    ν an interval, from the encoders (R6, R13); "slipping": the same, with process noise that grows
    with the distance of the tracks, also sideways, which is not in the paper.
slip: Constants of the speed model "slipping", in the order of `tuning.SLIP`; a sixth is that of
    slip to the side that lasts, `tuning.LASTING_SLIP`, of which a replay without it asks the log.
arrival_mean: Prior mean of the arrival cost. "smoothed": from the previous solution of the RHE, as
    in the paper; "filtered": from the EKF update (R7); None: the one that fits process_noise.
robust: Whether measurements that contradict others get less weight; for "rhe".
yaw_rate_interval: Which interval the measured ω of a sample belongs to. "before": to the one that
    ends at the sample; "after": to the one that begins there, so that the estimator is passed it,
    and the log holds it, one sample later (R16).
soil_map: What earlier drives tell of the soil, a rhec.SoilMap, for the estimator "map_ekf". None:
    it estimates the traction without a map.
sensors: What the robot has besides GNSS and encoders, ("gyro",), ("heading",) or both; for "rhe".
sigma_gyro: Noise of the gyro that the estimator assumes, standard deviations: constant [rad/s], and
    as a share of the yaw rate of the tracks.
sigma_heading: Noise of the heading that the estimator assumes, standard deviation [rad].

q: Diagonal of the weight Q_k, eq. (22), of (x, y, θ).
r: Weight R of the yaw rate, eq. (22).
r_speed: Weight of the set speed minus the commanded one, for the controller "speed_rhc".
qn_factor: Weight of the last node over the others, Q_N = qn_factor · Q_k.
omega_max_radps: Bound on the commanded yaw rate, eq. (16) [rad/s].
prediction_horizon: Intervals of the prediction.
look_ahead_m: How far beyond the closest point of the path the desired points begin [m].
input_reference: Desired yaw rate. "measured": the measured one over the horizon, as in the paper;
    "curvature": the one that the path's curvature asks for (R8).
command_delay: 0: the command computed at t_k is applied at once; 1: one sample later (R10).
traction_timing: When ν̂, μ̂ and κ̂ reach the controller. "feedback": those of the newest sample act
    through the linearised model; "sample_before": the preparation uses those of the sample before;
    "prepared_anew": the preparation waits for those of the newest sample (R15).
qp: Solver of the controller. "structured": Riccati recursion, the fastest at every horizon; "daqp"
    or "qpoases" (the paper's): the condensed QP, on CasADi's virtual machine.
controller: The paper's "rhc". Not in the paper: "ltv_mpc" (its QP linearised about the path instead
    of its last plan), "pure_pursuit" (the arc through a goal `look_ahead_m` ahead), "speed_rhc" (an
    RHC that commands the speed, too, and slows down where the soil gives too little yaw rate).
disturbance_observer: Whether an observer estimates the part of the yaw rate that neither encoders
    nor traction explain, and the controller cancels it (`rhec.tracked_robot.yaw_disturbance`).
observer_time_s: Time constant of that observer [s].
cautious: Whether the robot slows down where its estimate is uncertain, and before curves that ask
    for more yaw rate than the soil gives (`rhec.tracked_robot.cautious`).
caution: Number of standard deviations of the estimate that `cautious` sets aside.

speed_mps: Set speed [m/s].
duration_s: Length of the run [s].
backwards: Whether the robot drives in reverse, λ = 1 in eq. (18) (R9).
path: Path to follow. None: two rows that half circles join on the headlands.
row_length_m: Length of each of these two rows [m].
headland_radius_m: Radius of these half circles [m].
start_offset_m: Where the robot starts, to the left of the path's beginning (R3) [m].
start_yaw_rad: Yaw at the start relative to the path [rad].
guess_yaw_rad: Error of the estimator's first guess of the yaw [rad].

terrain: Traction of the soil. None: random fields with the following statistics.
mu_mean: Mean of μ.
mu_deviation: Standard deviation of μ over the field.
kappa_mean: Mean of κ.
kappa_deviation: Standard deviation of κ over the field.
correlation_length_m: Correlation length of the traction [m].
patches: Discs of sudden change, ((x, y, radius, μ, κ), …) [m, m, m, -, -].
soil_under: Where the soil is looked up. "centre": for both tracks below the robot's middle, as in
    the paper; "tracks": for each track below its own middle.
slip_difference: Share by which the left track slips more than the right one, everywhere: d in
    μ_l = μ (1 - d/2), μ_r = μ (1 + d/2), where the latter is at most 1.

gnss_sigma_m: Standard deviation of the GNSS position's error [m].
gnss_slow_share: Share of the variance of that error that varies slowly (R4).
gnss_slow_time_s: Time constant of the slow part (R4) [s].
encoder_sigma_mps: Standard deviation of one track's encoder at 50 Hz [m/s].
speed_sigma_mps: Standard deviation of the error of the measured speed that both tracks share [m/s].
bump_sigma_radps: Standard deviation of the yaw rate that bumps add [rad/s].
rut_length_m: Correlation length of the bumps along the way [m]. 0: one bump a sample; else they
    turn the robot the faster it drives, and their deviation is that at the paper's speed.
track_width_m: Distance b between the tracks [m].
rotation_centre_m: How far the point about which the robot turns lies ahead of its middle, where the
    antenna of the GNSS is [m].
side_slip_rad: Standard deviation of the angle between course and yaw, as on ice: a side slip that
    lasts, a Gauss-Markov process of time [rad]. 0: none.
side_slip_time_s: Time constant of that side slip [s].
gyro_sigma_radps: Standard deviation of the error of the gyro's mean over a sample, where `sensors`
    has a gyro [rad/s].
gyro_bias_radps: Bias of the gyro [rad/s].
gyro_scale: Scale of the gyro: it measures this multiple of the yaw rate over ground, plus its bias.
heading_sigma_rad: Standard deviation of the error of the measured heading, where `sensors` has one
    [rad].
faults: Sensor faults, (rhec.Fault, …).
seed: Fixes the soil and all noise.
"""


class Field(NamedTuple):
    """What one field of Scenario is.

    Attributes:
        group: The group of fields that it belongs to.
        text: What it means, without unit and range.
        unit: Its unit, "" where it has none.
        lowest: Least value of it, or of each of its entries; None where there is none.
        highest: Largest value, likewise.
        choices: The values of a field that is a choice of a few, else ().
        above_lowest: Whether it must be above `lowest`.
    """

    group: str
    text: str
    unit: str
    lowest: float | None
    highest: float | None
    choices: tuple
    above_lowest: bool


def _fields():
    """{name: Field}, from the texts and from the limits that pydantic checks."""
    fields = {}
    for group, texts in zip(_GROUPS, _TEXTS.split("\n\n"), strict=True):
        for name, text in re.findall(r"^(\w+): (.*(?:\n    .*)*)", texts, re.MULTILINE):
            # A field without a text fails in a test, a text without a field here.
            info = Scenario.__pydantic_fields__[name]
            text = " ".join(text.split())
            unit = re.search(r" \[(.*?)\]", text)
            text = text.replace(unit[0], "") if unit else text
            fields[name] = Field(group, text, unit[1] if unit else "", *_values_of(info))
    return fields


def _values_of(info):
    """(lowest, highest, choices, above_lowest) of a pydantic FieldInfo."""
    kind = _entry(info.annotation)
    limits = [*_flat(getattr(kind, "__metadata__", ())), *info.metadata]
    # Limits of ±1e100 only keep squares finite (`validation.Real`).
    above = max((limit.gt for limit in limits if hasattr(limit, "gt")), default=None)
    lowest = max((x.ge for x in limits if hasattr(x, "ge") and x.ge > -1e100), default=None)
    highest = min((x.le for x in limits if hasattr(x, "le") and x.le < 1e100), default=None)
    choices = get_args(kind) if get_origin(kind) is Literal else ()
    if kind is bool:
        choices = (False, True)
    if lowest is None:
        return above, highest, choices, above is not None
    return lowest, highest, choices, False


def _entry(kind):
    """What one entry of a tuple is; of alternatives the first; else the annotation itself."""
    parts = [part for part in get_args(kind) if part not in (NoneType, Ellipsis)]
    if get_origin(kind) is tuple:
        return parts[0] if all(part is parts[0] for part in parts) else Any
    # What has parts and is neither of these is a union, by either of Python's two spellings.
    if parts and get_origin(kind) not in (Literal, Annotated):
        return _entry(parts[0])
    return kind


def _flat(metadata):
    """Limits one by one, out of the pydantic Fields that hold them."""
    for item in metadata:
        yield from item.metadata if isinstance(item, FieldInfo) else (item,)


def _described(name, field):
    """A field's entry in the docstring: unit and range follow the first sentence of its text."""
    # "eq. (22)" does not end a sentence.
    first, *rest = re.split(r"(?<!eq)\. ", field.text, maxsplit=1)
    unit = f" [{field.unit}]" if field.unit else ""
    limits = ""
    if field.lowest is not None and field.highest is not None:
        limits = f", {field.lowest:g} to {field.highest:g}"
    elif field.lowest is not None:
        limits = f", {'above' if field.above_lowest else 'at least'} {field.lowest:g}"
    sentences = [f"{name}: {first.removesuffix('.')}{unit}{limits}.", *rest]
    indents = dict(initial_indent=" " * 4, subsequent_indent=" " * 8)
    return textwrap.fill(" ".join(sentences), 92, break_on_hyphens=False, **indents)


def docstring():
    """Scenario's docstring: one entry for each field, by groups."""
    groups = (
        "\n".join(_described(*item) for item in FIELDS.items() if item[1].group == group)
        for group in _GROUPS
    )
    return f"""One closed-loop run. SI units; angles in radians.

The groups of fields below are {", ".join(_GROUPS[:-1])} and {_GROUPS[-1]}.
R1 to R16 are the interpretations of the paper in docs/interpretations.md. `dataclasses.replace`
returns a Scenario that differs in some fields.

Args:
{(2 * chr(10)).join(groups)}

Raises:
    ValueError: If a field is unknown or invalid; the message is one sentence.
"""


FIELDS: dict[str, Field] = _fields()
