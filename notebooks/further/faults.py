"""Faults of the sensors, wrong starts and wet soil: the cases, and how a run is judged.

A fault hits each seed at another place of the lap, on straights and in curves. It ends when the
sensors work again, or the wet soil is behind the robot; a wrong start ends at once. The robot has
recovered when its true error stays within the tolerance for 5 s.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from notebooks.studies.parallel import map_runs
from notebooks.studies.statistics import always, over_seeds
from notebooks.studies.tables import readable
from rhec import paper
from rhec.simulation.faults import Fault
from rhec.simulation.metrics import settled_samples
from rhec.simulation.simulate import simulate

AFTER_S = 60.0  # how long after a fault the robot drives
_AIM_S = {"": 20.0, "start": 60.0}  # recovery time to reach, by family; "" for all others
# Faults begin between these times: the robot has arrived, and drives on for AFTER_S.
_FIRST_S = 40.0
_LAST_S = 130.0
_BURST_S = 5.0
_LONG_S = 30.0
_FROM_START_S = 120.0
_WET = dict(radius_m=3.0, mu=0.9, kappa=0.3)


def _fault(kind, duration_s=_BURST_S, **fields):
    """A case: one fault of the sensors."""
    return {"fault": dict(fields, kind=kind, duration_s=duration_s)}


def _faults(name, unit, values, **fields):
    """Cases of a fault that differ in one field."""
    return {f"{value:g} {unit}": _fault(**{name: value}, **fields) for value in values}


FAMILIES = {
    "none": "none",
    "outage": "GNSS outage",
    "outlier": "single outlier",
    "burst": "burst of outliers, 5 s",
    "jump": "jump of the position, 5 s",
    "stuck": "stuck position",
    "latency": "latency of the position, 30 s",
    "rate": "fewer positions, 30 s",
    "encoders": "encoders, 5 s",
    "numbers": "no numbers, 5 s",
    "order": "order of samples, 30 s",
    "start": "start",
    "patch": "wet patch, κ = 0.3",
}
# {family: {case: what goes wrong}}: "fault" has fields of Fault, "patch" the wet soil ahead; all
# others are fields of Scenario.
CASES = {
    "none": {"no fault": {"fault": None}},
    "outage": _faults("duration_s", "s", (10.0, 30.0), kind="missing"),
    "outlier": _faults("size_m", "m", (1.0, 10.0), kind="outliers", duration_s=paper.DT_S),
    "burst": _faults("size_m", "m", (0.3, 10.0), kind="outliers"),
    "jump": _faults("size_m", "m", (0.3, 3.0), kind="jump"),
    "stuck": _faults("duration_s", "s", (3.0, 30.0), kind="stuck"),
    "latency": _faults("delay_s", "s", (0.6,), kind="latency", duration_s=_LONG_S),
    "rate": _faults("rate_hz", "Hz", (0.5,), kind="rate", duration_s=_LONG_S),
    "encoders": {
        "both missing": _fault("missing", channel="encoders"),
        "both dead": _fault("dead", channel="encoders"),
        "left dead": _fault("dead", channel="left"),
    },
    "numbers": {"all Inf": _fault("infinite", channel="all")},
    "order": {"time runs backwards": _fault("disorder", _LONG_S, channel="all")},
    "start": {
        "yaw 90° wrong": {"guess_yaw_rad": np.pi / 2},
        "yaw 180° wrong": {"guess_yaw_rad": np.pi},
        "5 m off": {"start_offset_m": 5.0},
        "reversed path": {"backwards": True},
    },
    "patch": {"forward": {"patch": _WET}, "backward": {"patch": _WET, "backwards": True}},
}


_ESTIMATORS = {"RHE": {}, "EKF": {"estimator": "ekf"}}
_ORACLE = {"oracle": {"estimator": "oracle"}}
# No estimator can do better than the oracle in these families.
_WITH_ORACLE = ("start", "patch")
_SHOWN = {"max_after_m": "largest true error afterwards [m]", "recovery_s": "time to recover [s]"}


def scenario(case, begin_s, base):
    """The scenario of a case of CASES whose fault begins at begin_s, added to the Scenario base."""
    fields = {name: value for name, value in case.items() if name not in ("fault", "patch")}
    if "fault" in case:
        faults = (Fault(start_s=begin_s, **case["fault"]),) if case["fault"] else ()
        duration_s = begin_s + sum(fault.duration_s for fault in faults) + AFTER_S
        return replace(base, **fields, faults=faults, duration_s=duration_s)
    if "patch" in case:  # it begins where the robot is at begin_s
        run = simulate(replace(base, **fields, duration_s=begin_s))
        ((x, y, _),) = run.path.poses(run.columns["s_m"][-1:] + case["patch"]["radius_m"])[0]
        patch = (float(x), float(y), *case["patch"].values())
        return replace(base, **fields, patches=(patch,), duration_s=begin_s + _FROM_START_S)
    return replace(base, **fields, duration_s=_FROM_START_S)


class Course(NamedTuple):
    """What is kept of a Run to judge it by.

    in_bounds says whether every command is finite and within its bound, and every estimate finite,
    μ and κ in [0, 1].
    """

    t_s: np.ndarray  # (samples,)
    error_m: np.ndarray  # (samples,) the true one
    is_wet: np.ndarray  # (samples,) whether the robot is on the scenario's patch
    in_bounds: bool


def course_of(run):
    """The Course of a Run."""
    columns = run.columns
    is_wet = np.zeros(len(columns["t_s"]), bool)
    for x, y, radius, *_ in run.scenario.patches:
        is_wet |= np.hypot(columns["x_m"] - x, columns["y_m"] - y) < radius
    estimates = ("_hat", "_hat_m", "_hat_rad", "_hat_mps")
    in_bounds = (
        all(np.isfinite(columns[name]).all() for name in columns if name.endswith(estimates))
        and np.all(np.abs(columns["omega_cmd_radps"]) <= run.scenario.omega_max_radps)
        and all(np.all((columns[k] >= 0) & (columns[k] <= 1)) for k in ("mu_hat", "kappa_hat"))
    )
    return Course(columns["t_s"], columns["error_true_m"], is_wet, bool(in_bounds))


def interval_s(course, case, begin_s):
    """When the fault of a case begins and ends; wet soil is a fault while the robot is on it."""
    if case.get("fault"):
        return begin_s, begin_s + case["fault"]["duration_s"]
    if "patch" in case:
        wet = course.t_s[course.is_wet]
        return float(wet[0]), float(wet[-1])
    return (begin_s, begin_s) if "fault" in case else (0.0, 0.0)


def response(course, begin_s, end_s):
    """How a robot responds to a fault from begin_s to end_s, a row of `study`.

    max_during_m and max_after_m are the largest true errors. recovery_s is the time from the end
    until the true error stays within the tolerance for 5 s, NaN if it never does. in_bounds is that
    of the Course.
    """
    t = course.t_s
    error = course.error_m
    # The small tolerance on time allows for rounding of multiples of 0.2 s.
    back = t[settled_samples(error)]
    back = back[back >= end_s - 1e-6]
    return dict(
        max_during_m=float(error[(t >= begin_s) & (t <= end_s + paper.DT_S)].max()),
        max_after_m=float(error[t >= end_s].max()),
        recovery_s=max(0.0, float(back[0] - end_s)) if len(back) else np.nan,
        in_bounds=course.in_bounds,
    )


def study(base, seeds, estimators, cases=CASES):
    """All cases on these seeds with each of the estimators, {name: fields of Scenario}.

    The DataFrame has one row a run: family, case, estimator, seed, begin_s, end_s and the
    `response`.
    """
    # The same fault begins elsewhere on the lap for every seed.
    begins_s = np.linspace(_FIRST_S, _LAST_S, len(seeds), endpoint=False).tolist()
    every = [
        dict(family=family, case=name, estimator=how, seed=seed, begin_s=begin_s)
        for family in cases
        for name in cases[family]
        for how in estimators
        for seed, begin_s in zip(seeds, begins_s)
    ]
    scenarios = [
        scenario(
            cases[of["family"]][of["case"]],
            of["begin_s"],
            replace(base, seed=of["seed"], **estimators[of["estimator"]]),
        )
        for of in every
    ]
    rows = []
    for of, driven in zip(every, map_runs(course_of, scenarios)):
        begin_s, end_s = interval_s(driven, cases[of["family"]][of["case"]], of["begin_s"])
        rows.append(of | dict(begin_s=begin_s, end_s=end_s) | response(driven, begin_s, end_s))
    return pd.DataFrame(rows)


def fault_table(table):
    """All cases in numbers: means over seeds, and whether every seed recovered in time.

    The errors [m] during and after the fault, and the recovery time [s] of the seeds that
    recovered, have a mean, low, high and largest each. `back` and `in_bounds` count seeds.
    """
    rows = []
    by_case = table.groupby(["family", "case", "estimator"], sort=False)
    for (family, case, estimator), runs in by_case:
        row = dict(family=FAMILIES[family], case=case, estimator=estimator, n=len(runs))
        for name in ("max_during_m", "max_after_m", "recovery_s"):
            over = over_seeds(np.mean, runs[name], least=0.0)
            row |= {name: over.mean, f"{name}_low": over.low, f"{name}_high": over.high}
            row[f"{name}_largest"] = runs[name].max()
        aim = _AIM_S.get(family, _AIM_S[""])
        row |= dict(back=runs["recovery_s"].count(), in_bounds=runs["in_bounds"].sum(), aim_s=aim)
        rows.append(row | dict(verdict=always(runs["recovery_s"] <= aim).verdict))
    return pd.DataFrame(rows)


def rhe_and_ekf(base, seeds):
    """The `fault_table` of all cases, added to the Scenario base, on so many fields.

    Returns:
        The table with RHE, EKF and oracle, and a dict of what made it, for the files.
    """
    limits = {name: CASES[name] for name in _WITH_ORACLE}
    runs = [study(base, range(seeds), _ESTIMATORS), study(base, range(seeds), _ORACLE, limits)]
    about = dict(scenario=base, estimators=_ESTIMATORS, seeds=f"0 to {seeds - 1}")
    return fault_table(pd.concat(runs)), about


def readable_fault_table(table):
    """The table of `fault_table` for readers: one row a case, one column an estimator and quantity.

    Cells are means over seeds with 95 % intervals; the last columns count the seeds that recovered.
    """
    cases = table["family"] + ": " + table["case"]
    parts = []
    for name, quantity in _SHOWN.items():
        part = pd.DataFrame(dict(measure=quantity, estimator=table["estimator"], quantity=cases))
        part["mean"] = table[name]
        part["low"] = table[f"{name}_low"]
        part["high"] = table[f"{name}_high"]
        parts.append(part)
    shown = readable(pd.concat(parts))
    recovered = table["back"].astype(str) + " of " + table["n"].astype(str)
    counts = table.assign(quantity=cases, recovered=recovered)
    counts = counts.pivot(index="quantity", columns="estimator", values="recovered")
    counts = counts.add_prefix("recovered, ").fillna("")
    return shown.join(counts)


def verdict_counts(table):
    """How many cases of `fault_table` have each verdict, and how many runs stay within bounds."""
    verdicts = table.pivot_table("case", "estimator", "verdict", aggfunc="count", fill_value=0)
    by_estimator = table.groupby("estimator")
    return verdicts.assign(
        cases=verdicts.sum(axis=1),
        runs=by_estimator["n"].sum(),
        in_bounds=by_estimator["in_bounds"].sum(),
    )
