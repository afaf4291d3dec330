"""The explorer's controls as data, and how to get from their values to scenarios.

A control's key is a field of Scenario, or (field, place) for one entry of a field that has several.
A new control is one line.
"""

import math
from dataclasses import fields
from typing import NamedTuple

from rhec.simulation.faults import Fault
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import ROBUST_NAMES, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

__all__ = ["CONTROLS", "ESTIMATORS", "GROUPS", "NEW_PATCH", "PATCH", "PROCESS_NOISES", "Selection"]
__all__ += ["Slider", "line_of", "scenario_of", "tidy", "values_of"]


class Slider(NamedTuple):
    """A number from low to high.

    kind: "real"; "whole", another structure of the loop, compiled when first asked for; or "log",
    whose low, high and step are powers of ten.
    """

    key: str | tuple
    label: str
    low: float
    high: float
    step: float
    about: str
    kind: str = "real"


class Selection(NamedTuple):
    """One of several values, each with its name in the list."""

    key: str
    label: str
    options: tuple
    about: str


ESTIMATORS = {"rhe": "RHE", "ekf": "EKF", "dual": "dual"}  # by their name in Scenario
ESTIMATORS |= {"oracle": "oracle", "traction_oracle": "traction oracle"}
PROCESS_NOISES = (("printed", "printed"), ("calibrated", "calibrated"), ("own W", "own"))
_YES_NO = (("no", False), ("yes", True))
_SPEEDS = (("one a window", "parameter"), ("measured", "input"), ("slipping tracks", "slipping"))
_PRIOR_MEANS = (("smoothed", "smoothed"), ("filtered", "filtered"))
_INPUT_REFERENCES = (("measured, held", "measured"), ("curvature", "curvature"))
_DELAYS = (("at once", 0), ("a sample later", 1))
_STATES = ("x [m]", "y [m]", "θ [rad]", "ν [m/s]", "μ [-]", "κ [-]")
_MEASURED = ("x [m]", "y [m]", "ν [m/s]", "ω [rad/s]")


def _fault(duration_s, **what):
    return (Fault(start_s=40.0, duration_s=duration_s, **what),)


_FAULTS = (
    ("none", ()),
    ("no GNSS for 5 s", _fault(5.0, kind="missing")),
    ("no GNSS for 20 s", _fault(20.0, kind="missing")),
    ("positions 2 m off for 10 s", _fault(10.0, kind="outliers", size_m=2.0)),
    ("a jump of 0.5 m for 20 s", _fault(20.0, kind="jump", size_m=0.5)),
    ("positions 0.6 s late", (Fault(kind="latency", delay_s=0.6),)),
    ("left encoder dead for 20 s", _fault(20.0, kind="dead", channel="left")),
)


def _entries(field, symbol, names, slider):
    """One slider for each entry of a field."""
    keys = [(field, place) for place in range(len(names))]
    return [Slider(key, f"{symbol} of {name}", *slider) for key, name in zip(keys, names)]


