"""One sample as the robot sees it: what it takes for the past and what it plans, in the row, seen
from above and stretched across.
"""

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from rhec import paper
from rhec.plots.style import BLACK, COLOURS, DOUBLE_IN, GREEN, GREY, PURPLE, RC, styled
from rhec.workbench.explorer.field_run import colour_of, name_of, rung
from rhec.workbench.explorer.svg_layers import Layers

PLAN = PURPLE
FOOTPRINT = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (
    paper.ROBOT_LENGTH_M / 2,
    paper.ROBOT_WIDTH_M / 2,
)


def seen_from(pose, xy):
    """Places or poses (n, 2 or 3) of the field in the frame of a pose (x, y, θ): ahead and to the
    left [m].
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return (xy[:, :2] - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])


def offset(poses, across_m):
    """The poses' places, moved to the left by so much."""
    return poses[:, :2] + across_m * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])


def beside(path, xy):
    """How far places or poses (n, 2 or 3) are to the left of the path [m]."""
    xy = xy[:, :2]
    _, s = path.project(xy)
    poses, _ = path.poses(s)
    return ((xy - poses[:, :2]) * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])).sum(
        axis=1
    )


class RobotsEye:
    """The figure, and what moves in it. `show` takes a run, one of its samples and what the robot
    has in mind then; `svg` is the picture for a page.
    """

    def __init__(self, size_in=(8.0, 4.3), name="robots-eye"):
        with mpl.rc_context(RC | {"figure.constrained_layout.use": False}):
            self.figure = Figure(figsize=size_in)
            self.figure.patch.set_visible(False)
            width, height = size_in
            above = self.figure.add_axes(
                (0.52 / width, 0.51, 1 - 0.60 / width, 0.48 - 0.2 / height)
            )
            left = self.figure.add_axes(
                (0.52 / width, 0.40 / height, 0.5 - 0.62 / width, 0.37 - 0.30 / height)
            )
            right = self.figure.add_axes(
                (0.5 + 0.46 / width, 0.40 / height, 0.5 - 0.54 / width, 0.37 - 0.30 / height)
            )
            self.axes = {"above": above, "across": left, "yaw_rate": right}
            self._still()
            self.moving = self._moving()
            self.figure.draw_without_rendering()
        self.layers, self.keys = Layers(self.figure, name), {}

    def _still(self):
        for axes in self.axes.values():
            axes.patch.set_visible(False)
            axes.grid(visible=False)
        above, across, yaw_rate = self.axes.values()
        above.set(aspect="equal")
        above.set_xlabel("ahead [m]", labelpad=1)
        above.set_ylabel("to the left [m]", labelpad=2)
        for axes in (across, yaw_rate):
            axes.grid(axis="y", color=BLACK, alpha=0.12)
            axes.axvline(0, color=BLACK, linewidth=0.5)
            axes.set_xlabel("time from now [s]", labelpad=1)
        across.axhspan(
            -paper.TOLERANCE_M,
            paper.TOLERANCE_M,
            color=COLOURS["tolerance"],
            alpha=0.35,
            linewidth=0,
            zorder=0,
        )
        across.axhline(0, color=BLACK, linewidth=0.6, linestyle=(0, (4, 2.5)))
        across.set_title("beside the path, to the left [m]", loc="left", pad=3, fontsize=8)
        yaw_rate.set_title(
            "yaw rate [rad/s]: commanded, planned; dashed: bounds", loc="left", pad=3, fontsize=8
        )
        self.bounds = [
            yaw_rate.axhline(0, color=BLACK, linewidth=0.6, linestyle=(0, (4, 2.5)))
            for _ in range(2)
        ]

    def _moving(self):
        """Every artist that moves, by its name, in the order of drawing."""
        above, across, yaw_rate = self.axes.values()

        def line(axes, **look):
            return axes.add_line(Line2D([], [], animated=True, **{"linewidth": 1.0} | look))

        def area(**look):
            return above.add_patch(Polygon(np.zeros((1, 2)), animated=True, linewidth=0, **look))

        dashes, dots = (0, (4, 2.5)), dict(linestyle="none", marker="o")
        return dict(
            rows=line(above, color=GREEN, linewidth=5, alpha=0.35, solid_capstyle="butt"),
            tolerance=area(facecolor=COLOURS["tolerance"], alpha=0.4),
            robot=area(facecolor=GREY, alpha=0.35),
            path=line(above, color=BLACK, linewidth=0.6, linestyle=dashes),
            driven=line(above, color=BLACK, linewidth=0.7),
            residuals=line(above, color=COLOURS["measured"], linewidth=0.5),
            measured=line(above, color=COLOURS["measured"], markersize=3, **dots),
            window=line(above, marker=".", markersize=4),
            estimate=line(above, linewidth=1.2),
            desired=line(
                above,
                color=BLACK,
                markersize=5,
                markerfacecolor="none",
                markeredgewidth=0.6,
                **dots,
            ),
            plan=line(above, color=PLAN, marker=".", markersize=4),
            across_driven=line(across, color=BLACK, linewidth=0.7),
            across_measured=line(across, color=COLOURS["measured"], markersize=3, **dots),
            across_window=line(across, marker=".", markersize=4),
            across_plan=line(across, color=PLAN, marker=".", markersize=4),
            commanded=line(yaw_rate, drawstyle="steps-post"),
            planned=line(yaw_rate, color=PLAN, drawstyle="steps-post"),
        )

    def _legend(self, estimator):
        """What the colours mean; the estimator's own comes with the run."""
        shown = {
            "driven": "driven (truth)",
            "measured": "GNSS",
            "window": f"{estimator}’s window and robot",
            "plan": "plan of the RHC",
            "desired": "desired points",
            "rows": "plants",
        }
        looks = (
            "color",
            "linestyle",
            "marker",
            "markersize",
            "markerfacecolor",
            "linewidth",
            "alpha",
        )
        handles = [
            Line2D(
                [],
                [],
                **{look: getattr(self.moving[name], f"get_{look}")() for look in looks},
                label=label,
            )
            for name, label in shown.items()
        ]
        for old in list(self.figure.legends):
            old.remove()
        with mpl.rc_context(RC):
            self.figure.legend(
                handles=handles,
                loc="upper right",
                ncols=len(handles),
                borderaxespad=0.1,
                handlelength=1.6,
                columnspacing=1.2,
            )
        self.keys["legend"] = estimator

    def show(self, run, k, horizons):
        """Sample k of a run with the Horizons of that sample."""
        c, path, now = run.columns, run.path, run.columns["t_s"][k]
        reach_s = paper.DT_S * max(run.scenario.estimation_horizon, run.scenario.prediction_horizon)
        reach_m = reach_s * run.scenario.speed_mps + 0.7
        _, s = path.project(horizons.truth[None, :2])
        ahead_s = s + np.arange(-1.3 * reach_m, 1.3 * reach_m, 0.1)
        poses, curvatures = path.poses(
            ahead_s if path.closed else np.clip(ahead_s, 0, path.length_m)
        )
        past = slice(max(0, k - round(reach_s / paper.DT_S)), k + 1)
        driven = np.column_stack([c["x_m"][past], c["y_m"][past]])

        def seen(xy):
            return seen_from(horizons.truth, xy)

        plants = np.where(
            (curvatures == 0)[:, None], offset(poses, paper.ROW_SPACING_M / 2), np.nan
        )
        others = np.where(
            (curvatures == 0)[:, None], offset(poses, -paper.ROW_SPACING_M / 2), np.nan
        )
        window, measured = seen(horizons.window), seen(horizons.measured)
        residuals = np.stack([measured, window, np.full(window.shape, np.nan)], axis=1).reshape(
            -1, 2
        )
        estimated = seen(FOOTPRINT @ _turned(horizons.estimate[2]) + horizons.estimate[:2])
        where = dict(
            rows=np.concatenate([seen(plants), [[np.nan, np.nan]], seen(others)]),
            path=seen(poses),
            driven=seen(driven),
            residuals=residuals,
            measured=measured,
            window=window,
            estimate=np.concatenate([estimated, estimated[:1]]),
            desired=seen(horizons.desired[1:]),
            plan=seen(horizons.plan),
        )
        window_s = paper.DT_S * np.arange(1 - len(window), 1)
        plan_s = paper.DT_S * np.arange(len(horizons.plan))
        where |= dict(
            across_driven=np.column_stack([c["t_s"][past] - now, beside(path, driven)]),
            across_measured=np.column_stack([window_s, beside(path, horizons.measured)]),
            across_window=np.column_stack([window_s, beside(path, horizons.window)]),
            across_plan=np.column_stack([plan_s, beside(path, horizons.plan)]),
            commanded=np.column_stack([c["t_s"][past] - now, c["omega_cmd_radps"][past]]),
            planned=np.column_stack(
                [plan_s, np.append(horizons.omega_radps, horizons.omega_radps[-1])]
            ),
        )
        for name, points in where.items():
            self.moving[name].set_data(*points.T)
        self.moving["tolerance"].set_xy(
            seen(
                np.concatenate(
                    [offset(poses, paper.TOLERANCE_M), offset(poses, -paper.TOLERANCE_M)[::-1]]
                )
            )
        )
        self.moving["robot"].set_xy(FOOTPRINT)
        for name in ("window", "estimate", "across_window", "commanded"):
            self.moving[name].set_color(colour_of(run.scenario))
        if self.keys.get("legend") != name_of(run.scenario):
            self._legend(name_of(run.scenario))
        self._limits(
            run,
            reach_m,
            reach_s,
            np.concatenate([where["across_driven"], where["across_window"], where["across_plan"]])[
                :, 1
            ],
        )

    def _limits(self, run, reach_m, reach_s, across):
        bound = run.scenario.omega_max_radps
        width, height = (
            self.axes["above"].get_position(original=True).size * self.figure.get_size_inches()
        )
        largest = np.nanmax(np.abs(across), initial=0)
        limits = {
            "above": ((-reach_m, reach_m), (-reach_m * height / width, reach_m * height / width)),
            "across": (
                (-reach_s - 0.1, reach_s + 0.1),
                (-rung(1.05 * largest), rung(1.05 * largest)),
            ),
            "yaw_rate": ((-reach_s - 0.1, reach_s + 0.1), (-1.25 * bound, 1.25 * bound)),
        }
        for panel, (x, y) in limits.items():
            if self.keys.get(panel) != (x, y):
                self.axes[panel].set(xlim=x, ylim=y)
                self.keys[panel] = x, y
        for line, value in zip(self.bounds, (-bound, bound)):
            line.set_ydata([value, value])

    def svg(self):
        """The picture for a page."""
        still = [
            self.layers.kept_layer(panel, self.keys[panel], axes)
            for panel, axes in self.axes.items()
        ]
        still.append(self.layers.kept_layer("legend", self.keys["legend"], *self.figure.legends))
        return self.layers.svg(
            *still,
            self.layers.layer(*self.moving.values()),
            label="what the robot estimates and plans at one moment",
        )


def _turned(theta):
    """Row vectors times this are turned by theta."""
    return np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])


@styled
def robots_eye(run, k, horizons):
    """Sample k of a run as the robot sees it: estimation window, GNSS, plan and desired points in
    the row, from above [m] and stretched across [m], and commanded yaw rates with their bounds
    [rad/s]. horizons: `rhec.workbench.explorer.snapshot.horizons_at(run.scenario, k)`.
    """
    picture = RobotsEye((DOUBLE_IN, 4.0))
    picture.show(run, k, horizons)
    for artist in picture.moving.values():
        artist.set_animated(False)
    picture.figure.set_dpi(100)
    picture.axes["above"].set_title(
        f"{name_of(run.scenario)}, {run.columns['t_s'][k]:.1f} s", loc="left", pad=3, fontsize=8
    )
    return picture.figure
