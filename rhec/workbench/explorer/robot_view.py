"""One sample from the robot's point of view: its estimation window and its plan, in the row.

The page draws the view from above by robot_view.js, as the live page does.
"""

import numpy as np

from rhec import paper
from rhec.workbench.explorer import field_run
from rhec.workbench.explorer.panels import Mark, Panel, Picture
from rhec.workbench.plots.style import COLOURS, PURPLE

_PLANTS_APART_M = 0.15  # a choice of the drawing
_FOLIAGE_M = 0.1  # radius of a plant
_HALF_FREE_M = paper.ROBOT_WIDTH_M / 2 + paper.TOLERANCE_M  # from the row's middle to the leaves
_TELLING_SAMPLES = round(3 / paper.DT_S)  # of the path's glow
_DRIVEN_SAMPLES = 60
_MEASURED_SAMPLES = 25
_THIN = dict(width=0.7)
_PLAN = dict(colour=PURPLE)
_MEASURED = dict(colour=COLOURS["measured"])
_NODES = dict(width=2.2)
# Of the view from above: colours are those of the page's style sheet.
_LEGEND = (
    dict(kind="line", colour="--plan", label="plan of the RHC"),
    dict(kind="dots", full=False, label="desired points; commanded way of a track"),
    dict(kind="dots", colour="--measured", label="GNSS"),
    dict(kind="line", colour="--glow", width=4, label="the last 3 s tell of κ"),
    dict(kind="dots", colour="--touched", width=5, label="leaf touched; slip of a track"),
)


def plants_of(path):
    """Plants of both rows beside the straight parts of a Path.

    Returns:
        (n, 4) tip of the leaf that is nearest to the robot, and middle of the plant [m]; the tip is
        `paper.TOLERANCE_M` away from the side of a robot in the row's middle.
    """
    poses, curvatures = path.poses(np.arange(0, path.length_m, _PLANTS_APART_M))
    straight = poses[curvatures == 0]
    rows = [
        np.column_stack(
            [
                field_run.places_beside(straight, side * _HALF_FREE_M),
                field_run.places_beside(straight, side * (_HALF_FREE_M + _FOLIAGE_M)),
            ]
        )
        for side in (1, -1)
    ]
    return np.concatenate(rows)


def _distance_left(path, xy):
    """Distance of points or poses (n, 2 or 3) to the left of the path [m]."""
    poses, _ = path.poses(path.project(xy[:, :2])[1])
    across = xy[:, :2] - poses[:, :2]
    return across[:, 1] * np.cos(poses[:, 2]) - across[:, 0] * np.sin(poses[:, 2])


def _held(t_s, values):
    """Coordinates of a line through values that are held until the next time."""
    return np.repeat(t_s, 2)[1:], np.repeat(values, 2)[:-1]


def picture_of(run, k, snapshot):
    """The Picture of sample k of a run, with the Snapshot of that sample."""
    t_s = run.columns["t_s"][k]
    reach_s = paper.DT_S * max(run.scenario.estimation_horizon, run.scenario.prediction_horizon)
    mine = dict(colour=field_run.colour_of(run.scenario))
    title = f"in the row, ahead is right [m], at {t_s:.1f} s"
    reach_m = reach_s * run.scenario.speed_mps + 0.7
    window = f"{field_run.name_of(run.scenario)}’s window and robot"
    legend = [Mark(x=np.empty(0), y=np.empty(0), **look) for look in _LEGEND]
    legend.append(Mark("line", np.empty(0), np.empty(0), **mine, label=window))
    view = view_of(run, k, snapshot) | dict(reach_m=reach_m, **mine)
    above = Panel(title, (-reach_m, reach_m), (-0.55, 0.55), legend, "equal", view)
    panels = dict(
        above=above,
        across=_across(run, k, snapshot, reach_s, mine),
        yaw_rate=_yaw_rate(run, k, snapshot, reach_s, mine),
    )
    return Picture(("above above", "across yaw_rate"), panels)


