"""What the robot does when its sensors, its start or the soil are not what they should be: the
cases, and how a run is judged.

A fault hits each seed somewhere else on the lap, on straights and in curves. It is over when the
sensors are well again, or the soil is; a wrong start is over at once. The robot is back when its
true error stays within the tolerance for 5 s.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from rhec import paper
from rhec.extensions.faults import Fault
from rhec.simulation import settled_samples, simulate
from rhec.studies.statistics import always, over_seeds

BEFORE_S, AFTER_S = 10.0, 60.0  # what is looked at around a fault
FIRST_S, LAST_S = (
    40.0,
    130.0,
)  # faults begin between these times: the robot has arrived, and drives on for AFTER_S
BURST_S, LONG_S, FROM_START_S = 5.0, 30.0, 120.0
AIM_S = {"": 20.0, "start": 60.0}  # to be back by then, by family, the others under ""
WET = dict(radius_m=3.0, mu=0.9, kappa=0.3)


def fault(**given):
    return {"fault": given}


# {family: {case: what is not as it should be}}: a fault of the sensors, a patch of soil ahead, or
# other fields of the scenario
CASES = {
    "none": {"no fault": {"fault": None}},
    "GNSS outage": {
        f"{s:g} s": fault(kind="missing", duration_s=s) for s in (1.0, 3.0, 10.0, 30.0)
    },
    "single outlier": {
        f"{m:g} m": fault(kind="outliers", size_m=m, duration_s=paper.DT_S)
        for m in (0.3, 1.0, 3.0, 10.0)
    },
    "burst of outliers, 5 s": {
        f"{m:g} m": fault(kind="outliers", size_m=m, duration_s=BURST_S)
        for m in (0.3, 1.0, 3.0, 10.0)
    },
    "jump of the position, 5 s": {
        f"{m:g} m": fault(kind="jump", size_m=m, duration_s=BURST_S) for m in (0.3, 1.0, 3.0, 10.0)
    },
    "stuck position": {
        f"{s:g} s": fault(kind="stuck", duration_s=s) for s in (1.0, 3.0, 10.0, 30.0)
    },
    "latency of the position, 30 s": {
        f"{s:g} s": fault(kind="latency", delay_s=s, duration_s=LONG_S)
        for s in (0.1, 0.2, 0.4, 0.6)
    },
    "fewer positions, 30 s": {
        f"{hz:g} Hz": fault(kind="rate", rate_hz=hz, duration_s=LONG_S) for hz in (2.5, 1.0, 0.5)
    },
    "encoders, 5 s": {"both missing": fault(kind="missing", channel="encoders", duration_s=BURST_S)}
    | {
        f"{which} dead": fault(kind="dead", channel=channel, duration_s=BURST_S)
        for which, channel in (("both", "encoders"), ("left", "left"), ("right", "right"))
    },
    "no numbers, 5 s": {
        "all NaN": fault(kind="missing", channel="all", duration_s=BURST_S),
        "all Inf": fault(kind="infinite", channel="all", duration_s=BURST_S),
    },
    "order of samples, 30 s": {
        "time runs backwards": fault(kind="disorder", channel="all", duration_s=LONG_S),
        "duplicates": fault(kind="duplicates", channel="all", duration_s=LONG_S),
    },
    "start": {
        "yaw 90° wrong": {"guess_yaw_rad": np.pi / 2},
        "yaw 180° wrong": {"guess_yaw_rad": np.pi},
        "5 m off": {"start_offset_m": 5.0},
        "reversed path": {"backwards": True},
    },
    "wet patch, κ = 0.3": {
        "forward": {"patch": WET},
        "backward": {"patch": WET, "backwards": True},
    },
}


def starts_s(n):
    """When the trouble begins [s] for each of n seeds: spread over the lap."""
    return np.linspace(FIRST_S, LAST_S, n, endpoint=False).tolist()


def scenario(case, begin_s, base):
    """The scenario `base` with the case's trouble from the time begin_s [s] on."""
    fields = {name: value for name, value in case.items() if name not in ("fault", "patch")}
    if "fault" in case:
        faults = (Fault(start_s=begin_s, **case["fault"]),) if case["fault"] else ()
        return replace(
            base,
            **fields,
            faults=faults,
            duration_s=begin_s + sum(each.duration_s for each in faults) + AFTER_S,
        )
    if "patch" in case:
        run = simulate(
            replace(base, **fields, duration_s=begin_s)
        )  # so that it lies where the robot will be
        ((x, y, _),) = run.path.poses(run.columns["s_m"][-1:] + case["patch"]["radius_m"])[0]
        patch = (float(x), float(y), *case["patch"].values())
        return replace(base, **fields, patches=(patch,), duration_s=begin_s + FROM_START_S)
    return replace(base, **fields, duration_s=FROM_START_S)


