"""Many runs in one process: several at a time, one in each lane of the processor's registers."""

import contextlib
import functools
import itertools
import operator
from dataclasses import replace

from rhec import paper
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.simulation.campaigns.store import PLAIN
from rhec.simulation.lanes import lanes
from rhec.tracked_robot import terrain

__all__ = [
    "compile_lanes",
    "in_parts",
    "n_samples",
    "run_each",
    "run_in_lanes",
    "samples_alike",
    "simulate_all",
    "size_of_task",
    "to_compile",
]

# Samples of runs alike that pay for compiling lanes, and for using them where they are compiled.
_WORTH_COMPILING = 400_000
_WORTH_USING = 10_000
# Closed-loop samples in one task: about a second of work, which is also what an interruption loses.
_TASK = 40_000
_TASK_IN_LANES = 400_000
# lanes, and samples of all of them
_MOST_LANES = 8
_MOST_IN_MEMORY = 200_000

# What nearly always decides alone which compiled loop a scenario runs.
_ALIKE = operator.attrgetter(
    "estimator",
    "estimation_horizon",
    "speed_model",
    "arrival_mean",
    "robust",
    "prediction_horizon",
    "qp",
    "input_reference",
    "cautious",
)


def _all_but_seed(scenario):
    """What two scenarios have in common that differ in their seed alone, while both are there."""
    given = vars(scenario) | dict(seed=None)
    return repr([each if type(each) in PLAIN else id(each) for each in given.values()])


def n_samples(scenario):
    """How many samples a run of the scenario has."""
    return round(scenario.duration_s / paper.DT_S)


def samples_alike(scenarios):
    """How many samples of these scenarios there are, on average, for each compiled loop."""
    return sum(map(n_samples, scenarios)) / len({*map(_ALIKE, scenarios)})


def size_of_task(alike):
    """How many samples make a task."""
    return _TASK_IN_LANES if alike >= _WORTH_COMPILING else _TASK


def in_parts(scenarios, samples):
    """Cut {key: scenario} into parts of about so many samples, otherwise in the order given.

    Near each other are as many seeds as there are lanes, whose runs share fields and noise, and
    among their runs those that share a loop, and all but the seed.
    """
    known = {}
    families = {}
    seeds = {}
    places = {}
    for key, scenario in scenarios.items():
        seed = seeds.setdefault(scenario.seed, len(seeds))
        loop = known.setdefault(_ALIKE(scenario), len(known))
        family = families.setdefault(_all_but_seed(scenario), len(families))
        places[key] = seed // _MOST_LANES, loop, family, seed

    ordered = sorted(scenarios.items(), key=lambda item: places[item[0]])
    before = itertools.accumulate((n_samples(each) for _, each in ordered), initial=0)
    parts = itertools.groupby(zip(before, ordered), lambda each: each[0] // samples)
    return (dict(item for _, item in part) for _, part in parts)


def to_compile(scenarios, alike):
    """One of the scenarios for each loop, if they pay for compiling lanes."""
    pays = alike >= _WORTH_COMPILING
    return {_ALIKE(scenario): scenario for scenario in scenarios}.values() if pays else ()


def compile_lanes(scenario):
    """Compile the loop of a scenario for lanes; what cannot be is found out again when it runs."""
    with contextlib.suppress(Exception):
        lanes.load(closed_loop.build_sample, *closed_loop.set_up(scenario).structure)


def run_in_lanes(scenarios, alike, of=operator.attrgetter("metrics")):
    """{key: `of` its Run} of those of the scenarios {key: scenario} that lanes can run.

    Not those that fail: `simulate` says why. alike: see `samples_alike`, of the whole campaign.
    """
    blocks = {}
    waiting = {}
    done = {}
    setups = {}
    last = functools.lru_cache(4 * _MOST_LANES)  # of the seeds near each other, not of a whole part
    noise = last(closed_loop.noise_and_faults)
    on_soil = last(terrain.settings)
    for key, scenario in scenarios.items():
        with contextlib.suppress(Exception):
            family = _all_but_seed(scenario)
            samples = n_samples(scenario)
            setup = setups[family] = _set_up(scenario, setups.get(family), on_soil)
            if setup.structure not in blocks:
                blocks[setup.structure] = _block(setup.structure, alike)
            block = blocks[setup.structure]
            if block and samples * block.lanes <= _MOST_IN_MEMORY:  # all in memory
                group = waiting.setdefault((setup.structure, samples), {})
                group[key] = scenario, setup
                if len(group) == block.lanes:
                    done |= _run(block, samples, waiting.pop((setup.structure, samples)), noise, of)
    for (structure, samples), group in waiting.items():
        with contextlib.suppress(Exception):
            done |= _run(blocks[structure], samples, group, noise, of)
    return done


def _set_up(scenario, alike, on_soil):
    """`closed_loop.set_up`, from the Setup of one alike but for its seed, if there is one."""
    if alike is None:
        return closed_loop.set_up(scenario)
    soil = scenario.terrain or terrain.random_for(scenario, alike.path)
    settings = alike.settings | on_soil(soil, alike.structure.terrain_shape)
    return replace(alike, settings=settings, terrain=soil)


def run_each(scenarios, alike, of):
    """`of` the Run of each of the scenarios, in their order, those that lanes cannot run included.

    of: of a Run, something that is true. alike: see `samples_alike`.
    """
    found = run_in_lanes(dict(enumerate(scenarios)), alike, of)
    return [found.get(k) or of(closed_loop.simulate(each)) for k, each in enumerate(scenarios)]


def simulate_all(scenarios):
    """The Runs of the scenarios, in their order; several at a time where lanes are compiled."""
    return run_each(scenarios, samples_alike(scenarios), lambda run: run)


def _block(structure, alike):
    """The compiled lanes of a structure, or None where there are none or they do not pay, as they
    do even for few runs if these would have to wait for their own loop to be compiled.
    """
    sample = closed_loop.build_sample, *structure
    few = alike < _WORTH_USING and compiled.is_compiled(*sample)
    pays = alike >= _WORTH_COMPILING or not few and lanes.is_compiled(*sample)
    return lanes.load(*sample) if pays else None


def _run(block, samples, group, noise, of):
    """{key: `of` its Run} of {key: (scenario, setup)}, of one structure and length."""
    scenarios, setups = zip(*group.values())
    streams = [noise(each.seed, each.faults, samples) for each in scenarios]
    memories = [each.memory for each in setups]
    settings = [each.settings for each in setups]
    rows = lanes.scan(block, memories, streams, settings)
    runs = map(closed_loop.finish, scenarios, setups, rows)
    return {key: of(run) for key, run in zip(group, runs)}
