"""A finished run: its metrics, its log, and what it shows of itself.

The simulation draws nothing and imports nothing of the workbench. The function that draws a run,
`rhec.workbench.plots.one_run.overview`, is set by the public face, as `Run.draw`.
"""

import base64
import functools
import html
import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rhec.simulation.metrics import METRICS
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.terrain import Terrain

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Run"]


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run.

    Attributes:
        scenario: What was run.
        metrics: {name: value}; `rhec.simulation.metrics.METRICS` defines them.
        path: The path to follow.
        terrain: The traction of the soil.
        columns: The log's columns by name, arrays (n,).
    """

    scenario: Scenario
    metrics: dict[str, Any]
    path: Path
    terrain: Terrain
    columns: dict[str, np.ndarray]

    # (run, with_band) -> Figure
    draw: ClassVar[Callable[..., "Figure"]]

    @functools.cached_property
    def log(self) -> "pd.DataFrame":
        """One row a sample; `rhec.simulation.columns` says what each column is."""
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
        rows = "".join(
            f"<tr><td>{name}</td><td>{_rounded(value)}</td><td>{METRICS[name][0]}</td></tr>"
            for name, value in self.metrics.items()
        )
        picture = io.BytesIO()
        # Without the band, since a result of a cell must not wait for a compiler.
        self.draw(self, with_band=False).savefig(picture, format="png", dpi=100)
        data = base64.b64encode(picture.getvalue()).decode()
        return (
            f"<p><code>{html.escape(repr(self.scenario))}</code></p>"
            f'<div style="display: flex"><table>{rows}</table>'
            f'<img src="data:image/png;base64,{data}" alt="path, errors and traction"></div>'
        )

    def plot(self) -> "Figure":
        """Draw path and robot, the errors, and the traction with two standard deviations.

        Returns:
            A matplotlib Figure.
        """
        return self.draw(self, with_band=True)


def _rounded(value):
    return f"{value:.4g}" if isinstance(value, float) else str(value)
