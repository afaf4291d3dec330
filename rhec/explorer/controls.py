"""The controls of the explorer, and the conversion of their values to scenarios and back.

The key of a control is a parameter of Scenario, or (parameter, index) for one entry of a tuple.
Groups, units, tooltips and choices come from `scenario_fields`; a control adds a short label and
the range of a slider.
"""

import itertools
import math
from decimal import Decimal
from typing import NamedTuple

from rhec.simulation.faults import Fault
from rhec.simulation.scenario import Scenario
from rhec.simulation.scenario_fields import fields_of
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import Choice, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.sensors import SENSORS

_FIELDS = fields_of(Scenario)


class Slider(NamedTuple):
    """A number from low to high.

    kind: "real"; "whole" for integers that change the compiled loop; or "log", with powers of ten
    as low, high and step.
    """

    key: str | tuple
    label: str
    low: float
    high: float
    step: float
    tooltip: str
    kind: str = "real"


class Selection(NamedTuple):
    """One of several values."""

    key: str
    label: str
    options: tuple  # of (name in the list, value)
    tooltip: str


def _step(low, high, default):
    """The step of a slider: 1, 2 or 5 times a power of ten, at most a 40th of the range.

    It is the largest from which the default value is reached, or, if none reaches it, the largest.
    """
    low, high, default = (Decimal(str(value)) for value in (low, high, default))
    longest = (high - low) / 40
    power = longest.adjusted()
    round_numbers = [
        Decimal(digit).scaleb(power - smaller) for smaller in (0, 1) for digit in (5, 2, 1)
    ]
    steps = [step for step in round_numbers if step <= longest]
    return float(next((step for step in steps if (default - low) % step == 0), steps[0]))


def _ranged(key, label, low, high, tooltip, default, kind="real"):
    """A Slider in round steps."""
    step = {"whole": 1, "log": 0.05}.get(kind) or _step(low, high, default)
    return Slider(key, label, low, high, step, tooltip, kind)


def _slider(name, label, high, low=None, kind="real"):
    """The Slider of a parameter, from its least value on; of one without, from -high on."""
    field = _FIELDS[name]
    if low is None:
        low = -high if field.lowest is None else field.lowest
    unit = f" [{field.unit}]" if field.unit else ""
    default = getattr(Scenario, name)
    return _ranged(name, f"{label}{unit}", low, high, field.text, default, kind)


def _entries(field, symbol, names, low, high, kind="real"):
    """One Slider for each entry of a parameter."""
    text = _FIELDS[field].text
    return [
        _ranged((field, place), f"{symbol} of {name}", low, high, text, low, kind)
        for place, name in enumerate(names)
    ]


def _selection(field, name, labels):
    """The Selection of a parameter; labels: the names of its choices."""
    options = zip(labels, _FIELDS[field].choices, strict=True)
    return Selection(field, name, tuple(options), _FIELDS[field].text)


def _fault(duration_s, **settings):
    return (Fault(start_s=40.0, duration_s=duration_s, **settings),)