def interval_s(run, case, begin_s):
    """From when to when [s] the trouble lasts."""
    if run.scenario.faults:
        return begin_s, run.scenario.faults[0].end_s
    if run.scenario.patches:
        ((x, y, radius, *_),) = run.scenario.patches
        wet = run.columns["t_s"][np.hypot(run.columns["x_m"] - x, run.columns["y_m"] - y) < radius]
        return float(wet[0]), float(wet[-1])
    return (begin_s, begin_s) if "fault" in case else (0.0, 0.0)


def response(run, begin_s, end_s):
    """What the robot did about trouble between these times [s]: errors in m, times in s.

    recovery_s: from its end until the true error stays within the tolerance for 5 s, NaN if it
    never does. in_bounds: every command is finite and keeps its bound, every estimate is finite,
    with μ and κ in [0, 1].
    """
    t, error = run.columns["t_s"], run.columns["error_true_m"]
    during, after = (t >= begin_s) & (t <= end_s + paper.DT_S), t >= end_s
    back = t[settled_samples(error)]
    back = back[back >= end_s - 1e-6]
    command, traction = (
        run.columns["omega_cmd_radps"],
        np.stack([run.columns["mu_hat"], run.columns["kappa_hat"]]),
    )
    finite = all(
        np.isfinite(run.columns[name]).all()
        for name in run.columns
        if name.endswith(("_hat", "_hat_m", "_hat_rad", "_hat_mps"))
    )
    in_bounds = (
        finite
        and np.all(np.abs(command) <= run.scenario.omega_max_radps)
        and np.all((traction >= 0) & (traction <= 1))
    )
    return dict(
        max_during_m=float(error[during].max()),
        max_after_m=float(error[after].max()),
        recovery_s=max(0.0, float(back[0] - end_s)) if len(back) else np.nan,
        in_bounds=bool(in_bounds),
    )


def study(base, seeds, handling, cases=CASES):
    """All cases on these seeds, each with every way of `handling` ({name: Scenario fields}).

    Returns a DataFrame, one row a run (family, case, handling, seed, begin_s, end_s and the
    `response`), and the true errors over time, {(family, case, handling): (seeds, samples)}, from
    BEFORE_S before the trouble begins to AFTER_S after it ends, NaN beyond.
    """
    rows, errors = [], {}
    for family, of_family in cases.items():
        for name, case in of_family.items():
            for how, fields in handling.items():
                curves = []
                for seed, begin_s in zip(seeds, starts_s(len(seeds))):
                    run = simulate(scenario(case, begin_s, replace(base, seed=seed, **fields)))
                    begin_s, end_s = interval_s(run, case, begin_s)
                    rows.append(
                        dict(
                            family=family,
                            case=name,
                            handling=how,
                            seed=seed,
                            begin_s=begin_s,
                            end_s=end_s,
                        )
                        | response(run, begin_s, end_s)
                    )
                    first, last = (
                        round((time + shift) / paper.DT_S)
                        for time, shift in ((begin_s, -BEFORE_S), (end_s, AFTER_S))
                    )
                    curves.append(
                        np.pad(
                            run.columns["error_true_m"][max(first, 0) : last],
                            (max(-first, 0), 0),
                            constant_values=np.nan,
                        )
                    )
                length = max(map(len, curves))
                errors[family, name, how] = np.stack(
                    [
                        np.pad(curve, (0, length - len(curve)), constant_values=np.nan)
                        for curve in curves
                    ]
                )
    return pd.DataFrame(rows), errors


def fault_table(table, aim_s=AIM_S):
    """All cases in numbers: means over seeds, and whether every seed was back within the aim.

    Args:
        table: of `study`.
        aim_s: {family: [s]}, the aim of the others under "".

    Returns:
        DataFrame with columns family, case, handling, n; for the errors [m] during the trouble and
        from its end on and for the recovery time [s] of the seeds that came back: mean, low, high,
        largest; back (seeds), in_bounds (seeds), aim_s, verdict.
    """
    rows = []
    for (family, case, handling), runs in table.groupby(["family", "case", "handling"], sort=False):
        row = dict(family=family, case=case, handling=handling, n=len(runs))
        for name in ("max_during_m", "max_after_m", "recovery_s"):
            found = over_seeds(np.mean, runs[name])
            row |= {
                name: found.mean,
                f"{name}_low": found.low,
                f"{name}_high": found.high,
                f"{name}_largest": runs[name].max(),
            }
        aim = aim_s.get(family, aim_s[""])
        row |= dict(back=runs["recovery_s"].count(), in_bounds=runs["in_bounds"].sum(), aim_s=aim)
        rows.append(row | dict(verdict=always(runs["recovery_s"] <= aim).verdict))
    return pd.DataFrame(rows)