def view_of(run, k, snapshot):
    """What draw_robot_view of robot_view.js needs to know of sample k of a run."""
    c = run.columns
    upto = slice(0, k + 1)
    driven = slice(max(0, k + 1 - _DRIVEN_SAMPLES), k + 1)
    measured = slice(max(0, k + 1 - _MEASURED_SAMPLES), k + 1)
    camera = run.path.poses(c["s_m"][k : k + 1])[0]
    ahead_m = c["s_m"][k] + np.linspace(-6, 6, 41)
    ahead_m = ahead_m if run.path.closed else np.clip(ahead_m, 0, run.path.length_m)
    return dict(
        camera=camera[0],
        path=run.path.poses(ahead_m)[0],
        plants=plants_of(run.path),
        poses=np.column_stack([c[name][upto] for name in ("x_m", "y_m", "theta_rad")]),
        pose=snapshot.truth,
        estimate=snapshot.estimate[:3],
        covariance=snapshot.covariance,
        variances=snapshot.kappa_variance,
        growth=snapshot.kappa_growth,
        telling_samples=_TELLING_SAMPLES,
        driven=np.column_stack([c["x_m"][driven], c["y_m"][driven]]),
        measured=np.column_stack([c["x_meas_m"][measured], c["y_meas_m"][measured]]),
        window=snapshot.window,
        desired=snapshot.desired,
        plan=snapshot.plan,
        commanded_mps=snapshot.commanded_mps,
        ground_mps=snapshot.ground_mps,
        robot_m=(paper.ROBOT_LENGTH_M, paper.ROBOT_WIDTH_M),
        track_width_m=paper.TRACK_WIDTH_M,
        tolerance_m=paper.TOLERANCE_M,
    )


def _over_time(run, k, reach_s):
    """The last samples as a slice, their times from now, and the limits of the time [s]."""
    past = slice(max(0, k - round(reach_s / paper.DT_S)), k + 1)
    t_s = run.columns["t_s"]
    return past, t_s[past] - t_s[k], (-reach_s - 0.1, reach_s + 0.1)


def _now(ylim):
    return Mark("line", np.zeros(2), np.array(ylim), width=0.5)


def _across(run, k, snapshot, reach_s, mine):
    """Panel of distances to the left of the path, over time from now."""
    past, ago_s, time = _over_time(run, k, reach_s)

    def mark(kind, xy, t_s, **look):
        return Mark(kind, t_s, _distance_left(run.path, xy), **look)

    driven = np.column_stack([run.columns["x_m"][past], run.columns["y_m"][past]])
    past_s = paper.DT_S * np.arange(1 - len(snapshot.window), 1)
    plan_s = paper.DT_S * np.arange(len(snapshot.plan))
    marks = [
        mark("line", driven, ago_s, **_THIN),
        mark("dots", snapshot.measured, past_s, width=3, **_MEASURED),
        mark("line", snapshot.window, past_s, **mine),
        mark("dots", snapshot.window, past_s, **_NODES, **mine),
        mark("line", snapshot.plan, plan_s, **_PLAN),
        mark("dots", snapshot.plan, plan_s, **_NODES, **_PLAN),
    ]
    largest = np.nanmax(np.abs(np.concatenate([mark.y for mark in marks])), initial=0)
    across_m = field_run.round_up_to(1.05 * largest)
    tolerance = (-paper.TOLERANCE_M, paper.TOLERANCE_M)
    beneath = [
        field_run.rectangle(time, tolerance, **field_run.FAINT_TOLERANCE),
        field_run.level(time, 0, **field_run.DASHED),
        _now((-across_m, across_m)),
    ]
    title = "beside the path, to the left [m], over time from now [s]"
    return Panel(title, time, (-across_m, across_m), beneath + marks)


def _yaw_rate(run, k, snapshot, reach_s, mine):
    """Panel of commanded and planned yaw rates, over time from now."""
    past, ago_s, time = _over_time(run, k, reach_s)
    bound = run.scenario.omega_max_radps
    plan_s = paper.DT_S * np.arange(len(snapshot.plan))
    planned = np.append(snapshot.omega_radps, snapshot.omega_radps[-1])
    rates = (-1.25 * bound, 1.25 * bound)
    marks = [field_run.level(time, at, **field_run.DASHED) for at in (-bound, bound)]
    marks += [
        _now(rates),
        Mark("line", *_held(ago_s, run.columns["omega_cmd_radps"][past]), **mine),
        Mark("line", *_held(plan_s, planned), **_PLAN),
    ]
    return Panel("yaw rate [rad/s]: commanded, planned", time, rates, marks)
