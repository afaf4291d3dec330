"""The one verb for runs: `simulate` of a scenario, or of several."""

from collections.abc import Iterable
from typing import overload

from rhec.core._casadi.validation import shown
from rhec.simulation import closed_loop
from rhec.simulation.closed_loop import Run
from rhec.simulation.scenario import Scenario

__all__ = ["as_list", "simulate"]


@overload
def simulate(scenario: Scenario) -> Run: ...


@overload
def simulate(scenario: Iterable[Scenario]) -> list[Run]: ...


def simulate(scenario):
    """Run one scenario, or several.

    The first run of a loop structure compiles that structure, which takes some seconds, once.
    Several runs are simulated at the same time where that is faster; the results are the same to
    the last bit.

    Args:
        scenario: A rhec.Scenario, or an iterable of them.

    Returns:
        The rhec.Run of one scenario; a list of Runs, in the order given, of several.

    Raises:
        ValueError: If an argument is no Scenario.
    """
    if isinstance(scenario, str) or not isinstance(scenario, Iterable):
        return closed_loop.simulate(scenario)
    scenarios = as_list(scenario, "scenario")
    # Imported here, because a single run needs neither SIMD lanes nor the code of campaigns.
    from rhec.simulation.campaigns.batch import simulate_batch

    return simulate_batch(scenarios)


def as_list(scenarios, name):
    """Return an iterable of scenarios as a list.

    Raises:
        ValueError: If it is not iterable, or holds anything but a Scenario; it names the argument.
    """
    if isinstance(scenarios, str) or not isinstance(scenarios, Iterable):
        raise ValueError(f"{name} was {shown(scenarios)}; it should be a list of rhec.Scenario")
    scenarios = list(scenarios)
    for i, scenario in enumerate(scenarios):
        if not isinstance(scenario, Scenario):
            raise ValueError(f"{name}[{i}] was {shown(scenario)}; it should be a rhec.Scenario")
    return scenarios