_ESTIMATOR = (
    Slider("estimation_horizon", "window [intervals]", 2, 40, 1, "estimation horizon", "whole"),
    Selection("speed_model", "speed ν", _SPEEDS, "R6, R13: how the RHE takes the speed"),
    Selection("arrival_mean", "arrival mean", _PRIOR_MEANS, "R7: prior mean at the oldest node"),
    Selection("robust", "robust", _YES_NO, "RHE and dual: weigh measurements, restart if lost"),
    *_entries("sigma_w", "σ_W", _STATES, (-4, 1.5, 0.05, "a sample; counts with “own W”", "log")),
)
_CONTROLLER = (
    *_entries("q", "Q", ("x", "y", "θ"), (0, 20, 0.5, "weight of this error over the horizon")),
    Slider("r", "R", -1, 3, 0.05, "weight of the yaw rate", "log"),
    Slider("qn_factor", "Q_N / Q", 0, 50, 0.5, "weight of the last node"),
    Slider("prediction_horizon", "horizon [intervals]", 2, 40, 1, "prediction horizon", "whole"),
    Slider("look_ahead_m", "look-ahead [m]", 0, 3, 0.05, "how far ahead the desired points begin"),
    Slider("omega_max_radps", "ω_max [rad/s]", 0.02, 0.5, 0.01, "bound on the commanded yaw rate"),
    Selection("input_reference", "ω_r", _INPUT_REFERENCES, "R8: input reference"),
    Selection("command_delay", "command", _DELAYS, "R10: when it is applied"),
    Selection("cautious", "cautious", _YES_NO, "slow down where the robot may leave the row"),
    Slider("caution", "caution [σ]", 0, 3, 0.05, "standard deviations it sets aside"),
)
_DRIVE = (
    Slider("speed_mps", "speed [m/s]", 0.1, 1.4, 0.02, "above 0.7 curves exceed ω_max"),
    Slider("duration_s", "duration [s]", 20, 600, 10, "length of the run"),
    Slider("start_offset_m", "start beside [m]", -3, 3, 0.1, "left of the path’s beginning"),
    Slider("start_yaw_rad", "start turned [rad]", -1.5, 1.5, 0.05, "against the path’s beginning"),
    Slider("guess_yaw_rad", "yaw guess off [rad]", -1.5, 1.5, 0.05, "error of the initial guess"),
    Selection("backwards", "backwards", _YES_NO, "R9: λ = 1"),
    Slider("row_length_m", "row length [m]", 10, 100, 1, "of each of the two rows"),
    Slider("headland_radius_m", "turn radius [m]", 3, 20, 0.2, "of the headlands’ half circles"),
)
_SOIL = (
    Slider("mu_mean", "μ mean", 0.3, 0.99, 0.01, "what is left of the speed"),
    Slider("mu_deviation", "μ deviation", 0, 0.3, 0.01, "over the field"),
    Slider("kappa_mean", "κ mean", 0.3, 0.99, 0.01, "what is left of the turning"),
    Slider("kappa_deviation", "κ deviation", 0, 0.3, 0.01, "over the field"),
    Slider("correlation_length_m", "soil alike over [m]", 0.5, 20, 0.5, "correlation length"),
)
_SENSORS = (
    Slider("gnss_sigma_m", "GNSS noise [m]", 0, 0.2, 0.005, "standard deviation of a position"),
    Slider("gnss_slow_share", "slow share", 0, 1, 0.05, "of the GNSS error’s variance; 0: white"),
    Slider("gnss_slow_time_s", "slow over [s]", 5, 300, 5, "time constant of the slow part"),
    Slider("encoder_sigma_mps", "encoder noise [m/s]", 0, 0.2, 0.0025, "of one track at 50 Hz"),
    Slider("speed_sigma_mps", "speed noise [m/s]", 0, 0.2, 0.005, "of the measured speed"),
    Slider("bump_sigma_radps", "bumps [rad/s]", 0, 0.2, 0.005, "yaw rate added for one sample"),
    Selection("faults", "fault", _FAULTS, "what is wrong with the sensors, and when"),
    *_entries("sigma_v", "σ_V", _MEASURED, (-3, 0, 0.05, "noise the estimator assumes", "log")),
)
GROUPS = {"Estimator": _ESTIMATOR, "Controller": _CONTROLLER}
GROUPS |= {"Drive": _DRIVE, "Soil": _SOIL, "Sensors": _SENSORS}
CONTROLS = {control.key: control for group in GROUPS.values() for control in group}

# A wet patch: the entries of Scenario's `patches`, and what a new one is.
PATCH = (
    Slider(0, "along x [m]", -10, 45, 0.5, "the first row runs along x from 0"),
    Slider(1, "across y [m]", -8, 24, 0.5, "the first row is at y = 0"),
    Slider(2, "radius [m]", 0.5, 8, 0.25, ""),
    Slider(3, "μ inside", 0.1, 1, 0.01, ""),
    Slider(4, "κ inside", 0.1, 1, 0.01, ""),
)
NEW_PATCH = (15.0, 0.0, 2.5, 0.7, 0.55)


