"""Bounds of commands, states, outputs and changes: hard ones, and soft ones that have a price."""

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from rhec.core._casadi.validation import refuse, shown
from rhec.core.model.limits import MAX_QP_ENTRY

_PAIR = "it should be (lowest, highest), the first below the second, or a rhec.Bound"


def _is_number(value):
    return isinstance(value, Real) and not isinstance(value, bool) and not np.isnan(value)


def _recipe(lowest, highest):
    """What does the work of equal bounds."""
    if not _is_number(lowest) or lowest != highest:
        return ""
    return (
        "; to hold an input, leave it out of `command` and let it follow `u_ref`; to hold a state "
        "or an output, give it a reference and a large weight"
    )


@dataclass(frozen=True)
class Bound:
    """Lowest and highest value of a quantity of a rhec.RHC, hard or soft.

    A soft bound may be exceeded by t at the price linear · t + ½ quadratic · t² in each sample. If
    the linear price is above the multiplier of the hard bound, the plan is that of the hard bound
    wherever the hard bound can be kept.

    Args:
        lowest: The lowest value, or -inf.
        highest: The highest value, or inf.
        linear: Price of each unit beyond the bound.
        quadratic: Price of the square. Without either price the bound is hard.

    Raises:
        ValueError: If an argument is invalid.
    """

    lowest: float
    highest: float
    linear: float | None = None
    quadratic: float | None = None

    def __post_init__(self) -> None:
        if not all(map(_is_number, (self.lowest, self.highest))) or not self.lowest < self.highest:
            pair = (self.lowest, self.highest)
            expected = "they should be two numbers, the first below the second"
            refuse("the bounds were", pair, expected + _recipe(*pair))
        for name in ("linear", "quadratic"):
            price = getattr(self, name)
            if price is not None and not (_is_number(price) and 0 <= price < MAX_QP_ENTRY):
                refuse(f"{name} was", price, "it should be None or a number that is not negative")
        if self.is_soft and not any(self.prices):
            raise ValueError(
                "linear and quadratic were both 0; one should be above 0, or both None for a hard "
                "bound"
            )

    @property
    def is_soft(self) -> bool:
        """Whether the bound has a price."""
        return self.linear is not None or self.quadratic is not None

    @property
    def prices(self) -> tuple[float, float]:
        """The linear and the quadratic price, 0 for one that was not given."""
        return self.linear or 0.0, self.quadratic or 0.0


NONE = Bound(-np.inf, np.inf)


def bounds_of(field: str, bounds: Any, names: tuple[str, ...]) -> dict:
    """A user's bounds {name: (lowest, highest) or Bound} as {name: Bound}.

    Args:
        field: The parameter's name, for a message.
        bounds: What the user said, or None.
        names: Names that may be bounded.

    Returns:
        The bounds by name.

    Raises:
        ValueError: If a name or a bound is invalid.
    """
    if bounds is None:
        return {}
    if not isinstance(bounds, Mapping):
        refuse(f"{field} was", bounds, "it should be a dict of names to (lowest, highest)")
    unknown = [name for name in bounds if name not in names]
    if unknown:
        refuse(f"{field} was", tuple(bounds), f"it should name some of {names}, each once")
    return {name: _bound_of(field, name, bound) for name, bound in bounds.items()}


def _bound_of(field, name, bound):
    if isinstance(bound, Bound):
        return bound
    try:
        lowest, highest = bound
        return Bound(lowest, highest)
    except (TypeError, ValueError):
        recipe = _recipe(*bound) if np.shape(bound) == (2,) else ""
        raise ValueError(f"{field} of {name!r} were {shown(bound)}; {_PAIR}{recipe}") from None
