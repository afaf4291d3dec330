"""One field run in six panels: the trajectory on the slip map, errors, traction, yaw rate and KKT
tolerance; up to two runs and two pinned ones. `FieldRun` keeps the figure and takes new runs.
"""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from rhec import paper
from rhec.plots.style import BLACK, COLOURS, DOUBLE_IN, GREY, ORANGE, PURPLE, styled
from rhec.workbench.explorer.controls import ESTIMATORS
from rhec.workbench.explorer.svg_layers import LayeredFigure

__all__ = ["DASHED", "FAINT_TOLERANCE", "ZOOMS", "FieldRun", "colour_of", "field_run", "name_of"]
__all__ += ["places_beside", "round_up_to", "tolerance_band"]

ZOOMS = ("whole path", "first row", "worst place")
DASHED = dict(color=BLACK, linewidth=0.6, linestyle=(0, (4, 2.5)))  # reference and bounds
FAINT_TOLERANCE = dict(color=COLOURS["tolerance"], alpha=0.35, linewidth=0, zorder=0)

_COLOURS = COLOURS | {"traction oracle": PURPLE, "dual": ORANGE}
# Full traction lets the page shine through; wet soil is brown on a light page and on a dark one.
_SOIL = LinearSegmentedColormap.from_list(
    "soil", [(0.50, 0.36, 0.20, 0.9), (0.62, 0.50, 0.34, 0.45), (0.62, 0.50, 0.34, 0.0)]
)
_SLOTS = ("run", "other", "pinned run", "pinned other")

# What is drawn of a run: panel, columns along x and y, and how: all but "truth" in the estimator's
# colour.
_SERIES = (
    ("map", "x_m", "y_m", "bold"),
    ("error", "t_s", "error_m", "faint"),
    ("error", "t_s", "error_true_m", "bold"),
    ("mu", "t_s", "mu", "truth"),
    ("mu", "t_s", "mu_hat", "bold"),
    ("kappa", "t_s", "kappa", "truth"),
    ("kappa", "t_s", "kappa_hat", "bold"),
    ("yaw_rate", "t_s", "omega_cmd_radps", "bold"),
    ("kkt", "t_s", "kkt_rhe", "bold"),
    ("kkt", "t_s", "kkt_rhc", "second"),
)
_LOOKS = {
    "bold": dict(linewidth=0.9),
    "second": dict(linewidth=0.7, alpha=0.5),
    "faint": dict(linewidth=0.4, alpha=0.55),
    "truth": dict(linewidth=0.7, color=BLACK),
}
_LABELS = {"error": "error [m]", "mu": r"$\mu$ [-]", "kappa": r"$\kappa$ [-]"}
_LABELS |= {"yaw_rate": r"$\omega$ [rad/s]", "kkt": "KKT [-]"}


def name_of(scenario):
    """The estimator's name in legends; "own" for one of the user's."""
    own = not isinstance(scenario.estimator, str)
    return "own" if own else ESTIMATORS.get(scenario.estimator, scenario.estimator)


def colour_of(scenario):
    """The estimator's colour."""
    return _COLOURS.get(name_of(scenario), GREY)


def places_beside(poses, across_m):
    """Places (n, 2) this far to the left of poses (n, 3) [m]."""
    return poses[:, :2] + across_m * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])


def tolerance_band(poses):
    """Outline (2 n, 2) of the tolerance on either side of poses (n, 3) [m]."""
    left, right = (places_beside(poses, side * paper.TOLERANCE_M) for side in (1, -1))
    return np.concatenate([left, right[::-1]])


# Limits that stay while the data changes a little, so that a picture does not jump


def round_up_to(value, steps=(0.15, 0.3, 0.6, 1.2, 3, 6, 12, 30, 60, 120, 300)):
    """The lowest step not below the value; the highest one for what is higher, or not a number."""
    return next((step for step in steps if value <= step), steps[-1])


def _finite(columns, *names):
    """All finite values of these columns of several runs, one after another."""
    values = np.concatenate([each[name] for each in columns for name in names])
    return values[np.isfinite(values)]


def _error_limits(columns):
    """From 0 to what nearly all true errors stay below: a start beside the path may be cut off."""
    values = _finite(columns, "error_true_m")
    return 0.0, round_up_to(1.3 * np.quantile(values, 0.95) if len(values) else np.inf)


def _traction_limits(columns, name):
    """(μ or κ) up to 1, down to a round number below nearly all of it."""
    values = _finite(columns, name, f"{name}_hat")
    low = np.quantile(values, 0.01) if len(values) else 0.0
    return next((floor for floor in (0.6, 0.4, 0.2) if low > floor), 0.0) - 0.01, 1.02