def values_of(scenario):
    """Each control's value in this scenario, with "process_noise", "seed" and "patches"."""
    own = scenario.sigma_w
    noise = scenario.process_noise
    six = own if own is not None and len(own) == 6 else tuning.SIGMA_W["rhe"][noise]
    fields_of = vars(scenario) | {"sigma_w": six, "sigma_v": tuning.sigma_v_of(scenario)}
    fields_of["arrival_mean"] = Choice.of(scenario).arrival_mean
    names = (*CONTROLS, "seed", "patches")
    values = {
        key: fields_of[key[0]][key[1]] if isinstance(key, tuple) else fields_of[key]
        for key in names
    }
    offered = own is None and noise in dict(PROCESS_NOISES).values()
    return values | {"process_noise": noise if offered else "own"}


def scenario_of(values, estimator, start):
    """The scenario that the controls' values ask for.

    Args:
        values: as `values_of` returns them.
        estimator: as in Scenario.
        start: the Scenario whose values all fields without a control keep.

    Returns:
        A Scenario.

    Raises:
        ValueError: as Scenario does.
    """
    chosen = vars(start) | {"estimator": estimator}
    entries = {}
    for key, value in values.items():
        if isinstance(key, tuple):
            entries.setdefault(key[0], []).append(value)
        else:
            chosen[key] = value
    chosen |= {name: tuple(entry) for name, entry in entries.items()}
    chosen["robust"] = chosen["robust"] and estimator in ROBUST_NAMES
    if chosen["process_noise"] == "own":
        chosen["process_noise"] = start.process_noise
        if chosen["process_noise"] not in dict(PROCESS_NOISES).values():
            chosen["process_noise"] = "calibrated"  # of which nothing is left
        chosen["sigma_w"] = _own_sigma_w(chosen)
    else:
        chosen["sigma_w"] = None
    for name, usual in (("sigma_v", tuning.SIGMA_V), ("arrival_mean", tuning.ARRIVAL_MEAN)):
        if chosen[name] == usual[chosen["process_noise"]]:
            chosen[name] = None
    return Scenario(**chosen)


def _own_sigma_w(chosen):
    """Scenario's `sigma_w` for the chosen estimator, from all six that are chosen, or None."""
    if chosen["estimator"] == "dual":  # the RHE's, then the EKF's
        names = (*QUANTITIES, *QUANTITIES[:4])
    else:
        estimator = estimator_of(chosen["estimator"])
        choice = Choice(*(chosen[name] for name in Choice._fields[:5]))
        n = estimator.n_sigma_w(choice)
        names = estimator.states(choice)[-n:] if n else ()
    six = dict(zip(QUANTITIES, chosen["sigma_w"]))
    return tuple(six[name] for name in names) or None


def tidy(control, value, before):
    """A control's value without a slider's rounding errors: as before, if it has not moved."""
    if isinstance(control, Selection):
        return value
    if math.isclose(value, before, rel_tol=1e-9, abs_tol=1e-12):
        return before
    if control.kind == "whole":
        return int(value)
    return float(f"{value:.4g}") if control.kind == "log" else round(float(value), 10)


def line_of(thing):
    """A Scenario, or a Fault, as one line of Python that leaves out what is as by default.

    The user's own path, terrain or estimator stands there by the name of its field.
    """
    words = [
        f"{field.name}={_as_code(getattr(thing, field.name), field.name)}"
        for field in fields(thing)
        if getattr(thing, field.name) != field.default
    ]
    return f"rhec.{type(thing).__name__}({', '.join(words)})"


def _as_code(value, name):
    if isinstance(value, tuple):
        entries = ", ".join(_as_code(each, name) for each in value)
        return f"({entries}{',' if len(value) == 1 else ''})"
    if isinstance(value, Fault):
        return line_of(value)
    return repr(value) if isinstance(value, bool | int | float | str) else name
