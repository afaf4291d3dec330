"""Many runs in one process: several at a time, one per SIMD lane, if that is faster."""

import collections
import contextlib
import functools
import itertools
import operator
from array import array
from dataclasses import replace

import numpy as np

from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core.lanes import lanes
from rhec.simulation import closed_loop
from rhec.simulation.blocks import blocks_of
from rhec.simulation.campaigns.store import PLAIN
from rhec.tracked_robot import terrain

# Compiling lanes takes up to eight seconds and pays from this number of samples per loop structure.
_WORTH_COMPILING = 150_000
# Loops share the parts that take longest to compile. So where those of a campaign reach that number
# together, lanes pay from this part of it: they take a second or two, as the loop of one run does.
_PART_OF_A_LOOP = 1 / 3
# Loading compiled lanes pays from this number of samples per loop structure.
_WORTH_LOADING = 10_000
# Samples in one task. A task takes about a second, which is the work that an interruption loses.
_TASK = 40_000
_TASK_IN_LANES = 400_000
# Runs of this many seeds share fields and noise: as many as AVX-512 registers have lanes.
_SEEDS_TOGETHER = 8
# Largest number of samples of all lanes; longer runs are simulated one by one to limit the memory.
_MAX_SAMPLES_IN_MEMORY = 200_000
# What `closed_loop.set_up` raises for a scenario that cannot be run, such as one with too large a
# field. `rhec.simulate` raises it again and is asked for the reason. All else is an error of ours.
_NO_SETUP = ValueError, MemoryError


def _all_but_soil(scenario):
    """Return a text that is equal for scenarios that differ only in their seeds and terrains.

    Terrains must have equally large grids. Arrays and other objects are compared by identity, so
    the text is valid only while the scenarios exist.
    """
    soil = scenario.terrain and terrain.common_shape(scenario.terrain)
    values = (vars(scenario) | dict(seed=None, terrain=soil)).values()
    return repr([value if type(value) in PLAIN else id(value) for value in values])


def count_samples(scenario):
    """Return the number of samples of a run of the scenario."""
    return round(scenario.duration_s / paper.DT_S)


def _loops(scenarios):
    """Yield the blocks of each scenario's loop, but for the sizes of its path and soil.

    Those take time to find, and nearly all loops agree in them. Equal loops are one object.
    """
    families = {}
    loops = {}
    for scenario in scenarios:
        family = _all_but_soil(scenario)
        if family not in families:
            loop = blocks_of(scenario)
            families[family] = loops.setdefault(loop, loop)
        yield families[family]


def mean_samples_per_structure(scenarios):
    """Return the mean number of samples of the scenarios per compiled loop."""
    return sum(map(count_samples, scenarios)) / len({*_loops(scenarios)})


def samples_per_task(mean_samples):
    """Return the number of samples of a task, from `mean_samples_per_structure`."""
    return _TASK_IN_LANES if mean_samples >= _WORTH_COMPILING else _TASK


