"""Many runs in one process: several at a time, one in each lane of the processor's registers."""

import contextlib
import operator

from rhec import paper, simulation
from rhec._casadi import lanes

__all__ = ["in_groups", "n_samples", "run_in_lanes", "samples_alike", "size_of_task"]

# Samples of runs alike that pay for compiling lanes, and for using them where they are compiled.
_WORTH_COMPILING, _WORTH_USING = 400_000, 10_000
# Closed-loop samples in one task: about a second of work, which is also what an interruption loses.
_TASK, _TASK_IN_LANES = 40_000, 200_000

# What nearly always decides alone which compiled loop a scenario runs.
_ALIKE = operator.attrgetter(
    "estimator", "estimation_horizon", "speed_model", "arrival_mean", "robust",
    "prediction_horizon", "qp", "input_reference", "cautious",
)  # fmt: skip


def n_samples(scenario):
    """How many samples a run of the scenario has."""
    return round(scenario.duration_s / paper.DT_S)


def samples_alike(scenarios):
    """How many samples of these scenarios there are, on average, for each compiled loop."""
    return sum(map(n_samples, scenarios)) / len({*map(_ALIKE, scenarios)})


def size_of_task(alike):
    """How many samples make a task."""
    return _TASK_IN_LANES if alike >= _WORTH_COMPILING else _TASK


def in_groups(scenarios):
    """{key: scenario}, those that share a loop next to each other, among them those of one seed,
    which share fields and noise; otherwise in the order given.
    """
    loops, seeds = {}, {}
    for scenario in scenarios.values():
        loops.setdefault(_ALIKE(scenario), len(loops))
        seeds.setdefault(scenario.seed, len(seeds))

    def place(item):
        return loops[_ALIKE(item[1])], seeds[item[1].seed]

    return dict(sorted(scenarios.items(), key=place))


def run_in_lanes(scenarios, alike, of=operator.attrgetter("metrics")):
    """{key: `of` its Run} of those of the scenarios {key: scenario} that lanes can run.

    Not those that fail: `simulate` says why. alike: see `samples_alike`, of the whole campaign.
    """
    blocks, waiting, done = {}, {}, {}
    if alike < _WORTH_USING:
        return done
    for key, scenario in scenarios.items():
        with contextlib.suppress(Exception):
            setup, samples = simulation.set_up(scenario), n_samples(scenario)
            if setup.structure not in blocks:
                blocks[setup.structure] = _block(setup.structure, alike)
            block = blocks[setup.structure]
            if block and samples * block.lanes <= _TASK_IN_LANES:  # all in memory
                group = waiting.setdefault((setup.structure, samples), {})
                group[key] = scenario, setup
                if len(group) == block.lanes:
                    done |= _run(block, samples, waiting.pop((setup.structure, samples)), of)
    for (structure, samples), group in waiting.items():
        with contextlib.suppress(Exception):
            done |= _run(blocks[structure], samples, group, of)
    return done


def _block(structure, alike):
    """The compiled lanes of a structure, or None where there are none or they do not pay."""
    sample = simulation.build_sample, *structure
    pays = alike >= _WORTH_COMPILING or lanes.is_compiled(*sample)
    return lanes.load(*sample) if pays else None


def _run(block, samples, group, of):
    """{key: `of` its Run} of {key: (scenario, setup)}, of one structure and length."""
    scenarios, setups = zip(*group.values())
    noise = {}
    for each in scenarios:
        if (each.seed, each.faults) not in noise:
            noise[each.seed, each.faults] = simulation.noise_and_faults(each, samples)
    streams = [noise[each.seed, each.faults] for each in scenarios]
    memories, settings = [each.memory for each in setups], [each.settings for each in setups]
    rows = lanes.scan(block, memories, streams, settings)
    runs = map(simulation.finish, scenarios, setups, rows)
    return {key: of(run) for key, run in zip(group, runs)}