RULES = tuning.RULES_IN_DEFAULT_WORLD
PROCESS_NOISES = tuple((name, name) for name in (*RULES, "custom"))
_STATES = ("x [m]", "y [m]", "θ [rad]", "ν [m/s]", "μ [-]", "κ [-]")
_MEASURED = ("x [m]", "y [m]", "ν [m/s]", "ω [rad/s]")
_FAULTS = (
    ("none", ()),
    ("no GNSS for 5 s", _fault(5.0, kind="missing")),
    ("no GNSS for 20 s", _fault(20.0, kind="missing")),
    ("positions 2 m off for 10 s", _fault(10.0, kind="outliers", size_m=2.0)),
    ("a jump of 0.5 m for 20 s", _fault(20.0, kind="jump", size_m=0.5)),
    ("positions 0.6 s late", (Fault(kind="latency", delay_s=0.6),)),
    ("left encoder dead for 20 s", _fault(20.0, kind="dead", channel="left")),
    ("gyro dead for 20 s", _fault(20.0, kind="dead", channel="gyro")),
    ("gyro stuck for 20 s", _fault(20.0, kind="stuck", channel="gyro")),
)
_SENSORS = tuple(
    (" and ".join(several) or "none", several)
    for n in range(len(SENSORS) + 1)
    for several in itertools.combinations(SENSORS, n)
)
_CONTROLS = (
    _slider("estimation_horizon", "window [intervals]", 40, kind="whole"),
    _selection("speed_model", "speed ν", ("constant in a window", "measured", "slipping tracks")),
    _selection("yaw_drift", "yaw drift", ("not estimated", "estimated")),
    _selection("arrival_mean", "arrival mean", ("filtered", "smoothed")),
    *_entries("sigma_w", "σ_W", _STATES, -4, 1, "log"),
    *_entries("sigma_v", "σ_V", _MEASURED, -4, 0, "log"),
    *_entries("q", "Q", ("x", "y", "θ"), 0, 20),
    _slider("r", "R", 3, -1, "log"),
    _slider("qn_factor", "Q_N / Q", 50),
    _slider("prediction_horizon", "horizon [intervals]", 40, kind="whole"),
    _slider("look_ahead_m", "look-ahead", 3),
    _slider("omega_max_radps", "ω_max", 0.5, 0.02),
    _selection("input_reference", "ω_r", ("measured, held", "curvature")),
    _selection("command_delay", "command", ("at once", "a sample later")),
    _slider("speed_mps", "speed", 1.4, 0.1),
    _slider("duration_s", "duration", 600, 20),
    _slider("start_offset_m", "start beside", 3),
    _slider("start_yaw_rad", "start turned", 2),
    _slider("guess_yaw_rad", "yaw guess off", 2),
    _selection("backwards", "backwards", ("no", "yes")),
    _selection("turns", "turns", ("to alternate sides", "left", "right", "figure of eight")),
    _slider("row_length_m", "row length", 100, 10),
    _slider("headland_radius_m", "turn radius", 20, 3),
    _slider("mu_mean", "μ mean", 0.99, 0.3),
    _slider("mu_deviation", "μ deviation", 0.3),
    _slider("kappa_mean", "κ mean", 0.99, 0.3),
    _slider("kappa_deviation", "κ deviation", 0.3),
    _slider("correlation_length_m", "correlation", 20),
    _selection("soil_under", "soil below", ("the middle", "each track")),
    _slider("slip_difference", "left slips more", 0.1, -0.1),
    _slider("bump_sigma_radps", "bumps", 0.2),
    _slider("rut_length_m", "ruts over", 3),
    _slider("rotation_centre_m", "turns ahead by", 0.5),
    _slider("gnss_sigma_m", "GNSS noise", 0.2),
    _slider("gnss_slow_share", "slow share", 1),
    _slider("gnss_slow_time_s", "slow over", 2000, 10),
    _slider("encoder_sigma_mps", "encoder noise", 0.2),
    _slider("speed_sigma_mps", "speed noise", 0.2),
    Selection("sensors", "besides (RHE)", _SENSORS, _FIELDS["sensors"].text),
    *(_slider(*setting) for sensor in SENSORS.values() for setting in sensor.settings.values()),
    Selection("faults", "fault", _FAULTS, _FIELDS["faults"].text),
)
CONTROLS = {control.key: control for control in _CONTROLS}
# {title of a tab: its controls}, in the groups of `Scenario.describe`
GROUPS = {}
for _control in _CONTROLS:
    _name = _control.key[0] if isinstance(_control.key, tuple) else _control.key
    GROUPS.setdefault(_FIELDS[_name].group.removeprefix("the ").capitalize(), []).append(_control)

# The values of a new one of Scenario's `patches`, and sliders for its entries.
NEW_PATCH = (15.0, 0.0, 2.5, 0.7, 0.55)
PATCH = (
    Slider(0, "along x [m]", -20, 50, 0.5, "The first row runs along x from 0."),
    Slider(1, "across y [m]", -30, 60, 0.5, "The first row is at y = 0."),
    Slider(2, "radius [m]", 0.5, 8, 0.1, "Radius of the patch."),
    Slider(3, "μ inside", 0.1, 1, 0.01, "Traction of the patch."),
    Slider(4, "κ inside", 0.1, 1, 0.01, "Traction of the patch."),
)


