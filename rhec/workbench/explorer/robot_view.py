"""One sample from the robot's point of view: its estimation window and its plan, in the row."""

import numpy as np

from rhec import paper
from rhec.workbench.explorer import field_run
from rhec.workbench.explorer.panels import Mark, Panel, Picture, figure_of
from rhec.workbench.plots.style import COLOURS, GREEN, GREY, PURPLE

_HALF_M = paper.ROBOT_LENGTH_M / 2, paper.ROBOT_WIDTH_M / 2
_FOOTPRINT = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * _HALF_M
_THIN = dict(width=0.7)
_PLAN = dict(colour=PURPLE)
_MEASURED = dict(colour=COLOURS["measured"])
_RINGS = dict(width=5, full=False)
_NODES = dict(width=2.2)


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


def _held(t_s, values):
    """A line through values that are held until the next time."""
    return np.repeat(t_s, 2)[1:], np.repeat(values, 2)[:-1]


def picture_of(run, k, snapshot):
    """The Picture of sample k of a run, with the Snapshot of that sample."""
    c = run.columns
    t_s = run.columns["t_s"]
    reach_s = paper.DT_S * max(run.scenario.estimation_horizon, run.scenario.prediction_horizon)
    reach_m = reach_s * run.scenario.speed_mps + 0.7
    past = slice(max(0, k - round(reach_s / paper.DT_S)), k + 1)
    driven = np.column_stack([c["x_m"][past], c["y_m"][past]])
    ago_s = t_s[past] - t_s[k]
    time = (-reach_s - 0.1, reach_s + 0.1)
    bound = run.scenario.omega_max_radps
    mine = dict(colour=field_run.colour_of(run.scenario))
    across = _across(run.path, snapshot, driven, ago_s, mine)
    largest = np.nanmax(np.abs(np.concatenate([mark.y for mark in across])), initial=0)
    across_m = field_run.round_up_to(1.05 * largest)
    tolerance = (-paper.TOLERANCE_M, paper.TOLERANCE_M)
    beneath = [
        field_run.rectangle(time, tolerance, **field_run.FAINT_TOLERANCE),
        field_run.level(time, 0, **field_run.DASHED),
        _now((-across_m, across_m)),
    ]
    plan_s = paper.DT_S * np.arange(len(snapshot.plan))
    planned = np.append(snapshot.omega_radps, snapshot.omega_radps[-1])
    rates = (-1.25 * bound, 1.25 * bound)
    turning = [field_run.level(time, at, **field_run.DASHED) for at in (-bound, bound)]
    turning += [
        _now(rates),
        Mark("line", *_held(ago_s, c["omega_cmd_radps"][past]), **mine),
        Mark("line", *_held(plan_s, planned), **_PLAN),
    ]
    title = f"from above [m], ahead is right, at {t_s[k]:.1f} s"
    seen = _from_above(run, snapshot, driven, reach_m, mine)
    beside = "beside the path, to the left [m], over time from now [s]"
    panels = {
        "above": Panel(title, (-reach_m, reach_m), (-0.1, 0.1), seen, "equal"),
        "across": Panel(beside, time, (-across_m, across_m), beneath + across),
        "yaw_rate": Panel("yaw rate [rad/s]: commanded, planned", time, rates, turning),
    }
    return Picture(("above above", "across yaw_rate"), panels)


def _now(ylim):
    return Mark("line", np.zeros(2), np.array(ylim), width=0.5)


def _from_above(run, snapshot, driven, reach_m, mine):
    """What is drawn in the robot's frame."""

    def mark(kind, xy, **look):
        return Mark(kind, *seen_from(snapshot.truth, xy).T, **look)

    path = run.path
    name = field_run.name_of(run.scenario)
    _, s = path.project(snapshot.truth[None, :2])
    ahead_m = s + np.arange(-1.3 * reach_m, 1.3 * reach_m, 0.1)
    ahead_m = ahead_m if path.closed else np.clip(ahead_m, 0, path.length_m)
    poses, curvatures = path.poses(ahead_m)
    rows = [
        np.where((curvatures == 0)[:, None], field_run.places_beside(poses, across_m), np.nan)
        for across_m in (paper.ROW_SPACING_M / 2, -paper.ROW_SPACING_M / 2)
    ]
    plants = np.concatenate([rows[0], [[np.nan, np.nan]], rows[1]])
    window = snapshot.window[:, :2]
    measured = snapshot.measured
    residuals = np.stack([measured, window, np.full(window.shape, np.nan)], axis=1)
    outline = _FOOTPRINT @ _turned(snapshot.estimate[2]) + snapshot.estimate[:2]
    return [
        mark("line", plants, colour=GREEN, width=5, alpha=0.35, label="plants"),
        mark("area", field_run.tolerance_band(poses), colour=COLOURS["tolerance"], alpha=0.4),
        Mark("area", *_FOOTPRINT.T, colour=GREY, alpha=0.35),
        mark("line", poses, **field_run.DASHED),
        mark("line", driven, **_THIN, label="driven (truth)"),
        mark("line", residuals.reshape(-1, 2), width=0.5, **_MEASURED),
        mark("dots", measured, width=3, **_MEASURED, label="GNSS"),
        mark("dots", window, **_NODES, **mine),
        mark("line", window, **mine),
        mark("line", outline[[0, 1, 2, 3, 0]], **mine, label=f"{name}’s window and robot"),
        mark("dots", snapshot.desired[1:], **_RINGS, label="desired points"),
        mark("dots", snapshot.plan, **_NODES, **_PLAN),
        mark("line", snapshot.plan, **_PLAN, label="plan of the RHC"),
    ]


def _across(path, snapshot, driven, ago_s, mine):
    """What is drawn over the time from now: distances to the left of the path."""

    def mark(kind, xy, t_s, **look):
        return Mark(kind, t_s, _distance_left(path, xy), **look)

    past_s = paper.DT_S * np.arange(1 - len(snapshot.window), 1)
    plan_s = paper.DT_S * np.arange(len(snapshot.plan))
    return [
        mark("line", driven, ago_s, **_THIN),
        mark("dots", snapshot.measured, past_s, width=3, **_MEASURED),
        mark("line", snapshot.window, past_s, **mine),
        mark("dots", snapshot.window, past_s, **_NODES, **mine),
        mark("line", snapshot.plan, plan_s, **_PLAN),
        mark("dots", snapshot.plan, plan_s, **_NODES, **_PLAN),
    ]


def robot_view(run, k, snapshot):
    """The matplotlib Figure of sample k of a run, with `snapshot_at(run.scenario, k)`."""
    return figure_of(picture_of(run, k, snapshot))
