"""One setting for seven worlds: constant speeds, the cautious controller, and the RHC that chooses
its speed.

Soil and sensors of a robot are not known beforehand, so that a promise of 0.12 m must hold in more
than one world, with one setting for all. The seven are changes of a base world of `rhec.WORLDS`.
Each drive is judged as in `rhec.workbench.studies.ensured`.
"""

import numpy as np
import pandas as pd

from rhec.simulation.worlds import WORLDS
from rhec.tracked_robot.tuned_loops import CAUTIOUS, OWN_SPEED, TUNED
from rhec.workbench.studies.ensured import SOILS, front
from rhec.workbench.studies.statistics import interval_text

__all__ = ["CHANGES", "CONTESTANTS", "compared", "readable", "worlds"]

# Each track slips on its own: three times the difference of the default world, or, where both
# tracks had the same soil, the default world's.
_OWN_SLIP = dict(
    default=dict(slip_difference=0.015), former=dict(soil_under="tracks", slip_difference=0.005)
)
CHANGES = ("as it is", "own slip of each track", "GNSS x 1.5", "90 % slow GNSS")
CHANGES += ("all real at once", "uncertain soil", "wet patches")
_PROPOSAL = TUNED["default"]["yaw_drift_ekf"] | dict(caution=0.0)
# {name: fields of Scenario}
CONTESTANTS = {
    "speed RHC": OWN_SPEED,
    "cautious, as it was": _PROPOSAL | dict(cautious=True),
    "cautious, tuned here": CAUTIOUS,
    "constant 0.3 m/s": _PROPOSAL | dict(speed_mps=0.3),
    "constant 0.5 m/s": _PROPOSAL,
}


def worlds(base):
    """The seven worlds, {change: fields of Scenario}.

    Args:
        base: "default" or "former", a name in `rhec.WORLDS`.
    """
    fields = WORLDS[base]
    slow_share = max(fields["gnss_slow_share"], 0.5)
    all_real = _OWN_SLIP[base] | dict(gnss_slow_share=slow_share, command_delay=1)
    all_real |= dict(bump_sigma_radps=1.5 * fields["bump_sigma_radps"])
    changes = (
        {},
        _OWN_SLIP[base],
        dict(gnss_sigma_m=1.5 * fields["gnss_sigma_m"]),
        dict(gnss_slow_share=0.9),
        all_real,
        SOILS["uncertain soil"],
        SOILS["wet patches"],
    )
    return {name: fields | change for name, change in zip(CHANGES, changes, strict=True)}


def compared(seeds, base="default", contestants=CONTESTANTS):
    """The table of `ensured.front` of all contestants in all seven worlds, on the same fields.

    Args:
        seeds: Of the fields.
        base: As of `worlds`.
        contestants: {name: fields of Scenario}.
    """
    drives = {
        (world, name, base, fields.get("speed_mps", WORLDS[base]["speed_mps"])): soil | fields
        for name, fields in contestants.items()
        for world, soil in worlds(base).items()
    }
    return front(drives, seeds).rename(columns=dict(soil="world", estimator="loop", mode="base"))


def readable(table):
    """The table of `compared` for readers: one row a world and loop.

    Returns:
        DataFrame: shares with 95 % intervals for the whole path and for corners on rows, the mean
        speed [m/s], the largest error [m], n.
    """
    shown = table.assign(
        share=[interval_text(*x) for x in zip(table["share"], table["low"], table["high"])]
    )
    keys = ["base", "world", "loop"]
    by_promise = shown.pivot_table("share", keys, "promise", aggfunc="first", sort=False)
    others = shown.drop_duplicates(keys).set_index(keys)
    speeds = [
        interval_text(*x)
        for x in zip(others["speed_mps"], others["speed_low"], others["speed_high"])
    ]
    return by_promise[["whole path", "corners on rows"]].join(
        pd.DataFrame(
            dict(speed_mps=speeds, worst_m=np.round(others["worst_m"], 3), n=others["n"]),
            index=others.index,
        )
    )
