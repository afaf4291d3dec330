"""One setting in seven worlds: what each world changes, and what the table counts."""

from math import comb

import numpy as np
import pandas as pd

import rhec
from rhec.workbench.studies import ensured, seven_worlds

SHORT = dict(row_length_m=6.0, headland_radius_m=6.0, start_offset_m=0.1)


def test_each_world_is_its_base_but_for_what_its_name_says():
    for base in ("default", "former"):
        worlds = seven_worlds.worlds(base)
        assert [*worlds] == [*seven_worlds.CHANGES]
        own = rhec.WORLDS[base]
        assert worlds["as it is"] == own
        assert worlds["GNSS x 1.5"] == own | dict(gnss_sigma_m=1.5 * own["gnss_sigma_m"])
        assert worlds["90 % slow GNSS"] == own | dict(gnss_slow_share=0.9)
        slip = worlds["own slip of each track"]
        assert slip["soil_under"] == "tracks"
        assert slip["slip_difference"] > own["slip_difference"]
        every = worlds["all real at once"]
        assert every["slip_difference"] == slip["slip_difference"]
        assert every["gnss_slow_share"] >= 0.5
        assert every["command_delay"] == 1
        for fields in worlds.values():
            rhec.Scenario(**fields)


def test_the_table_counts_the_laps_of_each_world_and_loop():
    oracle = SHORT | dict(estimator="oracle")
    contestants = {
        "own": oracle | dict(controller="speed_rhc", r=0.01),
        "slow": oracle | dict(speed_mps=0.3),
    }
    table = seven_worlds.compared(range(2), "former", contestants)
    assert len(table) == 7 * 2 * len(ensured.PROMISES)
    assert set(table["n"]) == {2}
    shown = seven_worlds.readable(table)
    assert len(shown) == 14
    slow = table[(table["loop"] == "slow") & (table["world"] == "as it is")]
    world = seven_worlds.worlds("former")["as it is"]
    laps = [
        ensured.lap(
            rhec.simulate(rhec.Scenario(**world | contestants["slow"], seed=k, duration_s=300.0))
        )
        for k in range(2)
    ]
    whole = slow.set_index("promise")["share"]["whole path"]
    assert whole == np.mean([lap.whole for lap in laps])
    assert np.allclose(slow["speed_mps"], np.mean([lap.speed_mps for lap in laps]))


def test_counting_laps_gives_the_table_of_front():
    contestants = {"slow": SHORT | dict(estimator="oracle", speed_mps=0.3)}
    laps = seven_worlds.laps(range(2), "former", contestants)
    assert len(laps) == 7 * 2 and set(laps["seed"]) == {0, 1}
    table = seven_worlds.compared(range(2), "former", contestants)
    counted = seven_worlds.counted(laps)
    pd.testing.assert_frame_equal(counted, table[counted.columns], check_like=True)


def test_docs_say_which_loop_keeps_the_promise_in_all_seven_worlds():
    laps = pd.read_parquet(seven_worlds.LAPS)
    counted = seven_worlds.counted(laps[laps["base"] == "default"])
    whole = counted[counted["promise"] == "whole path"].set_index(["loop", "world"])
    speed_rhc, cautious = seven_worlds.TUNED_HERE
    assert (whole.loc[cautious, "low"] > 0.95).all() and (whole.loc[cautious, "n"] == 1000).all()
    kept = whole.loc[speed_rhc, "low"] > 0.95
    assert kept.sum() == 6 and not kept["uncertain soil"]


def drives(one, other):
    """Laps of two loops in one world, which keep every promise where told."""
    rows = [
        dict(base="default", world="wet patches", loop=loop, seed=seed, error_m=np.nan)
        | dict.fromkeys(ensured.PROMISES, kept)
        for loop, all_kept in (("a", one), ("b", other))
        for seed, kept in enumerate(all_kept)
    ]
    return pd.DataFrame(rows)


def test_pairs_count_the_fields_in_which_one_loop_alone_keeps_a_promise():
    one = [True] * 9 + [False] * 3
    other = [False] * 7 + [True] * 2 + [True, False, False]
    table = seven_worlds.paired(drives(one, other), "a", "b")
    assert [*table["promise"]] == [*ensured.PROMISES.values()]
    assert set(table["only a"]) == {7} and set(table["only b"]) == {1} and set(table["n"]) == {12}
    # Two-sided: 0, 1, 7 or 8 of 8 coins on one side.
    assert np.allclose(table["p"], 2 * (comb(8, 0) + comb(8, 1)) / 2**8)
    same = seven_worlds.paired(drives(one, one), "a", "b")
    assert (same["p"] == 1).all() and not same[["only a", "only b"]].any(axis=None)


def test_the_kept_laps_are_those_that_the_study_drives():
    laps = pd.read_parquet(seven_worlds.LAPS)
    assert set(laps["loop"]) == {*seven_worlds.CONTESTANTS}
    assert not laps.duplicated(["base", "world", "loop", "seed"]).any()
    tuned = laps[laps["loop"].isin(seven_worlds.TUNED_HERE)]
    fields = tuned.groupby(["base", "world", "loop"])["seed"].agg(["nunique", "min", "max"])
    assert len(fields) == 2 * 7 * 2 and (fields.nunique() == 1).all()
