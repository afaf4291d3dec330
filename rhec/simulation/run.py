"""A finished run: its metrics, its log, and one picture of it.

The picture is drawn here and not by `rhec.workbench.plots`, since the simulation must not depend on
the workbench. It is for a first look; the figures of the paper are the workbench's.
"""

import base64
import functools
import html
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rhec import paper
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
        self.plot().savefig(picture, format="png", dpi=100)
        data = base64.b64encode(picture.getvalue()).decode()
        return (
            f"<p><code>{html.escape(repr(self.scenario))}</code></p>"
            f'<div style="display: flex"><table>{rows}</table>'
            f'<img src="data:image/png;base64,{data}" alt="path, errors and traction"></div>'
        )

    def plot(self) -> "Figure":
        """Draw path and robot, the errors over time, and true and estimated traction.

        Returns:
            A matplotlib Figure.
        """
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(7, 8), layout="constrained")
        # Closed, a notebook shows it once: as the result of the cell.
        plt.close(figure)
        on_map, error, mu, kappa = figure.subplots(
            4, gridspec_kw=dict(height_ratios=(3, 2, 1.5, 1.5))
        )
        self._draw_map(on_map)
        self._draw_errors(error)
        self._draw_traction(mu, "mu", "μ [-]")
        self._draw_traction(kappa, "kappa", "κ [-]")
        kappa.set_xlabel("t [s]")
        return figure

    def _draw_map(self, axes):
        points = np.arange(0, self.path.length_m, 0.1)
        axes.plot(*self.path.poses(points)[0][:, :2].T, color="0.6", label="path")
        axes.plot(self.columns["x_m"], self.columns["y_m"], label="robot")
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title=_title(self))
        axes.legend(fontsize="small")

    def _draw_errors(self, axes):
        t_s = self.columns["t_s"]
        axes.plot(t_s, self.columns["error_m"], color="0.6", linewidth=0.8, label="GNSS")
        axes.plot(t_s, self.columns["error_true_m"], label="true")
        axes.axhline(paper.TOLERANCE_M, color="k", linestyle=":", label="tolerance")
        axes.set(ylabel="error [m]", ylim=(0, 3 * paper.TOLERANCE_M))
        axes.legend(fontsize="small", ncols=3)

    def _draw_traction(self, axes, name, label):
        t_s = self.columns["t_s"]
        axes.plot(t_s, self.columns[name], color="k", linewidth=0.8, label="true")
        axes.plot(t_s, self.columns[f"{name}_hat"], label="estimated")
        axes.set(ylabel=label, ylim=(0, 1.1))
        axes.legend(fontsize="small", ncols=2)


def _title(run):
    mean_m = run.metrics["mean_error_m"]
    return f"{run.scenario.duration_s:g} s, mean error {mean_m:.3f} m by GNSS"


def _rounded(value):
    return f"{value:.4g}" if isinstance(value, float) else str(value)
