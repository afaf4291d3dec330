"""One field run in six panels: the trajectory on the slip map, errors, traction, yaw rate and KKT
tolerance; up to two runs and two pinned ones.

`field_run` makes the figure once; `FieldRun` keeps it and takes new runs in place, which is what an
explorer needs.
"""

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from rhec import paper
from rhec.plots.style import BLACK, COLOURS, DOUBLE_IN, GREY, ORANGE, PURPLE, RC, styled
from rhec.workbench.explorer.svg_layers import Layers

NAMES = {
    "rhe": "RHE",
    "ekf": "EKF",
    "dual": "dual",
    "oracle": "oracle",
    "traction_oracle": "traction oracle",
}
ESTIMATOR_COLOURS = {
    "RHE": COLOURS["RHE"],
    "EKF": COLOURS["EKF"],
    "oracle": COLOURS["oracle"],
    "traction oracle": PURPLE,
    "dual": ORANGE,
}
# Full traction lets the page shine through; wet soil is brown on a light page and on a dark one.
SOIL = LinearSegmentedColormap.from_list(
    "soil", [(0.50, 0.36, 0.20, 0.9), (0.62, 0.50, 0.34, 0.45), (0.62, 0.50, 0.34, 0.0)]
)
ZOOMS = ("whole path", "first row", "worst place")
SLOTS = ("run", "other", "pinned run", "pinned other")

# What is drawn of a run: panel, column along x (None: the time), column along y, and how: "bold" in
# the estimator's colour, "faint" in the same, "second" a second bold one, "truth" in black.
SERIES = (
    ("map", "x_m", "y_m", "bold"),
    ("error", None, "error_m", "faint"),
    ("error", None, "error_true_m", "bold"),
    ("mu", None, "mu", "truth"),
    ("mu", None, "mu_hat", "bold"),
    ("kappa", None, "kappa", "truth"),
    ("kappa", None, "kappa_hat", "bold"),
    ("yaw_rate", None, "omega_cmd_radps", "bold"),
    ("kkt", None, "kkt_rhe", "bold"),
    ("kkt", None, "kkt_rhc", "second"),
)
LOOKS = {
    "bold": dict(linewidth=0.9),
    "second": dict(linewidth=0.7, alpha=0.5),
    "faint": dict(linewidth=0.4, alpha=0.55),
    "truth": dict(linewidth=0.7, color=BLACK),
}
LABELS = {
    "error": "error [m]",
    "mu": r"$\mu$ [-]",
    "kappa": r"$\kappa$ [-]",
    "yaw_rate": r"$\omega$ [rad/s]",
    "kkt": "KKT [-]",
}


def name_of(scenario):
    """The estimator's name in legends."""
    return NAMES.get(scenario.estimator, "own") if isinstance(scenario.estimator, str) else "own"


def colour_of(scenario):
    return ESTIMATOR_COLOURS.get(name_of(scenario), GREY)


# Limits that stay while the data changes a little, so that a picture does not jump


def rung(value, rungs=(0.15, 0.3, 0.6, 1.2, 3, 6, 12, 30, 60, 120, 300)):
    """The lowest rung not below the value; the highest for what is higher, or no number."""
    return next((each for each in rungs if value <= each), rungs[-1])


def error_limits(columns):
    """From 0 to what nearly all true errors stay below: the start beside the path may leave the
    picture.
    """
    values = np.concatenate([each["error_true_m"] for each in columns])
    values = values[np.isfinite(values)]
    return 0.0, rung(1.3 * np.quantile(values, 0.95) if len(values) else np.inf)


def traction_limits(columns, name):
    """(μ or κ) up to 1, down to a round number below nearly all of it."""
    values = np.concatenate([each[column] for each in columns for column in (name, f"{name}_hat")])
    values = values[np.isfinite(values)]
    low = np.quantile(values, 0.01) if len(values) else 0.0
    return next((floor for floor in (0.6, 0.4, 0.2) if low > floor), 0.0) - 0.01, 1.02