def values_of(scenario):
    """The values of the controls for a scenario.

    Args:
        scenario: A Scenario.

    Returns:
        {key of a control: value}, with "process_noise", "seed" and "patches".
    """
    noise = tuning.process_noise_of(scenario)
    values = vars(scenario) | dict(sigma_w=sigma_w_shown(scenario))
    values["sigma_v"] = tuning.sigma_v_of(scenario)
    is_offered = scenario.sigma_w is scenario.sigma_v is None and noise in RULES
    keys = [*CONTROLS, "seed", "patches"]
    entries = {
        key: values[key[0]][key[1]] if isinstance(key, tuple) else values[key] for key in keys
    }
    return entries | dict(process_noise=noise if is_offered else "custom")


def sigma_w_shown(scenario):
    """The six standard deviations of W on the sliders: the scenario's, else those of the RHE."""
    six = dict(zip(QUANTITIES, tuning.noise_of("rhe", scenario).sigma_w))
    six |= dict(zip(_names_of_w(vars(scenario)), scenario.sigma_w or ()))
    return tuple(six[name] for name in QUANTITIES)


def scenario_of(values, estimator, start):
    """The scenario for the values of the controls.

    Args:
        values: As `values_of` returns them.
        estimator: As in Scenario.
        start: The Scenario that provides the parameters without a control.

    Returns:
        A Scenario.

    Raises:
        ValueError: As Scenario does.
    """
    settings = vars(start) | dict(estimator=estimator)
    entries = {}
    for key, value in values.items():
        if isinstance(key, tuple):
            entries.setdefault(key[0], []).append(value)
        else:
            settings[key] = value
    settings |= {name: tuple(entry) for name, entry in entries.items()}
    own = estimator_of(estimator)
    settings["sensors"] = settings["sensors"] if own.sensors is None else own.sensors
    settings["yaw_drift"] &= own.takes_yaw_drift and settings["speed_model"] != "slipping"
    absent = {*SENSORS} - {*settings["sensors"]}
    settings["faults"] = tuple(each for each in settings["faults"] if each.channel not in absent)
    rule = settings["process_noise"]
    # What is as at the start, or the default, keeps its words there: the printed line stays short.
    if rule in ("custom", tuning.process_noise_of(start)):
        settings["process_noise"] = start.process_noise
    elif rule == tuning.DEFAULT_RULE:
        settings["process_noise"] = None
    if rule == "custom":
        has_other_states = _names_of_w(settings) != _names_of_w(vars(start))
        is_moved = settings["sigma_w"] != sigma_w_shown(start)
        if is_moved or (start.sigma_w and has_other_states):
            settings["sigma_w"] = _sigma_w_for_estimator(settings, start)
        else:
            settings["sigma_w"] = start.sigma_w
        if settings["sigma_v"] == tuning.sigma_v_of(start):
            settings["sigma_v"] = start.sigma_v
    else:
        settings |= dict(sigma_w=None, sigma_v=None)
    return Scenario(**settings)


def _names_of_w(settings):
    """The states whose standard deviations `sigma_w` of a Scenario with these fields has."""
    estimator = estimator_of(settings["estimator"])
    shape = (settings[name] for name in Choice._fields[:4])
    choice = Choice(*shape, yaw_drift=settings["yaw_drift"])
    n = estimator.n_sigma_w(choice)
    return estimator.states(choice)[-n:] if n else ()


def _sigma_w_for_estimator(settings, start):
    """Scenario's `sigma_w` for an estimator, from the six sliders; None if it has no W."""
    # The yaw drift has no slider.
    tuned = tuning.NOISES["rhe_yaw_drift"]["prediction"].sigma_w
    sigmas = dict(yaw_drift_radpm=tuned[-1])
    sigmas |= dict(zip(_names_of_w(vars(start)), start.sigma_w or ()))
    sigmas |= dict(zip(QUANTITIES, settings["sigma_w"]))
    return tuple(sigmas[name] for name in _names_of_w(settings)) or None


def tidy(control, value, before):
    """The value of a control without rounding errors; the previous value if it has not moved."""
    if isinstance(control, Selection):
        return value
    if math.isclose(value, before):
        return before
    if control.kind == "whole":
        return int(value)
    return float(f"{value:.4g}") if control.kind == "log" else round(float(value), 10)
