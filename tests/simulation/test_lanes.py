"""Runs side by side in lanes have the bits of runs one by one, whatever each of them does."""

import concurrent.futures
import dataclasses

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from condensed_rhc import controller
from loops import SMALL, lanes_as_in_use, unlike
from own_steps import untraceable

import rhec
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core.lanes import lanes
from rhec.simulation import closed_loop
from rhec.simulation.campaigns import batch
from rhec.simulation.campaigns import campaign as campaigns

pytestmark = pytest.mark.skipif(lanes.cpp_compiler() is None, reason="there is no C++ compiler")


# Campaigns


@pytest.fixture
def always(monkeypatch):
    """Lanes for campaigns of any size."""
    monkeypatch.setattr(batch, "_WORTH_COMPILING", 0)


def assert_rows_of_simulate(table, scenarios):
    for (_, row), scenario in zip(table.iterrows(), scenarios):
        for name, value in rhec.simulate(scenario).metrics.items():
            assert row[name] == value or np.isnan(row[name]) and np.isnan(value), name


def test_a_campaign_in_lanes_has_the_rows_of_simulate(always, monkeypatch):
    """Several structures in any order, groups that fill no register, runs of unlike length."""
    loops = [dataclasses.replace(SMALL, estimator=name) for name in ("rhe", "ekf")]
    scenarios = [
        dataclasses.replace(each, duration_s=each.duration_s + 4 * (each.seed % 2))
        for each in (each for both in zip(*map(unlike, loops)) for each in both)
    ]
    monkeypatch.setattr(campaigns, "simulate", lambda scenario: 1 / 0)
    table = rhec.campaign(scenarios, workers=1)
    assert (table["error"] == "").all()
    assert_rows_of_simulate(table, scenarios)


def test_lanes_are_compiled_for_each_loop_of_many_runs(monkeypatch):
    monkeypatch.setattr(batch, "_WORTH_COMPILING", 20 * batch.count_samples(SMALL))
    few = [dataclasses.replace(SMALL, estimator=name) for name in ("ekf", "oracle", "bounded_ekf")]
    many = [dataclasses.replace(SMALL, seed=seed) for seed in range(20)]
    for scenarios, chosen in (
        (many[1:], []),
        (many[1:] + few, []),
        (few + many, ["rhe"]),
        ([dataclasses.replace(each, estimator="ekf") for each in many] + many, ["ekf", "rhe"]),
    ):
        plan = batch.Plan(dict(enumerate(scenarios)))
        assert [one.estimator for one in plan.worth_lanes()] == chosen


def test_a_run_that_fails_leaves_the_others_in_their_lanes(always, monkeypatch):
    """So does one whose QP solver's C is no C++ for lanes, and one that is too long for memory."""
    monkeypatch.setattr(batch, "_MAX_SAMPLES_IN_MEMORY", 8 * batch.count_samples(SMALL))
    good = [*unlike(SMALL)][:2]
    others = [
        dataclasses.replace(SMALL, path=untraceable()),
        dataclasses.replace(SMALL, controller=controller(SMALL, "daqp")),
        dataclasses.replace(SMALL, duration_s=5 * SMALL.duration_s),
    ]
    alone = []
    simulate = campaigns.simulate
    monkeypatch.setattr(campaigns, "simulate", lambda each: alone.append(each) or simulate(each))
    table = rhec.campaign([good[0], *others, good[1]], workers=1)
    assert list(table["error"] == "") == [True, False, True, True, True]
    assert len(alone) == 3 and all(each in alone for each in others)
    assert_rows_of_simulate(table[::4], good)


def build_wrong_loop(*structure):
    raise ZeroDivisionError("a mistake")


OURS = [(runner, "run"), (closed_loop, "finished"), (closed_loop, "noise_and_faults")]


