"""Named worlds: the parameters of Scenario that differ from the default ones.

For example `rhec.Scenario(**rhec.WORLDS["soft"], seed=3)`. docs/world.md says more of each.
"""

import difflib

# (x, y, radius, μ, κ) [m, m, m, -, -]: where the path turns, and on a row.
_WET = tuple((x, y, 2.0, 0.7, 0.3) for x, y in ((37.0, 4.0), (15.0, 15.6), (-7.0, 19.2)))


class _Worlds(dict[str, dict]):
    """Worlds by name; a name that is none of theirs gets a sentence with those there are."""

    def __missing__(self, name):
        alike = difflib.get_close_matches(str(name), self)
        meant = f"; did you mean {alike[0]!r}?" if alike else ""
        raise KeyError(f"there is no world {name!r}; there are {', '.join(self)}{meant}")


WORLDS: dict[str, dict] = _Worlds(
    {
        # The centre of the worlds in which the paper's numbers are possible.
        "default": {},
        # Soil on which the tracks hardly slip, and nearly alike everywhere.
        "firm": dict(mu_mean=0.98, mu_deviation=0.01, kappa_mean=0.97, kappa_deviation=0.02),
        # Soil on which they slip a lot, above all in turning, and differently from place to place.
        "soft": dict(mu_mean=0.8, mu_deviation=0.08, kappa_mean=0.65, kappa_deviation=0.12),
        # Soil that differs so much that the robot cannot always turn as fast as its path.
        "uncertain": dict(mu_mean=0.8, mu_deviation=0.08, kappa_mean=0.7, kappa_deviation=0.16),
        # The default soil with three patches of sudden change.
        "wet patches": dict(patches=_WET),
    }
)