def _kkt_limits(columns):
    """Whole powers of ten around nearly all of both tolerances."""
    values = _finite(columns, "kkt_rhe", "kkt_rhc")
    values = np.log10(values[values > 0])
    low, high = np.quantile(values, [0.02, 0.995]) if len(values) else (-9, 0)
    return 10.0 ** max(np.floor(low), -12), 10.0 ** np.ceil(high)


def _worst_place(run):
    """The place (x, y) [m] of the largest true error after settling."""
    c, settled_s = run.columns, run.metrics["settling_time_s"]
    error = np.where(c["t_s"] >= (0 if np.isnan(settled_s) else settled_s), c["error_true_m"], -1.0)
    k = np.argmax(np.nan_to_num(error, nan=-1.0))
    return c["x_m"][k], c["y_m"][k]


def _map_limits(run, zoom, shape):
    """((x, x_end), (y, y_end), aspect) of a zoom, for a panel of this width and height."""
    path = run.path
    if zoom == "worst place":
        centre = np.round(_worst_place(run))
        half = 2.5 * np.array([shape[0] / shape[1], 1])
        low, high, aspect = centre - half, centre + half, "equal"
    elif zoom == "first row":
        end = path.segments[1, 0] if len(path.segments) > 1 else path.length_m
        ends = path.poses([0.0, end - 1e-6])[0][:, :2]
        beside = round_up_to(abs(run.scenario.start_offset_m), (0.3, 0.6, 1.2, 3, 6, 12)) * 1.1
        low, high, aspect = ends.min(axis=0) - (1, beside), ends.max(axis=0) + (1, beside), "auto"
    else:
        low, points, aspect = run.terrain.origin_m, np.array(run.terrain.mu.shape) - 1, "equal"
        high = low + points * run.terrain.cell_m
        if min(points) < 8:  # uniform soil has no extent of its own
            xy = path.poses(np.arange(0, path.length_m, 0.5))[0][:, :2]
            low, high = xy.min(axis=0) - 5, xy.max(axis=0) + 5
    return *zip(low, high), aspect


