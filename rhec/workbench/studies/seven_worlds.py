"""One setting for seven worlds: constant speeds, the cautious controller, and the RHC that chooses
its speed.

Soil and sensors of a robot are not known beforehand, so that a promise of 0.12 m must hold in more
than one world, with one setting for all. The seven are changes of a base world of `rhec.WORLDS`.
Each drive is judged as in `rhec.workbench.studies.ensured`.

    python -m rhec.workbench.studies.seven_worlds

drives them all (half an hour on two cores) and writes `data/seven_worlds.parquet`. From this file
`rhec.workbench.results` writes the tables of `docs/closer_to_the_limit.md`.
"""

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from rhec.simulation.scenario import Scenario
from rhec.simulation.worlds import WORLDS
from rhec.tracked_robot.tuned_loops import CAUTIOUS, OWN_SPEED, TUNED
from rhec.workbench.studies import ensured
from rhec.workbench.studies.ensured import SOILS, front
from rhec.workbench.studies.statistics import interval_text

__all__ = ["CHANGES", "CONTESTANTS", "LAPS", "compared", "counted", "laps", "paired", "readable"]
__all__ += ["TUNED_HERE", "worlds"]

LAPS = Path(__file__).parents[3] / "data/seven_worlds.parquet"

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
TUNED_HERE = ("speed RHC", "cautious, tuned here")
# Held-out fields of each world.
_FIELDS = 1000  # of TUNED_HERE
_FIELDS_OF_OTHERS = 200


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


def laps(seeds, base="default", contestants=CONTESTANTS):
    """Each lap of contestants in the seven worlds, on the same fields.

    Args:
        seeds: Of the fields.
        base: As of `worlds`.
        contestants: {name: fields of Scenario}.

    Returns:
        DataFrame, one row a lap: base, world, loop, seed, and the columns of `ensured.laps`.
    """
    in_worlds = worlds(base)
    rows = [*itertools.product([base], in_worlds, contestants, seeds)]
    scenarios = [
        Scenario(seed=seed, **in_worlds[world] | contestants[name]) for _, world, name, seed in rows
    ]
    about = pd.DataFrame(rows, columns=["base", "world", "loop", "seed"])
    return about.join(ensured.laps(scenarios))


def counted(laps):
    """The table of `ensured.front` of laps.

    Args:
        laps: DataFrame of `laps`, of one base or of several.

    Returns:
        DataFrame with the columns base, world, loop, and those of `ensured.front` from `promise`.
    """
    keys = ["base", "world", "loop"]
    return pd.DataFrame(
        dict(zip(keys, labels)) | row
        for labels, of_drive in laps.groupby(keys, sort=False)
        for row in ensured.kept(of_drive)
    )


def paired(laps, one, other):
    """How often only one of two loops keeps a promise on the same field.

    Args:
        laps: DataFrame of `laps`.
        one, other: Names of loops.

    Returns:
        DataFrame, one row for each base, world and promise: how many fields only `one` keeps and
        only `other`, p (two-sided, exact, by McNemar, of this comparison alone), and n.
    """
    fields = ["base", "world", "seed"]
    wide = laps.pivot(index=fields, columns="loop", values=[*ensured.PROMISES])
    wide = wide.swaplevel(axis="columns")[[one, other]].dropna()
    rows = []
    for base, world in laps[["base", "world"]].drop_duplicates().itertuples(index=False):
        both = wide.loc[base, world]
        for promise, words in ensured.PROMISES.items():
            first, second = (both[loop, promise].astype(bool) for loop in (one, other))
            only = int((first & ~second).sum()), int((second & ~first).sum())
            p = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
            about = dict(base=base, world=world, promise=words, n=len(both))
            rows.append(about | {f"only {one}": only[0], f"only {other}": only[1], "p": p})
    return pd.DataFrame(rows)


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


def _main():
    """Write LAPS."""
    two = {name: CONTESTANTS[name] for name in TUNED_HERE}
    others = {name: fields for name, fields in CONTESTANTS.items() if name not in two}
    parts = [laps(range(_FIELDS), base, two) for base in _OWN_SLIP]
    parts.append(laps(range(_FIELDS_OF_OTHERS), "default", others))
    pd.concat(parts, ignore_index=True).to_parquet(LAPS, index=False)


if __name__ == "__main__":
    _main()
