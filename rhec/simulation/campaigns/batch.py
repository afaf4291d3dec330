"""Many runs in one process: several at a time, one per SIMD lane, if that is faster."""

import contextlib
import functools
import itertools
import operator
from array import array
from dataclasses import replace

import numpy as np

from rhec import paper
from rhec.core import runner
from rhec.core.lanes import lanes
from rhec.simulation import closed_loop
from rhec.simulation.campaigns.store import PLAIN
from rhec.simulation.parts import blocks_of
from rhec.tracked_robot import terrain

# Compiling the lanes of a loop takes 1 to 4 s of processor time. The loop of a single run takes
# 0.5 to 1 s, but then eight times as long: lanes pay from this number of samples on.
_WORTH_COMPILING = 40_000
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


class Plan:
    """What is decided for many runs together: their order, their tasks, and whose lanes to compile.

    Args:
        scenarios: {key: scenario}, at least one.
    """

    def __init__(self, scenarios):
        self.scenarios = scenarios
        # Of each run: the number of its loop, family and seed, and how many samples it has. Numbers
        # in arrays take 32 bytes a run; a tuple for each would take 200.
        loop_numbers = array("q")
        family_numbers = array("q")
        seed_numbers = array("q")
        lengths = array("q")
        loops = {}
        families = {}  # of scenarios that differ only in seed and soil
        seeds = {}
        loop_of = []  # the number of each family's loop
        for scenario in scenarios.values():
            family = families.setdefault(_all_but_soil(scenario), len(families))
            if family == len(loop_of):
                # The sizes of path and soil are left out: they take time to find, and nearly all
                # loops agree in them.
                loop_of.append(loops.setdefault(blocks_of(scenario), len(loops)))
            loop_numbers.append(loop_of[family])
            family_numbers.append(family)
            seed_numbers.append(seeds.setdefault(scenario.seed, len(seeds)))
            lengths.append(count_samples(scenario))
        self._loops = np.asarray(loop_numbers)
        self._families = np.asarray(family_numbers)
        self._seeds = np.asarray(seed_numbers)
        self._lengths = np.asarray(lengths)

    @property
    def samples(self):
        """The number of samples of all runs."""
        return int(self._lengths.sum())

    @property
    def mean_samples(self):
        """The mean number of samples of the runs per compiled loop."""
        return self.samples / (1 + int(self._loops.max()))

    def tasks(self, least):
        """Yield parts of {key: scenario} that take about a second; less, to make `least` parts.

        Runs that share work become neighbours: they are sorted by groups of seeds, which share
        fields and noise, then by loop, then by all parameters except seed and soil, and else keep
        their order.
        """
        groups = self._seeds // _SEEDS_TOGETHER
        # `lexsort` takes the first criterion last.
        order = np.lexsort((self._seeds, self._families, self._loops, groups))
        of_a_second = _TASK_IN_LANES if self.mean_samples >= _WORTH_COMPILING else _TASK
        samples = min(of_a_second, self.samples / least)
        # Task number of a run = number of samples of all runs before it // size of a task.
        lengths = self._lengths[order]
        numbers = (np.cumsum(lengths) - lengths) // samples
        items = list(self.scenarios.items())
        for _, task in itertools.groupby(zip(numbers, order), operator.itemgetter(0)):
            yield dict(items[place] for _, place in task)

    def worth_lanes(self):
        """Return one scenario for each loop of which compiling the lanes pays."""
        _, first = np.unique(self._loops, return_index=True)
        samples = np.bincount(self._loops, self._lengths)
        scenarios = list(self.scenarios.values())
        return [scenarios[place] for place in first[samples >= _WORTH_COMPILING]]


def compile_lanes(scenario):
    """Compile the lanes of a scenario's loop; one that cannot be set up is left to its run."""
    with contextlib.suppress(*_NO_SETUP):
        lanes.load(closed_loop.build_sample, *closed_loop.set_up(scenario).structure)


def run_in_lanes(scenarios, result_of):
    """Run the scenarios of whose loops the lanes are compiled.

    Args:
        scenarios: {key: scenario}.
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
            blocks[setup.structure] = _load_block(setup.structure)
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


def simulate_batch(scenarios, result_of=lambda run: run):
    """Run scenarios in lanes if that is faster, and the others one by one.

    Args:
        scenarios: Scenarios, in any order.
        result_of: Function of a Run; its result must not be empty or 0.

    Returns:
        A list of result_of(run), in the order of the scenarios.
    """
    numbered = dict(enumerate(scenarios))
    if not numbered:
        return []
    for scenario in Plan(numbered).worth_lanes():
        compile_lanes(scenario)
    in_lanes = run_in_lanes(numbered, result_of)
    return [
        in_lanes.get(k)
        or result_of(closed_loop.simulate_setup(scenario, closed_loop.set_up(scenario)))
        for k, scenario in numbered.items()
    ]


def _load_block(structure):
    """Return the compiled lanes of a structure, or None if there are none."""
    sample = closed_loop.build_sample, *structure
    return lanes.load(*sample) if lanes.is_compiled(*sample) else None


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
