"""Many runs in one process: several at a time, one in each lane of the processor's registers."""

import contextlib
import operator

from rhec import simulation
from rhec._casadi import lanes

__all__ = ["MOST_SAMPLES", "run_in_lanes"]

# Samples of runs alike that pay for compiling lanes, and for using them where they are compiled.
_WORTH_COMPILING, _WORTH_USING = 400_000, 10_000
MOST_SAMPLES = 200_000  # of the runs side by side, which are all in memory


def run_in_lanes(scenarios, alike, of=operator.attrgetter("metrics")):
    """{key: `of` its Run} of those of the scenarios {key: scenario} that lanes can run.

    Not those that fail: `simulate` says why. alike: about how many samples a structure has in all.
    """
    waiting, done = {}, {}
    if alike < _WORTH_USING:
        return done
    for key, scenario in scenarios.items():
        with contextlib.suppress(Exception):
            setup = simulation.set_up(scenario)
            samples = simulation.n_samples(scenario)
            block = _block(setup.structure, alike)
            if block and samples * block.lanes <= MOST_SAMPLES:
                group = waiting.setdefault((setup.structure, samples), {})
                group[key] = scenario, setup
                if len(group) == block.lanes:
                    done |= _run(block, waiting.pop((setup.structure, samples)), of)
    for (structure, _), group in waiting.items():
        with contextlib.suppress(Exception):
            done |= _run(_block(structure, alike), group, of)
    return done


def _block(structure, alike):
    """The compiled lanes of a structure, or None where there are none or they do not pay."""
    sample = simulation.build_sample, *structure
    pays = alike >= _WORTH_COMPILING or lanes.is_compiled(*sample)
    return lanes.load(*sample) if pays else None


def _run(block, group, of):
    """{key: `of` its Run} of {key: (scenario, setup)}, of one structure and length."""
    scenarios, setups = zip(*group.values())
    streams = [simulation.noise_and_faults(each, simulation.n_samples(each)) for each in scenarios]
    memories, settings = [each.memory for each in setups], [each.settings for each in setups]
    rows = lanes.scan(block, memories, streams, settings)
    runs = map(simulation.finish, scenarios, setups, rows)
    return {key: of(run) for key, run in zip(group, runs)}