class FieldRun(LayeredFigure):
    """Trajectory, errors, traction, yaw rate and KKT tolerance of up to four runs."""

    def __init__(self, size_in=(8.0, 4.3)):
        label = "trajectory, errors, traction, yaw rate and KKT tolerance of the run"
        super().__init__(size_in, "field-run", label)

    def _build(self):
        self.axes = self._panels()
        plane, graphs = self.axes["map"], [*self.axes.values()][1:]
        soil = dict(origin="lower", interpolation="bilinear", cmap=_SOIL, vmin=0.5, vmax=1)
        self.image = plane.imshow(np.ones((2, 2)), **soil)
        self.axes["error"].axhspan(0, paper.TOLERANCE_M, **FAINT_TOLERANCE)
        (self.tolerance,) = plane.fill([], [], **FAINT_TOLERANCE | dict(alpha=0.5, zorder=0.5))
        (self.reference,) = plane.plot([], [], **DASHED)
        self.bounds = [self.axes["yaw_rate"].axhline(0, **DASHED) for _ in range(2)]

        self.lines = {slot: [self._line(slot, *series) for series in _SERIES] for slot in _SLOTS}
        shade = dict(color=BLACK, alpha=0.07, linewidth=0, animated=True)
        self.curves = [
            axes.fill_between([0, 0], 0, 1, transform=axes.get_xaxis_transform(), **shade)
            for axes in graphs
        ]
        ring = dict(color=COLOURS["EKF"], markerfacecolor="none", markeredgewidth=0.9)
        self.marks = [
            plane.plot([], [], "o", animated=True, **look)[0]
            for look in (dict(markersize=3.5, color=BLACK), dict(markersize=9, **ring))
        ]

    def _panels(self):
        width, height = self.figure.get_size_inches()
        margins = dict(left=0.46 / width, right=1 - 0.06 / width)
        margins |= dict(bottom=0.40 / height, top=1 - 0.30 / height, wspace=1.32 / width)
        grid = self.figure.add_gridspec(1, 2, width_ratios=(1.2, 1), **margins)
        left = grid[0].subgridspec(2, 1, height_ratios=(1.9, 1), hspace=0.28)
        right = grid[1].subgridspec(4, 1, height_ratios=(1, 1.25, 1, 1), hspace=0.16)
        places = dict(zip(("map", "error", "mu", "kappa", "yaw_rate", "kkt"), [*left, *right]))
        axes = {panel: self.figure.add_subplot(place) for panel, place in places.items()}
        for panel, each in axes.items():
            each.set_ylabel(_LABELS.get(panel, ""), labelpad=2)
            if panel in ("mu", "kappa", "yaw_rate"):
                each.tick_params(labelbottom=False)
                each.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
        for panel in ("error", "kkt"):
            axes[panel].set_xlabel("time [s]", labelpad=1)
        axes["error"].yaxis.set_major_locator(MaxNLocator(4))
        axes["kkt"].set_yscale("log")
        axes["kkt"].yaxis.set_major_locator(LogLocator(numticks=5))
        axes["kkt"].yaxis.set_minor_locator(LogLocator(subs=(), numticks=1))
        axes["map"].set(xlabel="$x$ [m]", ylabel="$y$ [m]")
        return axes

    def _line(self, slot, panel, _x, _y, look):
        pinned = "pinned" in slot
        style = dict(zorder=2.4 - 0.1 * _SLOTS.index(slot)) | _LOOKS[look]
        style |= dict(linestyle=(0, (2.5, 1.5)), alpha=0.6) if pinned else {}
        style |= dict(linestyle=":", alpha=0.7) if look == "truth" and slot == "other" else {}
        visible = look == "bold" or not pinned
        return self.axes[panel].add_line(Line2D([], [], animated=True, visible=visible, **style))

    def show(self, runs, pinned=(), zoom=ZOOMS[0], soil="kappa"):
        """Take new runs.

        Args:
            runs, pinned: one or two runs each; the pinned ones, dashed, to compare with.
            zoom: one of ZOOMS.
            soil: the slip field on the map, "mu" or "kappa".
        """
        shown = dict(zip(_SLOTS, [*runs, *[None] * (2 - len(runs)), *pinned]))
        for slot in _SLOTS:
            self._show_lines(self.lines[slot], shown.get(slot))
        first, columns = runs[0], [run.columns for run in (*runs, *pinned)]
        self._show_marks(first)
        self._show_map(first, zoom, soil)
        time = (0.0, max(each["t_s"][-1] + paper.DT_S for each in columns))
        traction = [_traction_limits(columns, name) for name in ("mu", "kappa")]
        limits = [_error_limits(columns), *traction, self._show_bounds(first), _kkt_limits(columns)]
        for panel, of_one in zip(_LABELS, limits):
            self._limit(panel, time, of_one)
        entries = [("", run.scenario, "-") for run in runs]
        entries += [("pinned ", run.scenario, "--") for run in pinned]
        entries = [(kind + name_of(of), colour_of(of), line) for kind, of, line in entries]
        entries += [("truth, and bounds (dashed)", BLACK, "-")]
        looks = [dict(zip(("label", "color", "linestyle"), entry)) for entry in entries]
        self._show_legend(tuple(entries), [Line2D([], [], linewidth=1.0, **look) for look in looks])

    def _show_lines(self, lines, run):
        for line, (_, x, y, look) in zip(lines, _SERIES):
            line.set_data(*([], []) if run is None else (run.columns[x], run.columns[y]))
            if run and look != "truth":
                line.set_color(colour_of(run.scenario))

    def _show_marks(self, run):
        c = run.columns
        start, worst = self.marks
        start.set_data(c["x_m"][:1], c["y_m"][:1])
        worst.set_data(*np.transpose([_worst_place(run)]))
        for shade in self.curves:
            shade.set_data(c["t_s"], 0, 1, where=~c["on_straight"])

    def _show_map(self, run, zoom, soil):
        axes, terrain, field = self.axes["map"], run.terrain, getattr(run.terrain, soil)
        box = axes.get_subplotspec().get_position(self.figure)
        x, y, aspect = _map_limits(run, zoom, box.size * self.figure.get_size_inches())
        arrays = field.tobytes(), run.path.segments.tobytes()
        key = (terrain.origin_m, terrain.cell_m, *arrays, soil, x, y)
        if key == self.keys.get("map"):
            return
        left, bottom = np.subtract(terrain.origin_m, terrain.cell_m / 2)
        width, height = np.array(field.shape) * terrain.cell_m
        self.image.set(data=field.T, extent=(left, left + width, bottom, bottom + height))
        poses, _ = run.path.poses(np.arange(0, run.path.length_m + 0.05, 0.1))
        self.tolerance.set_xy(tolerance_band(poses))
        self.reference.set_data(*poses[:, :2].T)
        axes.set(xlim=x, ylim=y, aspect=aspect)
        stretched = "" if aspect == "equal" else ", $y$ stretched"
        title = rf"trajectory on the map of $\{soil}$ (brown: slips){stretched}"
        axes.set_title(title, loc="left", pad=3, fontsize=8)
        axes.apply_aspect()
        self.keys["map"] = key

    def _moving(self):
        lines = [line for slot in reversed(_SLOTS) for line in self.lines[slot]]
        drawn = [line for line in lines if line.get_visible() and len(line.get_xdata(orig=True))]
        return *self.curves, *drawn, *self.marks


@styled
def field_run(runs, pinned=(), zoom=ZOOMS[0], soil="kappa"):
    """The matplotlib Figure of field runs in six panels; arguments as for `FieldRun.show`."""
    picture = FieldRun((DOUBLE_IN, 4.3))
    picture.show(list(runs), list(pinned), zoom, soil)
    return picture.whole_figure()
