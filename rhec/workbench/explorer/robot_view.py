"""One sample from the robot's point of view: its estimation window and its plan, in the row."""

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from rhec import paper
from rhec.plots.style import BLACK, COLOURS, DOUBLE_IN, GREEN, GREY, PURPLE, styled
from rhec.workbench.explorer import field_run
from rhec.workbench.explorer.svg_layers import LayeredFigure

__all__ = ["RobotView", "robot_view", "seen_from"]

_HALF_M = paper.ROBOT_LENGTH_M / 2, paper.ROBOT_WIDTH_M / 2
_FOOTPRINT = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * _HALF_M
_LEGEND = {
    "driven": "driven (truth)",
    "measured": "GNSS",
    "window": "{estimator}’s window and robot",
    "plan": "plan of the RHC",
    "desired": "desired points",
    "rows": "plants",
}
_LEGEND_LOOKS = "color linestyle marker markersize markerfacecolor linewidth alpha".split()


def seen_from(pose, xy):
    """Places or poses (n, 2 or 3) in the frame of a pose (x, y, θ): ahead and to the left [m]."""
    return (xy[:, :2] - pose[:2]) @ _turned(-pose[2])


def _distance_left(path, xy):
    """How far places or poses (n, 2 or 3) are to the left of the path [m]."""
    poses, _ = path.poses(path.project(xy[:, :2])[1])
    across = xy[:, :2] - poses[:, :2]
    return across[:, 1] * np.cos(poses[:, 2]) - across[:, 0] * np.sin(poses[:, 2])


def _turned(theta):
    """Row vectors times this are turned by theta."""
    return np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])


