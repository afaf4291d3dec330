"""The explorer's controls as data: what each changes in a `rhec.Scenario`, in which unit and range,
and how to get from their values to scenarios.

A control's key is a field of Scenario, or (field, place) for one entry of a field that has several.
A new field is one line of GROUPS.
"""

import math
from dataclasses import fields
from typing import NamedTuple

from rhec.estimator import rhe
from rhec.extensions.faults import Fault
from rhec.model import tracked_robot as model
from rhec.scenario import Scenario


class Slider(NamedTuple):
    """A number. kind: "real", "whole", or "log", whose low, high and step are powers of ten; slow:
    another structure, to be compiled at first.
    """

    key: str | tuple
    label: str
    low: float
    high: float
    step: float
    about: str
    kind: str = "real"
    slow: bool = False


class Choice(NamedTuple):
    """One of several values, each with its name in the list."""

    key: str
    label: str
    options: tuple
    about: str


ESTIMATORS = (
    ("RHE", "rhe"),
    ("EKF", "ekf"),
    ("dual", "dual"),
    ("oracle", "oracle"),
    ("traction oracle", "traction_oracle"),
)
READINGS = (("printed", "printed"), ("calibrated", "calibrated"), ("own W", "own"))
YES_NO = (("no", False), ("yes", True))
FAULTS = (
    ("none", ()),
    ("no GNSS for 5 s", (Fault(kind="missing", start_s=40.0, duration_s=5.0),)),
    ("no GNSS for 20 s", (Fault(kind="missing", start_s=40.0, duration_s=20.0),)),
    (
        "positions 2 m off for 10 s",
        (Fault(kind="outliers", start_s=40.0, duration_s=10.0, size_m=2.0),),
    ),
    ("a jump of 0.5 m for 20 s", (Fault(kind="jump", start_s=40.0, duration_s=20.0, size_m=0.5),)),
    ("positions 0.6 s late", (Fault(kind="latency", delay_s=0.6),)),
    (
        "left encoder dead for 20 s",
        (Fault(kind="dead", channel="left", start_s=40.0, duration_s=20.0),),
    ),
)

GROUPS = {
    "Estimator": (
        Slider(
            "estimation_horizon",
            "window [intervals]",
            2,
            40,
            1,
            "estimation horizon of the RHE, 0.2 s each",
            "whole",
            True,
        ),
        Choice(
            "speed_model",
            "speed ν",
            (("one a window", "parameter"), ("measured", "input"), ("slipping tracks", "slipping")),
            "R6, R13: how the RHE takes the speed",
        ),
        Choice(
            "arrival_mean",
            "arrival mean",
            (("smoothed", "smoothed"), ("filtered", "filtered")),
            "R7: prior mean at the window's oldest node",
        ),
        Choice(
            "robust",
            "robust",
            YES_NO,
            "RHE and dual: gate positions, and begin again where they contradict for long",
        ),
        *(
            Slider(
                ("sigma_w", place),
                f"σ_W of {name}",
                -4,
                1.5,
                0.05,
                "process noise a sample; counts with reading “own W”",
                "log",
            )
            for place, name in enumerate(("x [m]", "y [m]", "θ [rad]", "ν [m/s]", "μ [-]", "κ [-]"))
        ),
    ),
    "Controller": (
        *(
            Slider(
                ("q", place), f"Q of {name}", 0, 20, 0.5, "weight of this error over the horizon"
            )
            for place, name in enumerate(("x", "y", "θ"))
        ),
        Slider("r", "R", -1, 3, 0.05, "weight of the yaw rate", "log"),
        Slider("qn_factor", "Q_N / Q", 0, 50, 0.5, "weight of the last node"),
        Slider(
            "prediction_horizon",
            "horizon [intervals]",
            2,
            40,
            1,
            "prediction horizon of the RHC, 0.2 s each",
            "whole",
            True,
        ),
        Slider(
            "look_ahead_m", "look-ahead [m]", 0, 3, 0.05, "the desired points begin this far ahead"
        ),
        Slider(
            "omega_max_radps", "ω_max [rad/s]", 0.02, 0.5, 0.01, "bound on the commanded yaw rate"
        ),
        Choice(
            "input_reference",
            "ω_r",
            (("measured, held", "measured"), ("curvature", "curvature")),
            "R8: input reference",
        ),
        Choice(
            "command_delay",
            "command",
            (("at once", 0), ("a sample later", 1)),
            "R10: when it is applied",
        ),
    ),
    "Drive": (
        Slider(
            "speed_mps",
            "speed [m/s]",
            0.1,
            1.4,
            0.02,
            "set speed; above about 0.7 the curves ask for more than the bound on the yaw rate",
        ),
        Slider("duration_s", "duration [s]", 20, 600, 10, "length of the run"),
        Slider("start_offset_m", "start beside [m]", -3, 3, 0.1, "left of the path's beginning"),
        Slider(
            "start_yaw_rad", "start turned [rad]", -1.5, 1.5, 0.05, "against the path's beginning"
        ),
        Slider(
            "guess_yaw_rad",
            "yaw guess off [rad]",
            -1.5,
            1.5,
            0.05,
            "error of the estimator's first guess",
        ),
        Choice("backwards", "backwards", YES_NO, "R9: λ = 1"),
        Slider("row_length_m", "row length [m]", 10, 100, 1, "of each of the two rows"),
        Slider(
            "headland_radius_m",
            "turn radius [m]",
            3,
            20,
            0.2,
            "of the half circles on the headlands",
        ),
    ),
    "Soil": (
        Slider("mu_mean", "μ mean", 0.3, 0.99, 0.01, "what is left of the speed"),
        Slider("mu_deviation", "μ deviation", 0, 0.3, 0.01, "over the field"),
        Slider("kappa_mean", "κ mean", 0.3, 0.99, 0.01, "what is left of the turning"),
        Slider("kappa_deviation", "κ deviation", 0, 0.3, 0.01, "over the field"),
        Slider("correlation_length_m", "soil alike over [m]", 0.5, 20, 0.5, "correlation length"),
    ),
    "Sensors": (
        Slider(
            "gnss_sigma_m",
            "GNSS noise [m]",
            0,
            0.2,
            0.005,
            "standard deviation of the position error",
        ),
        Slider(
            "gnss_slow_share", "slow share", 0, 1, 0.05, "of the GNSS error's variance: 0 is white"
        ),
        Slider("gnss_slow_time_s", "slow over [s]", 5, 300, 5, "time constant of the slow part"),
        Slider("encoder_sigma_mps", "encoder noise [m/s]", 0, 0.2, 0.0025, "of one track at 50 Hz"),
        Slider(
            "bump_sigma_radps",
            "bumps [rad/s]",
            0,
            0.2,
            0.005,
            "yaw rate that a bump adds for one sample",
        ),
        Choice("faults", "fault", FAULTS, "what is wrong with the sensors, and when"),
        *(
            Slider(
                ("sigma_v", place),
                f"σ_V of {name}",
                -3,
                0,
                0.05,
                "noise of this measurement that the estimator assumes",
                "log",
            )
            for place, name in enumerate(("x [m]", "y [m]", "ν [m/s]", "ω [rad/s]"))
        ),
    ),
}
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
    """Each control's value in this scenario, with "reading", "seed" and "patches"."""
    values = {
        key: getattr(scenario, key[0])[key[1]] if isinstance(key, tuple) else getattr(scenario, key)
        for key in CONTROLS
        if key[0] != "sigma_w"
    }
    own = (
        scenario.sigma_w
        if scenario.sigma_w is not None and len(scenario.sigma_w) == 6
        else rhe.SIGMA_W[scenario.process_noise]
    )
    return (
        values
        | {("sigma_w", place): sigma for place, sigma in enumerate(own)}
        | {
            "process_noise": scenario.process_noise if scenario.sigma_w is None else "own",
            "seed": scenario.seed,
            "patches": scenario.patches,
        }
    )