@pytest.mark.parametrize(("place", "name"), [*OURS, (closed_loop, "build_sample")])
def test_an_error_of_ours_does_not_turn_into_slower_runs(
    always, monkeypatch, tmp_path, place, name
):
    """Nor is one in a loop taken for one of its compiler."""
    if name == "build_sample":
        monkeypatch.setenv("RHEC_CACHE", str(tmp_path))
    else:
        lanes.load(closed_loop.build_sample, *closed_loop.set_up(SMALL).structure)
    monkeypatch.setattr(place, name, build_wrong_loop)
    with pytest.raises(ZeroDivisionError):
        rhec.campaign([*unlike(SMALL)], workers=1)


def test_a_helper_on_one_line_takes_no_other_helper_with_it():
    """Of CasADi's C `sign` has one line; `norm_inf` may follow it."""
    x = ca.MX.sym("x", 3)
    found = ca.vertcat(ca.sign(x), ca.norm_inf(x), ca.norm_inf(ca.sign(x)))
    memory, stream = ca.MX.sym("memory"), ca.MX.sym("stream", 3)
    function = ca.Function("found", [x], [found])
    step = ca.Function("step", [memory, stream], [memory, function(stream)])
    text = lanes.cpp_text(step)
    assert "casadi_norm_inf(casadi_int n" in text and "casadi_sign(casadi_real x)" not in text


def test_what_differs_in_seed_and_soil_alone_is_set_up_once_with_the_same_runs(always, monkeypatch):
    own = rhec.Terrain.uniform(0.9, 0.7), rhec.Terrain.uniform(0.7, 0.9)
    kinds = [dict(q=(1.0, 1.0, 10.0)), dict(terrain=own[0])]
    kinds += [dict(start_offset_m=offset) for offset in (0.0, -0.0)]
    every = [*kinds, dict(terrain=own[1])]
    scenarios = [
        dataclasses.replace(SMALL, **kind, seed=seed) for seed in range(3) for kind in every
    ]
    set_up, made = closed_loop.set_up, []
    monkeypatch.setattr(closed_loop, "set_up", lambda each: made.append(each) or set_up(each))
    runs = rhec.simulate(scenarios)
    assert len(made) == len(kinds) + 1  # one tells which lanes to compile
    for run, alone in zip(runs, map(rhec.simulate, scenarios)):
        pd.testing.assert_frame_equal(run.log, alone.log, check_exact=True)
        np.testing.assert_equal(dataclasses.asdict(run.terrain), dataclasses.asdict(alone.terrain))
        np.testing.assert_equal(run.metrics, alone.metrics)


def test_few_runs_take_lanes_where_their_own_loop_is_not_compiled(monkeypatch):
    scenarios = [*unlike(SMALL)]
    alone = [*map(rhec.simulate, scenarios)]
    lanes.load(closed_loop.build_sample, *closed_loop.set_up(SMALL).structure)
    monkeypatch.setattr(compiled, "is_compiled", lambda *what: False)
    monkeypatch.setattr(closed_loop, "simulate_setup", lambda *scenario_and_setup: 1 / 0)
    for run, before in zip(rhec.simulate(scenarios), alone, strict=True):
        pd.testing.assert_frame_equal(run.log, before.log)


@pytest.mark.nightly
def test_without_a_cpp_compiler_the_rows_are_the_same(always, monkeypatch):
    scenarios = [*unlike(SMALL)]
    table = rhec.campaign(scenarios, workers=1)
    monkeypatch.setattr(lanes, "cpp_compiler", lambda: None)
    lanes.load.cache_clear()
    assert rhec.campaign(scenarios, workers=1).equals(table)
    lanes.load.cache_clear()


def test_another_processor_has_another_library(monkeypatch):
    here = lanes.library_name(build_functions, ())
    compiler, macros = lanes.cpp_compiler()
    monkeypatch.setattr(
        lanes, "cpp_compiler", lambda: (compiler, macros + "#define __AVX1024F__ 1")
    )
    assert lanes.library_name(build_functions, ()) != here


# Elementary functions


