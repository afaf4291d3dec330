"""One or two field runs in six panels: trajectory, error, μ, κ, yaw rate and KKT tolerance."""

import numpy as np
from scipy.ndimage import median_filter

from rhec import paper, style
from rhec.explorer.panels import Mark, Panel, Picture
from rhec.style import BLACK, COLOURS

ZOOMS = ("whole path", "first row", "worst place")
_THIN = dict(width=0.5)  # other lines have a pixel; wider ones take a page five times as long
_FAINT = dict(alpha=0.4)
DASHED = _THIN | dict(dash=(2.4, 1.5))  # reference and bounds
_TOLERANCE = _FAINT | dict(colour=COLOURS["tolerance"])

# Names of the panels in the rows and columns of the picture.
_LAYOUT = ("map mu", "map kappa", "error yaw_rate", "error kkt")
_MOST_POINTS = 300  # largest number of points of the soil along one side

# Lines of a run: panel, columns along x and y, look, and what a value of it is besides the run's.
_SERIES = (
    ("map", "x_m", "y_m", "bold", ""),
    ("error", "t_s", "error_m", "faint", "by GNSS"),
    ("error", "t_s", "error_true_m", "bold", ""),
    ("mu", "t_s", "mu", "truth", ""),
    ("mu", "t_s", "mu_hat", "bold", ""),
    ("kappa", "t_s", "kappa", "truth", ""),
    ("kappa", "t_s", "kappa_hat", "bold", ""),
    ("yaw_rate", "t_s", "omega_cmd_radps", "bold", ""),
    ("kkt", "t_s", "kkt_rhc", "faint", "RHC"),
    ("kkt", "t_s", "kkt_rhe", "bold", ""),
)
_KKT_SAMPLES = 25  # of the running median: from sample to sample it jumps by powers of ten
_LOOKS = {"bold": {}, "faint": _THIN | _FAINT, "truth": _THIN | dict(colour=BLACK)}
# In the words of the live page.
_TITLES = {
    "error": "True distance from the path [m]; faint: by GNSS",
    "mu": "μ: estimate; thin: truth",
    "kappa": "κ: estimate; thin: truth",
    "yaw_rate": "Commanded yaw rate [rad/s]; dashed: its bounds",
    "kkt": f"KKT tolerance: RHE (bold), RHC; median of {_KKT_SAMPLES * paper.DT_S:g} s",
}


def places_beside(poses, across_m):
    """Points (n, 2) at a distance to the left of poses (n, 3) [m]."""
    return poses[:, :2] + across_m * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])


def rectangle(xlim, ylim, **look):
    """The area between these limits."""
    return Mark("area", np.repeat(xlim, 2), np.array([*ylim, *ylim[::-1]]), **look)


# Limits in coarse steps, which do not change with small changes of the data


def round_up_to(value):
    """The smallest 0.15 · 2ⁿ, n = 0, 1, …, not below the value."""
    return 0.15 * 2.0 ** np.ceil(np.log2(max(value, 0.15) / 0.15))


def _common_range(columns, *names):
    """The 1 % and the 95 % quantile of the positive values of these columns of several runs.

    So what is rare, such as the error of an offset start, may be cut off. (1, 1) without values.
    """
    values = np.concatenate([run[name] for run in columns for name in names])
    values = values[np.isfinite(values) & (values > 0)]
    return np.quantile(values, [0.01, 0.95]) if len(values) else (1.0, 1.0)


def _limits(columns, bound):
    """{panel: limits} for nearly all values, in coarse steps."""
    limits = dict(error=(0.0, round_up_to(_common_range(columns, "error_true_m")[1])))
    for name in ("mu", "kappa"):
        low, _ = _common_range(columns, name, f"{name}_hat")
        limits[name] = next((each for each in (0.8, 0.6, 0.4, 0.2) if low > each), 0.0), 1.02
    limits["yaw_rate"] = -1.25 * bound, 1.25 * bound
    low, high = np.floor(np.log10(_common_range(columns, "kkt_rhe", "kkt_rhc")))
    limits["kkt"] = 10.0**low, 10.0 ** (high + 1)
    return limits


def _worst_place(run):
    """The position (x, y) [m] of the largest true error after settling."""
    c = run.columns
    is_before = c["t_s"] < run.metrics["settling_time_s"]
    k = np.argmax(np.where(is_before, 0, np.nan_to_num(c["error_true_m"])))
    return c["x_m"][k : k + 1], c["y_m"][k : k + 1]