def scenario_of(values, estimator, start):
    """The scenario that the controls' values ask for, for one estimator; what has no control is as
    in `start`. Refuses as Scenario does.
    """
    asked, entries = (
        {field.name: getattr(start, field.name) for field in fields(Scenario)}
        | {"estimator": estimator},
        {},
    )
    for key, value in values.items():
        if isinstance(key, tuple):
            entries.setdefault(key[0], []).append(value)
        else:
            asked[key] = value
    asked |= {name: tuple(entry) for name, entry in entries.items()}
    asked["robust"] = asked["robust"] and estimator in ("rhe", "dual")
    if asked["process_noise"] == "own":
        asked |= {
            "process_noise": start.process_noise,
            "sigma_w": own_sigma_w(asked["sigma_w"], estimator, asked["speed_model"]),
        }
    else:
        asked["sigma_w"] = None
    return Scenario(**asked)


def own_sigma_w(six, estimator, speed_model):
    """Of the standard deviations of (x, y, θ, ν, μ, κ) those that an estimator has, as Scenario
    says; none for one that has none.
    """
    if estimator == "rhe":
        return (
            tuple(six[4:])
            if speed_model == "slipping"
            else tuple(six[state] for state in model.interval(speed_model).states)
        )
    return {"dual": (*six, *six[:4]), "ekf": tuple(six[:4]), "traction_oracle": tuple(six[:4])}.get(
        estimator
    )


def tidy(control, value, before):
    """A control's value without the digits that only a slider's arithmetic made: as it was before,
    if it has not moved.
    """
    if isinstance(control, Choice) or math.isclose(value, before, rel_tol=1e-9, abs_tol=1e-12):
        return value if isinstance(control, Choice) else before
    if control.kind == "whole":
        return int(value)
    return float(f"{value:.4g}") if control.kind == "log" else round(float(value), 10)


def line_of(thing):
    """A Scenario, or a Fault, as one line of Python: only what differs from the defaults. A path, a
    terrain or an estimator of one's own is its name.
    """
    given = [
        (field.name, getattr(thing, field.name))
        for field in fields(thing)
        if getattr(thing, field.name) != field.default
    ]
    return f"rhec.{type(thing).__name__}({', '.join(f'{name}={_said(value, name)}' for name, value in given)})"


def _said(value, name):
    if isinstance(value, tuple):
        return f"({', '.join(_said(each, name) for each in value)}{',' if len(value) == 1 else ''})"
    return (
        line_of(value)
        if isinstance(value, Fault)
        else repr(value)
        if isinstance(value, bool | int | float | str)
        else name
    )
