"""One setting in seven worlds: what each world changes, and what the table counts."""

import numpy as np

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