def build_functions():
    """A scan whose row is what a loop may use of an input x."""
    memory, x = ca.SX.sym("memory"), ca.SX.sym("x")
    rows = ca.vertcat(
        ca.sin(x), ca.cos(x), ca.floor(x), ca.fabs(x), ca.fmin(x, memory), ca.fmax(memory, x),
        ca.sqrt(ca.fabs(x)), ca.exp(-ca.fabs(x)), ca.if_else(x < 1, ca.tan(x), ca.log(x)),
        ca.atan2(x, 1 - ca.fabs(x)),
    )  # fmt: skip
    near = ca.Function("near", [memory, x], [memory, ca.vertcat(rows, memory)])
    far = ca.Function("far", [memory, x], [x, ca.vertcat(rows, 2 * x)])
    chosen = ca.Function.if_else("chosen", near, far)
    memory, x = ca.MX.sym("memory"), ca.MX.sym("x")
    found = chosen(ca.fabs(x - memory) < 1, memory, x)
    sample = [memory, x], [*found], ["memory_in", "x"], ["memory_out", "row"]
    return runner.build(ca.Function("sample", *sample))


def angles(n):
    rng = np.random.default_rng(7)
    quarters = rng.integers(-600_000, 600_000, n) * (np.pi / 2)
    some = [rng.uniform(-scale, scale, n) for scale in (1.0, 700.0, 1e6)]
    return np.concatenate([*some, rng.normal(size=n), quarters])


def test_own_functions_are_within_a_few_units_in_the_last_place():
    x = angles(20_000)
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no number here is longer than a double")
    rows = runner.run_one(compiled.load(build_functions), np.array([np.nan]), x[:, None], {})
    x, beside = x.astype(np.longdouble), (1 - np.abs(x)).astype(np.longdouble)
    known = {0: (np.sin(x), 2), 1: (np.cos(x), 2), 9: (np.arctan2(x, beside), 3)}
    known[7] = (np.exp(-np.abs(x)), 1)
    for column, (exact, units) in known.items():
        off = np.abs(rows[:, column] - exact)
        assert np.max(off / np.spacing(np.abs(exact).astype(float))) <= units


@pytest.mark.parametrize("load", (lanes.load, lanes_as_in_use))
def test_whatever_the_number_a_lane_has_the_bits_of_the_scalar(load):
    """Of more runs than there are lanes, of unlike lengths."""
    x = angles(500)
    extremes = [0.0, np.nan, np.inf, 1e6, 1e300, 5e-324, 1.5, 2.0**51, 2.0**52 + 1, 3.0]
    x = np.concatenate([x, extremes, np.negative(extremes), np.arange(20) / 4])
    streams = [np.random.default_rng(run).permutation(x)[:, None] for run in range(9)]
    streams = [stream[-len(stream) * run // 9 :] for run, stream in enumerate(streams, 1)]
    memories, settings = np.arange(9.0)[:, None], [{}] * 9
    functions, block = compiled.load(build_functions), load(build_functions)
    at_once = runner.run(block, memories, streams, settings)
    one_by_one = [runner.run_one(functions, *run, {}) for run in zip(memories, streams)]
    for rows, alone in zip(at_once, one_by_one, strict=True):
        np.testing.assert_array_equal(rows, alone)
    virtual = runner.run_one(build_functions(), memories[-1], streams[-1], {})
    near = np.abs(streams[-1][:, 0]) < 1e5
    np.testing.assert_allclose(one_by_one[-1][near], virtual[near], rtol=1e-12, atol=1e-15)


@pytest.mark.nightly
def test_threads_do_not_meet_in_a_block():
    block, x = lanes.load(build_functions), angles(500)
    memories, settings = np.arange(2.0)[:, None], [{}] * 2
    streams = [np.stack([x, x[::-1]])[..., None] + thread for thread in range(8)]
    alone = [runner.run(block, memories, stream, settings) for stream in streams]
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        found = pool.map(lambda stream: runner.run(block, memories, stream, settings), streams * 5)
    for number, rows in enumerate(found):
        np.testing.assert_array_equal(rows, alone[number % 8])