def kkt_limits(columns):
    """Whole powers of ten around nearly all of both tolerances."""
    values = np.concatenate([each[column] for each in columns for column in ("kkt_rhe", "kkt_rhc")])
    values = np.log10(values[(values > 0) & np.isfinite(values)])
    low, high = np.quantile(values, [0.02, 0.995]) if len(values) else (-9, 0)
    return 10.0 ** max(np.floor(low), -12), 10.0 ** np.ceil(high)


def worst_place(run):
    """Where and when the true error is largest after the arrival: (x_m, y_m), t_s."""
    c, arrival = run.columns, run.metrics["settling_time_s"]
    error = np.where(c["t_s"] >= (0 if np.isnan(arrival) else arrival), c["error_true_m"], -1.0)
    k = np.argmax(np.nan_to_num(error, nan=-1.0))
    return (c["x_m"][k], c["y_m"][k]), c["t_s"][k]


def map_limits(run, zoom, shape):
    """((x, x_end), (y, y_end), aspect) of a zoom: the soil's whole field, the first row with y
    stretched, or 5 m around the worst place.

    shape: width by height of the panel [any unit].
    """
    (x, y), cell = run.terrain.origin_m, run.terrain.cell_m
    if zoom == "worst place":
        (x, y), _ = worst_place(run)
        half = 2.5
        return (
            (np.round(x) - half * shape[0] / shape[1], np.round(x) + half * shape[0] / shape[1]),
            (np.round(y) - half, np.round(y) + half),
            "equal",
        )
    if zoom == "first row":
        end = run.path.segments[1, 0] if len(run.path.segments) > 1 else run.path.length_m
        (x_0, y_0, _), (x_1, y_1, _) = run.path.poses([0.0, end - 1e-6])[0]
        reach = rung(abs(run.scenario.start_offset_m), (0.3, 0.6, 1.2, 3, 6, 12)) * 1.1
        return (
            (min(x_0, x_1) - 1, max(x_0, x_1) + 1),
            (min(y_0, y_1) - reach, max(y_0, y_1) + reach),
            "auto",
        )
    points = np.array(run.terrain.mu.shape) - 1
    if min(points) < 8:  # the same soil everywhere has no extent of its own
        xy = run.path.poses(np.arange(0, run.path.length_m, 0.5))[0][:, :2]
        (x, y), (x_end, y_end) = xy.min(axis=0) - 5, xy.max(axis=0) + 5
    else:
        x_end, y_end = np.array([x, y]) + points * cell
    return (x, x_end), (y, y_end), "equal"