class RobotView(LayeredFigure):
    """Estimation window and plan of one sample, from above and across, and the yaw rates."""

    def __init__(self, size_in=(8.0, 4.3)):
        super().__init__(size_in, "robot-view", "what the robot estimates and plans at one moment")

    def _build(self):
        width, height = self.figure.get_size_inches()
        low, high = 0.40 / height, 0.37 - 0.30 / height
        places = {
            "above": (0.52 / width, 0.51, 1 - 0.60 / width, 0.48 - 0.2 / height),
            "across": (0.52 / width, low, 0.5 - 0.62 / width, high),
            "yaw_rate": (0.5 + 0.46 / width, low, 0.5 - 0.54 / width, high),
        }
        self.axes = {name: self.figure.add_axes(place) for name, place in places.items()}
        above, across, yaw_rate = self.axes.values()
        above.set(aspect="equal")
        above.set_xlabel("ahead [m]", labelpad=1)
        above.set_ylabel("to the left [m]", labelpad=2)
        title = dict(loc="left", pad=3, fontsize=8)
        across.set_title("beside the path, to the left [m]", **title)
        yaw_rate.set_title("yaw rate [rad/s]: commanded, planned; dashed: bounds", **title)
        for axes in (across, yaw_rate):
            axes.axvline(0, color=BLACK, linewidth=0.5)
            axes.set_xlabel("time from now [s]", labelpad=1)
        across.axhspan(-paper.TOLERANCE_M, paper.TOLERANCE_M, **field_run.FAINT_TOLERANCE)
        across.axhline(0, **field_run.DASHED)
        self.bounds = [yaw_rate.axhline(0, **field_run.DASHED) for _ in range(2)]
        self.moving = self._moving_by_name()

    def _moving_by_name(self):
        """Every artist that moves, by its name, in the order of drawing."""
        above, across, yaw_rate = self.axes.values()

        def line(axes, **look):
            return axes.add_line(Line2D([], [], animated=True, **{"linewidth": 1.0} | look))

        def area(**look):
            return above.add_patch(Polygon(np.zeros((1, 2)), animated=True, linewidth=0, **look))

        black, thin = dict(color=BLACK), dict(color=BLACK, linewidth=0.7)
        dots = dict(color=COLOURS["measured"], linestyle="none", marker="o", markersize=3)
        rings = dots | dict(markersize=5, markerfacecolor="none", markeredgewidth=0.6)
        nodes, plan = dict(marker=".", markersize=4), dict(color=PURPLE)
        return dict(
            rows=line(above, color=GREEN, linewidth=5, alpha=0.35, solid_capstyle="butt"),
            tolerance=area(facecolor=COLOURS["tolerance"], alpha=0.4),
            robot=area(facecolor=GREY, alpha=0.35),
            path=line(above, **field_run.DASHED),
            driven=line(above, **thin),
            residuals=line(above, color=COLOURS["measured"], linewidth=0.5),
            measured=line(above, **dots),
            window=line(above, **nodes),
            estimate=line(above, linewidth=1.2),
            desired=line(above, **rings | black),
            plan=line(above, **plan | nodes),
            across_driven=line(across, **thin),
            across_measured=line(across, **dots),
            across_window=line(across, **nodes),
            across_plan=line(across, **plan | nodes),
            commanded=line(yaw_rate, drawstyle="steps-post"),
            planned=line(yaw_rate, drawstyle="steps-post", **plan),
        )

    def show(self, run, k, snapshot):
        """Take sample k of a run, with the Snapshot of that sample."""
        c, now_s, name = run.columns, run.columns["t_s"][k], field_run.name_of(run.scenario)
        reach_s = paper.DT_S * max(run.scenario.estimation_horizon, run.scenario.prediction_horizon)
        reach_m = reach_s * run.scenario.speed_mps + 0.7
        past = slice(max(0, k - round(reach_s / paper.DT_S)), k + 1)
        driven, t_s = np.column_stack([c["x_m"][past], c["y_m"][past]]), c["t_s"][past] - now_s
        from_above = self._from_above(run.path, snapshot, driven, reach_m)
        over_time = self._over_time(run.path, snapshot, driven, t_s)
        over_time["commanded"] = np.column_stack([t_s, c["omega_cmd_radps"][past]])
        for artist, points in (from_above | over_time).items():
            moving = self.moving[artist]
            moving.set_xy(points) if isinstance(moving, Polygon) else moving.set_data(*points.T)
        for artist in ("window", "estimate", "across_window", "commanded"):
            self.moving[artist].set_color(field_run.colour_of(run.scenario))
        self._show_legend(name, self._handles(name))
        beside = [over_time[f"across_{part}"][:, 1] for part in ("driven", "window", "plan")]
        largest = np.nanmax(np.abs(np.concatenate(beside)), initial=0)
        across_m, time = field_run.round_up_to(1.05 * largest), (-reach_s - 0.1, reach_s + 0.1)
        plane = self.axes["above"].get_position(original=True).size * self.figure.get_size_inches()
        half_height = reach_m * plane[1] / plane[0]
        self._limit("above", (-reach_m, reach_m), (-half_height, half_height))
        self._limit("across", time, (-across_m, across_m))
        self._limit("yaw_rate", time, self._show_bounds(run))

    def _from_above(self, path, snapshot, driven, reach_m):
        """What is drawn in the robot's frame, by artist: arrays (n, 2) [m]."""

        def seen(xy):
            return seen_from(snapshot.truth, xy)

        _, s = path.project(snapshot.truth[None, :2])
        ahead_m = s + np.arange(-1.3 * reach_m, 1.3 * reach_m, 0.1)
        ahead_m = ahead_m if path.closed else np.clip(ahead_m, 0, path.length_m)
        poses, curvatures = path.poses(ahead_m)
        left, right = (
            seen(
                np.where(
                    (curvatures == 0)[:, None], field_run.places_beside(poses, across_m), np.nan
                )
            )
            for across_m in (paper.ROW_SPACING_M / 2, -paper.ROW_SPACING_M / 2)
        )
        window, measured = seen(snapshot.window), seen(snapshot.measured)
        gaps = np.full(window.shape, np.nan)
        outline = _FOOTPRINT @ _turned(snapshot.estimate[2]) + snapshot.estimate[:2]
        return dict(
            rows=np.concatenate([left, [[np.nan, np.nan]], right]),
            tolerance=seen(field_run.tolerance_band(poses)),
            robot=_FOOTPRINT,
            path=seen(poses),
            driven=seen(driven),
            residuals=np.stack([measured, window, gaps], axis=1).reshape(-1, 2),
            measured=measured,
            window=window,
            estimate=seen(outline[[0, 1, 2, 3, 0]]),
            desired=seen(snapshot.desired[1:]),
            plan=seen(snapshot.plan),
        )

    def _over_time(self, path, snapshot, driven, t_s):
        """What is drawn over the time from now, by artist: arrays (n, 2) of s and m or rad/s."""
        past_s = paper.DT_S * np.arange(1 - len(snapshot.window), 1)
        plan_s = paper.DT_S * np.arange(len(snapshot.plan))
        planned = np.append(snapshot.omega_radps, snapshot.omega_radps[-1])
        return dict(
            across_driven=np.column_stack([t_s, _distance_left(path, driven)]),
            across_measured=np.column_stack([past_s, _distance_left(path, snapshot.measured)]),
            across_window=np.column_stack([past_s, _distance_left(path, snapshot.window)]),
            across_plan=np.column_stack([plan_s, _distance_left(path, snapshot.plan)]),
            planned=np.column_stack([plan_s, planned]),
        )

    def _handles(self, estimator):
        """What the colours mean, as lines for the legend."""
        handles = []
        for name, label in _LEGEND.items():
            looks = {look: getattr(self.moving[name], f"get_{look}")() for look in _LEGEND_LOOKS}
            handles.append(Line2D([], [], **looks, label=label.format(estimator=estimator)))
        return handles

    def _moving(self):
        return self.moving.values()


@styled
def robot_view(run, k, snapshot):
    """The matplotlib Figure of sample k of a run, with `snapshot_at(run.scenario, k)`."""
    picture = RobotView((DOUBLE_IN, 4.0))
    picture.show(run, k, snapshot)
    title = f"{field_run.name_of(run.scenario)}, {run.columns['t_s'][k]:.1f} s"
    picture.axes["above"].set_title(title, loc="left", pad=3, fontsize=8)
    return picture.whole_figure()