def split_into_tasks(scenarios, samples):
    """Yield parts of {key: scenario} with about this number of samples.

    Runs that share work become neighbours: they are sorted by groups of seeds, which share fields
    and noise, then by loop, then by all parameters except seed and soil, and else keep their order.
    """
    ordered = _ordered(scenarios)
    # Task number of a run = number of samples of all runs before it // size of a task.
    lengths = (count_samples(scenarios[key]) for key in ordered)
    n_before = itertools.accumulate(lengths, initial=0)
    numbered = zip(n_before, ordered)
    for _, task in itertools.groupby(numbered, lambda item: item[0] // samples):
        yield {key: scenarios[key] for _, key in task}


def _ordered(scenarios):
    """Return the keys of {key: scenario} in the order of `split_into_tasks`."""
    # Seeds, loops and families are numbered in the order of their first occurrence. Numbers in
    # arrays take 32 bytes a run; a tuple for each would take 200.
    numbers = [array("q") for _ in range(4)]
    seeds = {}
    loops = {}
    families = {}
    for scenario, blocks in zip(scenarios.values(), _loops(scenarios.values())):
        seed = seeds.setdefault(scenario.seed, len(seeds))
        loop = loops.setdefault(blocks, len(loops))
        family = families.setdefault(_all_but_soil(scenario), len(families))
        for column, number in zip(numbers, (seed // _SEEDS_TOGETHER, loop, family, seed)):
            column.append(number)
    keys = list(scenarios)
    # `lexsort` takes the first criterion last.
    return [keys[place] for place in np.lexsort(numbers[::-1])]


def one_per_structure(scenarios, mean_samples):
    """Return one scenario for each loop of which compiling the lanes pays.

    Args:
        scenarios: Those of the whole campaign.
        mean_samples: Their `mean_samples_per_structure`; all loops get lanes if it is large.
    """
    one = {}
    samples = collections.Counter()
    for scenario, loop in zip(scenarios, _loops(scenarios)):
        one[loop] = scenario
        samples[loop] += count_samples(scenario)
    if sum(samples.values()) < _WORTH_COMPILING:
        return []
    least = 0 if mean_samples >= _WORTH_COMPILING else _PART_OF_A_LOOP * _WORTH_COMPILING
    return [one[key] for key in one if samples[key] >= least]


def compile_lanes(scenario):
    """Compile the lanes of a scenario's loop; one that cannot be set up is left to its run."""
    with contextlib.suppress(*_NO_SETUP):
        lanes.load(closed_loop.build_sample, *closed_loop.set_up(scenario).structure)


def run_in_lanes(scenarios, mean_samples, result_of=operator.attrgetter("metrics")):
    """Run the scenarios that can run in lanes.

    Args:
        scenarios: {key: scenario}.
        mean_samples: `mean_samples_per_structure` of the whole campaign.
        result_of: Function of a Run that returns the result.

    Returns:
        {key: result_of(run)}, without scenarios that cannot be set up; `rhec.simulate` raises their
        error.
    """
    blocks = {}
    groups = {}
    results = {}
    setups = {}
    # The cache needs only the neighbouring seeds, not those of a whole task.
    cached = functools.lru_cache(4 * _SEEDS_TOGETHER)
    noise = cached(closed_loop.noise_and_faults)
    soil_settings = cached(terrain.settings)
    # A group takes as long as its longest run: with the longest first, runs of a length meet.
    for key, scenario in sorted(scenarios.items(), key=lambda item: -count_samples(item[1])):
        family = _all_but_soil(scenario)
        try:
            setup = setups[family] = _set_up(scenario, setups.get(family), soil_settings)
        except _NO_SETUP:
            continue
        if setup.structure not in blocks:
            blocks[setup.structure] = _load_block(setup.structure, mean_samples)
        block = blocks[setup.structure]
        if not block or count_samples(scenario) * block.lanes > _MAX_SAMPLES_IN_MEMORY:
            continue
        group = groups.setdefault(setup.structure, {})
        group[key] = scenario, setup
        if len(group) == block.lanes:
            results |= _run_group(block, groups.pop(setup.structure), noise, result_of)
    for structure, group in groups.items():
        results |= _run_group(blocks[structure], group, noise, result_of)
    return results


def _set_up(scenario, relative, soil_settings):
    """Return `closed_loop.set_up(scenario)`.

    relative: The Setup of a scenario that differs only in seed and soil, or None. It is reused
    except for the soil.
    """
    if relative is None:
        return closed_loop.set_up(scenario)
    soil = scenario.terrain or terrain.random_for(scenario, relative.path)
    shape = terrain.common_shape(relative.terrain)
    settings = relative.settings | soil_settings(soil, shape)
    return replace(relative, settings=settings, terrain=soil)


def simulate_batch(scenarios, result_of=lambda run: run, mean_samples=None):
    """Run scenarios in lanes if that is faster, and the others one by one.

    Args:
        scenarios: Scenarios, in any order.
        result_of: Function of a Run; its result must not be empty or 0.
        mean_samples: `mean_samples_per_structure` of the batch of which these are a part.

    Returns:
        A list of result_of(run), in the order of the scenarios.
    """
    scenarios = list(scenarios)
    if not scenarios:
        return []
    if mean_samples is None:
        mean_samples = mean_samples_per_structure(scenarios)
    in_lanes = run_in_lanes(dict(enumerate(scenarios)), mean_samples, result_of)
    return [
        in_lanes.get(k)
        or result_of(closed_loop.simulate_setup(scenario, closed_loop.set_up(scenario)))
        for k, scenario in enumerate(scenarios)
    ]


def _load_block(structure, mean_samples):
    """Return the compiled lanes of a structure, or None if they do not pay or do not exist."""
    sample = closed_loop.build_sample, *structure
    if mean_samples < _WORTH_COMPILING:
        # A few runs use existing lanes only if the scalar loop would have to be compiled.
        few = mean_samples < _WORTH_LOADING and compiled.is_compiled(*sample)
        if few or not lanes.is_compiled(*sample):
            return None
    return lanes.load(*sample)


def _run_group(block, group, noise, result_of):
    """Return {key: result_of(run)} of {key: (scenario, setup)} of one structure."""
    scenarios, setups = zip(*group.values())
    streams = [
        noise(scenario.seed, scenario.faults, count_samples(scenario), setup.draws)
        for scenario, setup in zip(scenarios, setups)
    ]
    memories = [setup.memory for setup in setups]
    settings = [setup.settings for setup in setups]
    rows = runner.run(block, memories, streams, settings)
    return {
        key: result_of(closed_loop.finished(scenario, setup, of_run))
        for (key, (scenario, setup)), of_run in zip(group.items(), rows)
    }