class FieldRun:
    """The figure, and what moves in it. `show` takes runs, `svg` is the picture for a page,
    `figure` the same to be saved.
    """

    def __init__(self, size_in=(8.0, 4.3), name="field-run"):
        with mpl.rc_context(RC | {"figure.constrained_layout.use": False, "axes.grid.axis": "y"}):
            self.figure = Figure(figsize=size_in)
            self.figure.patch.set_visible(False)
            self.axes = self._axes()
            self.image = self.axes["map"].imshow(
                np.ones((2, 2)),
                origin="lower",
                interpolation="bilinear",
                cmap=SOIL,
                vmin=0.5,
                vmax=1,
            )
            self.still = self._still()
            self.lines = {
                slot: [self._line(panel, look, slot) for panel, _, _, look in SERIES]
                for slot in SLOTS
            }
            self.curves = {
                panel: axes.fill_between(
                    [0, 0],
                    0,
                    1,
                    transform=axes.get_xaxis_transform(),
                    color=BLACK,
                    alpha=0.07,
                    linewidth=0,
                    animated=True,
                )
                for panel, axes in self.axes.items()
                if panel != "map"
            }
            self.marks = (
                self.axes["map"].plot([], [], "o", markersize=3.5, color=BLACK, animated=True)[0],
                self.axes["map"].plot(
                    [],
                    [],
                    "o",
                    markersize=9,
                    color=COLOURS["EKF"],
                    markerfacecolor="none",
                    markeredgewidth=0.9,
                    animated=True,
                )[0],
            )
            self.figure.draw_without_rendering()  # ticks take their style when first drawn
        self.layers, self.keys = Layers(self.figure, name), {}

    def _axes(self):
        width, height = self.figure.get_size_inches()
        grid = self.figure.add_gridspec(
            1,
            2,
            width_ratios=(1.2, 1),
            left=0.46 / width,
            right=1 - 0.06 / width,
            top=1 - 0.30 / height,
            bottom=0.40 / height,
            wspace=0.6 / (width / 2.2),
        )
        left = grid[0].subgridspec(2, 1, height_ratios=(1.9, 1), hspace=0.28)
        right = grid[1].subgridspec(4, 1, height_ratios=(1, 1.25, 1, 1), hspace=0.16)
        axes = {"map": self.figure.add_subplot(left[0]), "error": self.figure.add_subplot(left[1])}
        axes |= {
            panel: self.figure.add_subplot(right[row])
            for row, panel in enumerate(("mu", "kappa", "yaw_rate", "kkt"))
        }
        for panel, each in axes.items():
            each.patch.set_visible(False)
            each.grid(visible=False)
            if panel != "map":
                each.grid(axis="y", color=BLACK, alpha=0.12)
            each.set_ylabel(LABELS.get(panel, ""), labelpad=2)
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

    def _still(self):
        """What moves with the limits alone: the row's tolerance, bounds, the reference."""
        plane, look = self.axes["map"], dict(color=BLACK, linewidth=0.6, linestyle=(0, (4, 2.5)))
        self.axes["error"].axhspan(
            0, paper.TOLERANCE_M, color=COLOURS["tolerance"], alpha=0.35, linewidth=0, zorder=0
        )
        return {
            "tolerance": plane.fill(
                [], [], color=COLOURS["tolerance"], alpha=0.5, linewidth=0, zorder=0.5
            )[0],
            "reference": plane.plot([], [], **look)[0],
            "bounds": [self.axes["yaw_rate"].axhline(0, **look) for _ in range(2)],
        }

    def _line(self, panel, look, slot):
        style = dict(zorder=2.4 - 0.1 * SLOTS.index(slot)) | LOOKS[look]
        style |= dict(linestyle=(0, (2.5, 1.5)), alpha=0.6) if "pinned" in slot else {}
        style |= dict(linestyle=":", alpha=0.7) if look == "truth" and slot == "other" else {}
        hidden = "pinned" in slot and look != "bold"
        return self.axes[panel].add_line(Line2D([], [], animated=True, visible=not hidden, **style))

    def show(self, runs, pinned=(), zoom=ZOOMS[0], soil="kappa"):
        """Take up to two runs, and up to two pinned before them; zoom: see ZOOMS; soil: the slip
        field of the map, "mu" or "kappa".
        """
        given = dict(zip(SLOTS, [*runs, *[None] * (2 - len(runs)), *pinned]))
        for slot in SLOTS:
            self._show_lines(self.lines[slot], given.get(slot))
        first, columns = runs[0], [run.columns for run in (*runs, *pinned)]
        self._show_marks(first)
        self._show_map(first, zoom, soil)
        time = (0.0, max(each["t_s"][-1] + paper.DT_S for each in columns))
        bound = first.scenario.omega_max_radps
        for panel, limits in {
            "error": error_limits(columns),
            "mu": traction_limits(columns, "mu"),
            "kappa": traction_limits(columns, "kappa"),
            "yaw_rate": (-1.25 * bound, 1.25 * bound),
            "kkt": kkt_limits(columns),
        }.items():
            self.axes[panel].set(xlim=time, ylim=limits)
            self.keys[panel] = time, limits
        for line, value in zip(self.still["bounds"], (-bound, bound)):
            line.set_ydata([value, value])
        self._show_legend(runs, pinned)

    def _show_lines(self, lines, run):
        for line, (_, x, y, look) in zip(lines, SERIES):
            if run is None:
                line.set_data([], [])
                continue
            line.set_data(run.columns[x or "t_s"], run.columns[y])
            if look != "truth":
                line.set_color(colour_of(run.scenario))

    def _show_marks(self, run):
        c = run.columns
        start, worst = self.marks
        start.set_data(c["x_m"][:1], c["y_m"][:1])
        worst.set_data(*np.transpose([worst_place(run)[0]]))
        for shade in self.curves.values():
            shade.set_data(c["t_s"], 0, 1, where=~c["on_straight"])

    def _show_map(self, run, zoom, soil):
        axes, terrain = self.axes["map"], run.terrain
        box = axes.get_subplotspec().get_position(self.figure)
        x, y, aspect = map_limits(run, zoom, box.size * self.figure.get_size_inches())
        key = (
            terrain.origin_m,
            terrain.cell_m,
            getattr(terrain, soil).tobytes(),
            run.path.segments.tobytes(),
            soil,
            x,
            y,
        )
        if key == self.keys.get("map"):
            return
        field, half = getattr(terrain, soil), terrain.cell_m / 2
        width, height = np.array(field.shape) * terrain.cell_m
        left, bottom = terrain.origin_m[0] - half, terrain.origin_m[1] - half
        self.image.set(data=field.T, extent=(left, left + width, bottom, bottom + height))
        poses, _ = run.path.poses(np.arange(0, run.path.length_m + 0.05, 0.1))
        across = paper.TOLERANCE_M * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
        self.still["tolerance"].set_xy(
            np.concatenate([poses[:, :2] + across, (poses[:, :2] - across)[::-1]])
        )
        self.still["reference"].set_data(*poses[:, :2].T)
        axes.set(xlim=x, ylim=y, aspect=aspect)
        stretched = "" if aspect == "equal" else ", $y$ stretched"
        axes.set_title(
            rf"trajectory on the map of $\{soil}$ (brown: slips){stretched}",
            loc="left",
            pad=3,
            fontsize=8,
        )
        axes.apply_aspect()
        self.keys["map"] = key

    def _show_legend(self, runs, pinned):
        entries = [(name_of(run.scenario), colour_of(run.scenario), "-") for run in runs]
        entries += [
            (f"pinned {name_of(run.scenario)}", colour_of(run.scenario), "--") for run in pinned
        ]
        entries += [("truth, and bounds (dashed)", BLACK, "-")]
        if self.keys.get("legend") != tuple(entries):
            for old in list(self.figure.legends):
                old.remove()
            with mpl.rc_context(RC):
                handles = [
                    Line2D([], [], color=colour, linestyle=line, label=label)
                    for label, colour, line in entries
                ]
                self.figure.legend(
                    handles=handles,
                    loc="upper right",
                    ncols=len(entries),
                    borderaxespad=0.1,
                    handlelength=1.6,
                    columnspacing=1.2,
                )
            self.keys["legend"] = tuple(entries)

    def svg(self):
        """The picture for a page."""
        still = [
            self.layers.kept_layer(panel, self.keys[panel], axes)
            for panel, axes in self.axes.items()
        ]
        still.append(self.layers.kept_layer("legend", self.keys["legend"], *self.figure.legends))
        lines = [
            line
            for slot in reversed(SLOTS)
            for line in self.lines[slot]
            if line.get_visible() and len(line.get_xdata(orig=True))
        ]
        moving = self.layers.layer(*self.curves.values(), *lines, *self.marks)
        return self.layers.svg(
            *still,
            moving,
            label="trajectory, errors, traction, yaw rate and KKT tolerance of the run",
        )


@styled
def field_run(runs, pinned=(), zoom=ZOOMS[0], soil="kappa"):
    """Up to two runs, and up to two pinned to compare with, in six panels (the trajectory on the
    map of μ or κ [-], distances to the path [m], μ and κ [-], the yaw rate with its bounds [rad/s],
    KKT tolerances); zoom: one of ZOOMS. Everything is drawn: nothing waits for an explorer.
    """
    picture = FieldRun((DOUBLE_IN, 4.3))
    picture.show(list(runs), list(pinned), zoom, soil)
    for artist in picture.figure.findobj(lambda artist: artist.get_animated()):
        artist.set_animated(False)
    picture.figure.set_dpi(100)
    return picture.figure
