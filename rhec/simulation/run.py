"""A finished run: its metrics, its log, and what it shows of itself."""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.terrain import Terrain

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run.

    Attributes:
        scenario: What was run.
        metrics: {name: value}; `rhec.simulation.log_page.METRICS` defines them.
        path: The path to follow.
        terrain: The traction of the soil.
        columns: The log's columns by name, arrays (n,).
    """

    scenario: Scenario
    metrics: dict[str, Any]
    path: Path
    terrain: Terrain
    columns: dict[str, np.ndarray]

    @functools.cached_property
    def log(self) -> "pd.DataFrame":
        """One row a sample; `rhec.simulation.log_page` says what each column is."""
        # pandas takes half of the time of importing this package; campaigns never look at a log.
        import pandas as pd

        return pd.DataFrame(self.columns)

    def __repr__(self) -> str:
        m = self.metrics
        return (
            f"Run of {self.scenario!r}\n"
            f"  {len(self.columns['t_s'])} samples, {self.scenario.duration_s:g} s\n"
            f"  mean error {m['mean_error_m']:.4f} m, true {m['mean_error_true_m']:.4f} m\n"
            f"  violations {m['violations']}, true {m['violations_true']}\n"
            f"  all_ok: {m['all_ok']}"
        )

    def _repr_html_(self) -> str:
        """In a notebook: the scenario, a table of the metrics, and the picture."""
        # Imported here, because only notebooks show a run.
        from rhec.simulation.run_html import html_of

        return html_of(self)

    def plot(self) -> "Figure":
        """Draw path and robot, the errors, and the traction with two standard deviations.

        Returns:
            A matplotlib Figure.
        """
        # Imported here, because most runs are never drawn.
        from rhec.plot import overview
        from rhec.simulation.offline import sigma_of_traction

        return overview(self, sigma_of_traction(self))