def _map_limits(run, zoom):
    """((x, x_end), (y, y_end), scale) of a zoom."""
    path = run.path
    start_m = abs(run.scenario.start_offset_m)
    margin_m = 2.0
    if zoom == "first row":
        margin_m = 1.1 * round_up_to(start_m)
        end = path.segments[1, 0] if len(path.segments) > 1 else path.length_m
        points = path.poses([0.0, end])[0][:, :2]
    elif zoom == "worst place":
        points = np.round(np.transpose(_worst_place(run)))
    else:
        margin_m += start_m
        points = np.reshape(path.box, (2, 2)).T
    ends = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
    return *np.transpose(ends).tolist(), "" if zoom == "first row" else "equal"


def picture_of(runs, pinned, zoom, soil):
    """The Picture of field runs.

    Args:
        runs, pinned: Up to two runs each; pinned runs are dashed.
        zoom: One of ZOOMS.
        soil: Slip field on the map, "mu" or "kappa".
    """
    first = runs[0]
    columns = [run.columns for run in (*runs, *pinned)]
    time = 0.0, float(max(run["t_s"][-1] + paper.DT_S for run in columns))
    bound = first.scenario.omega_max_radps
    limits = _limits(columns, bound)
    marks = {panel: _curves(first, ylim) for panel, ylim in limits.items()}
    marks["error"].append(rectangle(time, (0.0, paper.TOLERANCE_M), **_TOLERANCE))
    marks["yaw_rate"] += [
        Mark("line", np.array(time), np.array([at, at]), **DASHED) for at in (-bound, bound)
    ]
    marks["map"] = _ground(first, soil)
    drawn = [("", run, place) for place, run in enumerate(runs)]
    drawn += [("pinned ", run, place) for place, run in enumerate(pinned)]
    for kind, run, place in reversed(drawn):
        for panel, mark in _series(kind, run, place):
            marks[panel].append(mark)
    c = first.columns
    ring = dict(colour=COLOURS["EKF"], width=9, full=False)
    marks["map"] += [
        Mark("dots", c["x_m"][:1], c["y_m"][:1], width=3.5),
        Mark("dots", *_worst_place(first), **ring),
    ]
    x, y, scale = _map_limits(first, zoom)
    stretched = "" if scale else "; y is stretched"
    title = f"Field [m], brown where {dict(mu='μ', kappa='κ')[soil]} is low{stretched}"
    panels = dict(map=Panel(title, x, y, marks["map"], scale))
    for name, title in _TITLES.items():
        scale = "log" if name == "kkt" else ""
        panels[name] = Panel(title, time, limits[name], marks[name], scale, "t [s]")
    return Picture(_LAYOUT, panels)


def _curves(run, ylim):
    """Grey areas for the times in curved parts of the path."""
    edges = np.flatnonzero(np.diff(~run.columns["on_straight"], prepend=False, append=False))
    times = np.append(run.columns["t_s"], run.columns["t_s"][-1] + paper.DT_S)[edges]
    return [rectangle(span, ylim, alpha=0.07) for span in times.reshape(-1, 2)]


def _ground(run, soil):
    """Marks of the soil and of the path with its tolerance."""
    terrain = run.terrain
    field = getattr(run.terrain, soil)
    every = -(-max(field.shape) // _MOST_POINTS)
    grid = (at + terrain.cell_m * np.arange(n) for at, n in zip(terrain.origin_m, field.shape))
    length_m = run.path.length_m
    poses, _ = run.path.poses(np.append(np.arange(0, length_m, 0.25), length_m))
    left, right = (places_beside(poses, side * paper.TOLERANCE_M) for side in (1, -1))
    return [
        Mark("soil", *(at[::every] for at in grid), traction=field[::every, ::every]),
        Mark("area", *np.concatenate([left, right[::-1]]).T, **_TOLERANCE),
        Mark("line", *poses[:, :2].T, **DASHED, label="path, and bounds"),
    ]


def _series(kind, run, place):
    """Yield (panel, Mark) for each line of a run."""
    for panel, x, y, look, note in _SERIES:
        drawn = dict(colour=style.colour_of(run.scenario.estimator)) | _LOOKS[look]
        if kind and look != "bold":
            continue
        if kind or (look == "truth" and place):
            drawn |= _FAINT | dict(dash=DASHED["dash"])
        label = kind + style.label_of(run.scenario.estimator)
        if look == "truth":
            note = f"of {label}" if place else ""
            label = "truth"
        values = run.columns[y]
        if panel == "kkt":
            values = median_filter(values, _KKT_SAMPLES, mode="nearest")
        yield panel, Mark("line", run.columns[x], values, label=label, note=note, **drawn)
