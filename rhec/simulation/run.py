"""A finished run: its metrics, its log, and what it shows of itself."""

import base64
import functools
import html
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rhec.paper import TOLERANCE_M
from rhec.simulation.metrics import Metrics, first_violation_s
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.terrain import Terrain

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes:
        scenario: What was run.
        metrics: {name: value}; a notebook shows their units, and docs/log_columns.md
            defines them.
        path: The path to follow.
        terrain: The traction of the soil.
        columns: The log's columns by name, arrays (n,).
    """

    scenario: Scenario
    metrics: Metrics
    path: Path
    terrain: Terrain
    columns: dict[str, np.ndarray]

    @functools.cached_property
    def log(self) -> "pd.DataFrame":
        """One row a sample; docs/log_columns.md says what each column is."""
        # pandas takes half of the time of importing this package; campaigns never look at a log.
        import pandas as pd

        return pd.DataFrame(self.columns)

    def __repr__(self) -> str:
        m = self.metrics
        violations = f"{m['violations_true']} violations, {m['violations']} by GNSS"
        return (
            f"Run of {self.scenario!r}\n"
            f"  {len(self.columns['t_s'])} samples, {self.scenario.duration_s:g} s\n"
            f"  mean error {m['mean_error_m']:.4f} m, true {m['mean_error_true_m']:.4f} m\n"
            f"  {self._in_its_row()}: {violations}\n"
            f"  {'every' if m['solver_ok'] else 'not every'} QP was solved"
        )

    def _in_its_row(self) -> str:
        """Whether the robot stayed in its row, and since when not."""
        if np.isnan(self.metrics["settling_time_s"]):
            return "the robot never came to stay in its row"
        left_s = first_violation_s(self.columns)
        if np.isnan(left_s):
            return "the robot stayed in its row"
        return f"the robot left its row, {TOLERANCE_M} m beside the path, first at {left_s:.1f} s"

    def _repr_html_(self) -> str:
        """In a notebook: the scenario, a table of the metrics, and what `plot` draws."""
        picture = io.BytesIO()
        self.plot().savefig(picture, format="png", dpi=100)
        data = base64.b64encode(picture.getvalue()).decode()
        return (
            f"<p><code>{html.escape(repr(self.scenario))}</code></p>"
            f'<div style="display: flex">{self.metrics._repr_html_()}'
            f'<img src="data:image/png;base64,{data}" alt="path, errors and traction"></div>'
        )

    def plot(self) -> "Figure":
        """Draw path and robot, the errors, and the traction with two standard deviations.

        The deviations are not in the log. The estimator runs again for them, which compiles it
        the first time.

        Returns:
            A matplotlib Figure.
        """
        # Imported here, because most runs are never drawn.
        from rhec.plot import overview
        from rhec.simulation.offline import sigma_of_traction

        return overview(self, sigma_of_traction(self))
