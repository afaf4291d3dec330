"""`rhec.simulate`: run one scenario, or several."""

import functools
from collections.abc import Callable, Iterable
from typing import ParamSpec, TypeVar, overload

from rhec.core._casadi.validation import shown
from rhec.simulation.closed_loop import set_up, simulate_setup
from rhec.simulation.run import Run
from rhec.simulation.scenario import Scenario

_P = ParamSpec("_P")
_T = TypeVar("_T")


def _takes_scenario(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Say how to give the parameters of a Scenario where a call names them (a decorator)."""

    @functools.wraps(function)
    def call(*arguments: _P.args, **named: _P.kwargs) -> _T:
        for name, value in named.items():
            if name != "scenario":
                given = f"rhec.simulate(rhec.Scenario({name}={shown(value)}))"
                raise TypeError(f"simulate takes no {name}; a Scenario does: {given}")
        return function(*arguments, **named)

    return call


@overload
def simulate(scenario: Scenario) -> Run: ...


@overload
def simulate(scenario: Iterable[Scenario]) -> list[Run]: ...


@_takes_scenario
def simulate(scenario: Scenario | Iterable[Scenario]) -> Run | list[Run]:
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
    if isinstance(scenario, Scenario):
        return simulate_setup(scenario, set_up(scenario))
    if not _is_several(scenario):
        raise ValueError(f"scenario was {shown(scenario)}; it should be a rhec.Scenario")
    # Imported here, because a single run needs neither SIMD lanes nor the code of campaigns.
    from rhec.simulation.campaigns.batch import simulate_batch

    return simulate_batch(as_list(scenario, "scenario"))


def _is_several(scenarios):
    # Text and dicts are iterable, too, but their entries are no scenarios.
    return isinstance(scenarios, Iterable) and not isinstance(scenarios, str | dict)


def as_list(scenarios, name):
    """An iterable of scenarios as a list; anything else raises a ValueError with the name."""
    if not _is_several(scenarios):
        raise ValueError(f"{name} was {shown(scenarios)}; it should be a list of rhec.Scenario")
    scenarios = list(scenarios)
    for i, scenario in enumerate(scenarios):
        if not isinstance(scenario, Scenario):
            raise ValueError(f"{name}[{i}] was {shown(scenario)}; it should be a rhec.Scenario")
    return scenarios
