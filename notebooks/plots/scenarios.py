"""The paper's Figures 6 to 13, drawn from finished runs.

`run` is a Run of `rhec.simulate`, `drives` are Runs with different seeds, `table` is a table of
`notebooks.studies.scenario_tables`. Bands and thin lines are the middle 90 % of the drives,
thick lines are 95 % intervals of the mean. Numbers that the paper reports are included.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from notebooks.plots import parts
from notebooks.studies import names
from notebooks.studies.scenario_tables import REPORTED, over_fields
from notebooks.studies.tables import interval_text, with_minus
from rhec import paper
from rhec.simulation.offline import SETTLED_S, run_estimator
from rhec.style import BLACK, COLOURS, COLUMN_IN, DOUBLE_IN, SKY, colour_of, styled

_TRACTION = LinearSegmentedColormap.from_list("traction", [COLOURS["soil"], "1"])
_TRACTION_STEP = 0.05
_TRACTION_BAR = dict(extend="min", fraction=0.03, pad=0.02)
_KKT = {"RHE": "RHE", "RHC": "oracle"}
_LEAST_KKT = 1e-5
_POOLED = round(1 / paper.DT_S)  # samples of one second
_MARGIN_M = 3.0  # around a drive on the map
_MOST_BESIDE_M = 0.25  # ends of the axis of the distance beside the path
_MOST_ERROR_M = 0.3  # upper end of the axis of one drive's error
_MOST_DIFFERENCE_M = 0.05  # ends of the axis of the difference of two errors
_EXCERPT_S = 30.0  # length of the time span that shows κ
_NEAR_BOUND = 1e-6  # an estimate this near a bound is at it
_SPEEDS = (  # column, role of its colour, label, width of its line
    ("nu_meas_mps", "measured", "measured", 0.5),
    ("nu_mps", "truth", "true", 0.6),
    ("nu_hat_mps", "RHE", "estimated (RHE)", 1.6),
)
_LINES = {
    "Q1": dict(color=COLOURS["Q1"], label="$Q^1$"),
    "Q2": dict(color=COLOURS["Q2"], label="$Q^2$"),
    "Q2, look-ahead": dict(color=COLOURS["Q2"], label="$Q^2$, look-ahead", dashes=(3, 1.5)),
    "Q3": dict(color=COLOURS["Q3"], label="$Q^3$"),
    "RHE": dict(color=COLOURS["RHE"], label="RHE"),
    "EKF": dict(color=COLOURS["EKF"], label="EKF"),
}


def _title(run):
    """Process noise, world, turns and seed of a run, for a title."""
    scenario = run.scenario
    return f"{names.noise_text(scenario.process_noise)}, {_where(run)}, seed {scenario.seed}"


def _where(run):
    """The world and the turns of a run, for a title."""
    return f"{parts.world_text(run.scenario)}, {names.turns_text(run.scenario.turns)}"


def _fields(drives):
    """The number of fields and their seeds, for a title."""
    seeds = [run.scenario.seed for run in drives]
    if len(seeds) == 1:
        return f"1 field (seed {seeds[0]})"
    return f"{len(seeds)} fields (seeds {min(seeds)} to {max(seeds)})"


def _over(drives):
    """Description of a line and its band, for a title."""
    noise = names.noise_text(drives[0].scenario.process_noise)
    return f"{noise}, {_where(drives[0])}: median, middle 90 % of {_fields(drives)}"


def _time_axis(axes, log):
    """Label the time axis, and shade the curved parts of the path."""
    parts.time_axis(axes, log["t_s"], ~log["on_straight"], "curved parts of the path")


def _field(axes, terrain, values):
    """Draw a slip field as a map, with the same colours for μ and κ; return the image."""
    left, bottom = np.subtract(terrain.origin_m, terrain.cell_m / 2)
    width, height = np.array(values.shape) * terrain.cell_m
    extent = (left, left + width, bottom, bottom + height)
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.grid(visible=False)
    look = dict(origin="lower", interpolation="bilinear", cmap=_TRACTION, vmax=1)
    return axes.imshow(values.T, extent=extent, vmin=_darkest(terrain), **look)


def _darkest(terrain):
    """The traction at the dark end of the maps: nearly all of the soil is lighter."""
    least = np.quantile([terrain.mu, terrain.kappa], 0.01)
    return np.floor(least / _TRACTION_STEP) * _TRACTION_STEP


def _reference(axes, path, up_to_m=None):
    """Draw the reference trajectory up to an arc length [m], by default the whole path."""
    poses, _ = path.poses(np.arange(0, (up_to_m or path.length_m) + 0.05, 0.1))
    axes.plot(*poses[:, :2].T, **parts.BOUND | dict(linewidth=0.8, label="reference"))


def _first_row(run):
    """The log until the robot leaves the first straight of the path."""
    _, s = run.path.project(run.log[["x_m", "y_m"]])
    return run.log[np.minimum.accumulate(run.path.poses(s)[1] == 0)]


@styled
def trajectories_q(runs, table=None):
    """Draw Figure 6: trajectories on the first row from an offset start, and true errors over time.

    A dot marks the settling time, after which the true error stays within 0.12 m for 5 s. The title
    says whether these drives come in the order of the mean over many fields, if that is known.

    Args:
        runs: {yaw weight: Run}, weights "Q1", "Q2", "Q2, look-ahead" or "Q3".
        table: Table of `notebooks.studies.scenario_tables.scenario_a_table`, or None.
    """
    figure, (plane, time) = plt.subplots(2, figsize=(COLUMN_IN, 4.2))
    first = next(iter(runs.values()))
    rows = {name: _first_row(run) for name, run in runs.items()}
    ends = [first.path.project(log[["x_m", "y_m"]])[1].max() for log in rows.values()]
    _reference(plane, first.path, max(ends))
    for name, log in rows.items():
        look = _LINES[name]
        plane.plot(log["x_m"], log["y_m"], **look)
        time.plot(log["t_s"], log["error_true_m"], **look | dict(label=None))
        settled_s = runs[name].metrics["settling_time_s"]
        then_m = np.interp(settled_s, log["t_s"], log["error_true_m"])
        dot = dict(markersize=4, markeredgecolor="w", clip_on=False, zorder=3)
        time.plot(settled_s, then_m, "o", color=look["color"], **dot)
    time.axhline(paper.TOLERANCE_M, **parts.BOUND)
    time.axhspan(0, paper.TOLERANCE_M, **parts.TOLERANCE)
    place = dict(xycoords=("axes fraction", "data"), ha="right", va="baseline")
    parts.note(time, f"{paper.TOLERANCE_M} m", (1, paper.TOLERANCE_M), (0, 2), **place)
    end_s = max(log["t_s"].iloc[-1] for log in rows.values())
    time.set(xlim=(0, 1.02 * end_s), ylim=0, xlabel="time [s]  (dots: settling time)")
    time.set_ylabel("true error [m]")
    order = "" if table is None else f"\n{_order(runs, table)}"
    scenario = first.scenario
    noise = names.noise_text(scenario.process_noise)
    title = f"First row: {noise}, {parts.world_text(scenario)}, seed {scenario.seed}{order}"
    plane.set(xlabel="$x$ [m]", title=title)
    figure.legend(loc="outside lower center", ncols=3)
    figure.draw_without_rendering()
    plane.set_ylabel(f"$y$ [m], stretched × {_stretch(plane):.0f}")
    return figure


def _stretch(axes):
    """How many times as long a metre of y is drawn as one of x."""
    width, height = axes.get_window_extent().size
    return (height / np.diff(axes.get_ylim())[0]) / (width / np.diff(axes.get_xlim())[0])


def _order(runs, table):
    """The order of the drives' mean errors, and whether the means over fields have another one."""
    means = table[table["quantity"] == "mean error, true [m]"].set_index("weight")
    weights = [name for name in runs if name in means.index and "," not in name]
    here = sorted(weights, key=lambda name: runs[name].metrics["mean_error_true_m"])
    overall = sorted(weights, key=lambda name: means.loc[name, "mean"])

    def words(names):
        return " < ".join(_LINES[name]["label"] for name in names)

    fields = f"the mean of {means['n'].max()} fields"
    if here == overall:
        return f"mean errors {words(here)}, as in {fields}"
    return f"mean errors {words(here)}, against {fields}:\n{words(overall)}"


@styled
def slip_fields(terrain, path, title):
    """Draw the slip fields μ and κ [-] as maps with the path.

    Args:
        terrain: The rhec.Terrain.
        path: The rhec.Path.
        title: Name of the fields.
    """
    figure, both = parts.panels_beside(2, 3.0)
    for axes, values, name in zip(both, (terrain.mu, terrain.kappa), (r"$\mu$", r"$\kappa$")):
        image = _field(axes, terrain, values)
        _reference(axes, path)
        axes.set_title(f"{name}: mean {values.mean():.3f}, deviation {values.std():.3f}")
    both[1].set_ylabel("")
    figure.colorbar(image, ax=both, label=r"traction $\mu$, $\kappa$ [-]", **_TRACTION_BAR)
    figure.suptitle(title, fontsize=8)
    return figure


@styled
def trajectories(pairs):
    """Draw Figure 7: the drives on the map of κ, and below how far each robot is beside the path.

    The paper draws both trajectories on the field, where they cannot be told apart. Here the true
    distance to the path, positive to its left, is drawn along it.

    Args:
        pairs: {process noise: {"RHE": Run, "EKF": Run}} on the same terrain. The map has the first
            pair.
    """
    first = next(iter(pairs.values()))
    size = dict(figsize=(DOUBLE_IN, 2.6 + 1.1 * len(pairs)))
    figure, (plane, *panels) = plt.subplots(
        1 + len(pairs), height_ratios=(2.2, *[1] * len(pairs)), **size
    )
    _on_the_map(figure, plane, first)
    for axes, runs in zip(panels, pairs.values()):
        _beside_the_path(axes, runs)
        axes.sharex(panels[-1])
    panels[-1].set_xlabel("way along the path [m]  (shaded: curved parts)")
    parts.legend_outside(figure, panels[-1], "lower center")
    return figure


def _on_the_map(figure, axes, runs):
    """Draw the trajectories of a pair on the map of κ."""
    first = runs["RHE"]
    image = _field(axes, first.terrain, first.terrain.kappa)
    _reference(axes, first.path)
    for name in ("EKF", "RHE"):
        log = runs[name].log
        # The RHE is drawn last and narrow, so that both lines show where they agree.
        wide = dict(linewidth=1.8) if name == "EKF" else {}
        axes.plot(log["x_m"], log["y_m"], **_LINES[name] | dict(label=None), **wide)
    for row, marker in ((first.log.iloc[0], "o"), (first.log.iloc[-1], "s")):
        axes.plot(row["x_m"], row["y_m"], marker, color=BLACK, markersize=3, zorder=4)
    low = first.log[["x_m", "y_m"]].min() - _MARGIN_M
    high = first.log[["x_m", "y_m"]].max() + _MARGIN_M
    axes.set(xlim=(low.x_m, high.x_m), ylim=(low.y_m, high.y_m))
    axes.set_title(f"{_title(first)}\n{_ends(first)}", loc="center")
    # Equal scales make the map narrower than its place in the grid: the bar stays beside the map.
    bar = axes.inset_axes((1.03, 0.0, 0.03, 1.0))
    figure.colorbar(image, cax=bar, label=r"$\kappa$ [-]", extend="min")


def _beside_the_path(axes, runs):
    """Draw how far the robots are beside the path, over the way along it."""
    first = runs["RHE"]
    largest = []
    mean_m = {}
    for name in ("EKF", "RHE"):
        log = runs[name].log
        lateral_m = _lateral(runs[name])
        axes.plot(log["s_m"], lateral_m, **_LINES[name])
        settled = log["t_s"] >= runs[name].metrics["settling_time_s"]
        words = f"{np.abs(lateral_m[settled]).max():.2f} m" if settled.any() else "never settles"
        largest.append(f"{name} {words}")
        mean_m[name] = lateral_m[settled].mean() if settled.any() else np.nan
    end_m = first.log["s_m"].iloc[-1]
    bound = dict(parts.BOUND, label=f"± {paper.TOLERANCE_M} m")
    axes.hlines([-paper.TOLERANCE_M, paper.TOLERANCE_M], 0, end_m, **bound)
    parts.shade(axes, first.log["s_m"], ~first.log["on_straight"])
    axes.grid(axis="x", visible=False)
    axes.set(xlim=(0, end_m), ylim=(-_MOST_BESIDE_M, _MOST_BESIDE_M))
    axes.set_ylabel("beside the\npath [m]")
    means = ", ".join(with_minus(f"{name} {mean_m[name]:+.3f} m") for name in runs)
    noise = names.noise_text(first.scenario.process_noise)
    axes.set_title(f"{noise}: mean after settling {means}; farthest {', '.join(largest)}")


def _lateral(run):
    """The true distances to the path, positive to its left [m]."""
    position = run.log[["x_m", "y_m"]].to_numpy()
    x, y, theta = run.path.poses(run.path.project(position)[1])[0].T
    return np.cos(theta) * (position[:, 1] - y) - np.sin(theta) * (position[:, 0] - x)


def _ends(run):
    """Where a drive begins and ends on the map, for a title: no label lies on the path then."""
    end = run.log.iloc[-1]
    words = f"from the dot to the square in {end['t_s'] + paper.DT_S:.0f} s"
    left_m = run.path.length_m - end["s_m"]
    if 0 < left_m < run.path.length_m / 2:
        words += f", {left_m:.0f} m of the lap left"
    return words


@styled
def errors(pairs):
    """Draw Figure 8: Euclidean errors by raw GNSS of one drive, as in the paper.

    Below each pair of errors is their difference, RHE − EKF, as a mean over a second: below 0 the
    RHE is nearer to the path.

    Args:
        pairs: {process noise: {"RHE": Run, "EKF": Run}} on the same terrain, a pair of panels each.
    """
    columns = 2 if len(pairs) > 1 else 1
    rows = -(-len(pairs) // columns)
    grid = dict(sharex=True, sharey="row", squeeze=False, height_ratios=(2.2, 1) * rows)
    size = dict(figsize=(DOUBLE_IN, 0.9 + 1.9 * rows))
    figure, panels = plt.subplots(2 * rows, columns, **size, **grid)
    above = panels[::2].ravel()
    below = panels[1::2].ravel()
    for axes, difference, runs in zip(above, below, pairs.values()):
        for name in ("EKF", "RHE"):
            _one_error(axes, name, runs[name])
        _beyond(axes, runs)
        axes.axhline(paper.TOLERANCE_M, **parts.BOUND, label=f"{paper.TOLERANCE_M} m")
        means = [f"{name} {runs[name].metrics['mean_error_m']:.4f} m" for name in ("RHE", "EKF")]
        axes.set_ylim(0, _MOST_ERROR_M)
        noise = names.noise_text(runs["RHE"].scenario.process_noise)
        axes.set_title(f"{noise}: {', '.join(means)}")
        _difference(difference, runs)
    for axes in (*above[len(pairs) :], *below[len(pairs) :]):
        axes.set_visible(False)
    for of_row in panels[::2, 0]:
        of_row.set_ylabel("error [m]")
    for of_row in panels[1::2, 0]:
        of_row.set_ylabel("RHE − EKF\n[m]")
    first = next(iter(pairs.values()))["RHE"]
    for column in panels.T:
        _time_axis(column, first.log)
    drive = f"{_where(first)}, seed {first.scenario.seed}"
    figure.suptitle(f"One drive: {drive}; in the titles its mean errors", fontsize=8)
    parts.legend_outside(figure, panels[0, 0], "lower center")
    return figure


def _difference(axes, runs):
    """Draw by how much the RHE's error is below or above the EKF's, as means over a second."""
    log = runs["RHE"].log
    seconds = len(log) // _POOLED
    t_s = log["t_s"].to_numpy()[: seconds * _POOLED : _POOLED]
    both = [runs[name].log["error_m"].to_numpy()[: seconds * _POOLED] for name in ("RHE", "EKF")]
    difference_m = np.nanmean((both[0] - both[1]).reshape(seconds, _POOLED), axis=1)
    shown_m = np.clip(difference_m, -_MOST_DIFFERENCE_M, _MOST_DIFFERENCE_M)
    for name, side in (("RHE", shown_m < 0), ("EKF", shown_m > 0)):
        look = dict(color=colour_of(name), alpha=0.6, linewidth=0, step="mid")
        axes.fill_between(t_s, np.where(side, shown_m, 0), **look)
    axes.axhline(0, color=BLACK, linewidth=0.6)
    axes.set_ylim(-_MOST_DIFFERENCE_M, _MOST_DIFFERENCE_M)


def _one_error(axes, name, run):
    """Draw the error of one drive over time; the paper's mean stands in the legend."""
    label = f"{name} (the paper's mean: {REPORTED[name, 'mean_error_m']} m)"
    # The RHE is drawn last and narrow, so that both lines show where they agree.
    width = {"EKF": 1.3, "RHE": 0.6}[name]
    look = dict(linewidth=width, color=colour_of(run.scenario.estimator), label=label)
    axes.plot(run.log["t_s"], run.log["error_m"], **look)


def _beyond(axes, runs):
    """Tell the largest error of each drive that leaves the axis once its start is over."""
    place = 0.97
    for name, run in runs.items():
        largest_m = run.log["error_m"][run.log["t_s"] >= SETTLED_S].max()
        if largest_m > _MOST_ERROR_M:
            colour = colour_of(run.scenario.estimator)
            look = dict(xycoords="axes fraction", color=colour, ha="right", va="top")
            look |= dict(bbox=dict(facecolor="w", edgecolor="none", pad=1.0))
            parts.note(axes, f"{name}: up to {largest_m:.1f} m", (0.98, place), **look)
            place -= 0.17


@styled
def violations(table, turns="alternate", world="default"):
    """Draw Figure 9: the share of drives without a violation, by raw GNSS.

    A drive has none if no sample on a straight is more than 0.12 m from the path. The paper's RHE
    has none in "multiple experiments", and its EKF has 17 in one drive. The mean number of
    violations stands beside each share.

    Args:
        table: Table of `notebooks.studies.scenario_tables.scenario_b_table`.
        turns: The pattern of turns that is shown.
        world: Name of the world, for the title.
    """
    shown = table[(table["turns"] == turns) & table["estimator"].isin(["RHE", "EKF"])]
    by_quantity = {
        name: shown[shown["quantity"] == name].set_index(["process_noise", "estimator"])
        for name in ("share of drives without a violation", "violations on straights, raw GNSS")
    }
    shares, counts = by_quantity.values()
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 0.9 + 0.22 * len(shares)))
    place_of = dict(xycoords=("axes fraction", "data"))
    for place, row in enumerate(shares.itertuples()):
        colour = colour_of(row.Index[1])
        axes.hlines(place, 100 * row.low, 100 * row.high, linewidth=3, color=colour, alpha=0.6)
        axes.plot(100 * row.mean, place, "|", color=colour, markersize=7, markeredgewidth=1.2)
        look = dict(color=BLACK, markerfacecolor="none", markersize=5, clip_on=False)
        axes.plot(100 * row.paper, place, "D", label="the paper", zorder=4, **look)
        count = counts.loc[row.Index]
        text = interval_text(count["mean"], max(count["low"], 0), count["high"])
        parts.note(axes, text, (1, place), (8, 0), **place_of)
    labels = [f"{names.noise_text(noise)}: {name}" for noise, name in shares.index]
    words = f"drives without a violation [%]: share of {shares['n'].max()} fields, 95 % interval"
    axes.set_yticks(range(len(labels)), labels)
    axes.set(ylim=(len(labels) - 0.5, -0.5), xlim=(0, 100), xlabel=words)
    axes.grid(axis="y", visible=False)
    where = f"{world} world, {names.turns_text(turns)}"
    axes.set_title(f"{where[0].upper()}{where[1:]}; at the right violations in a drive, mean")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[:1], labels[:1], loc="outside lower center")
    return figure


@styled
def estimates(drives):
    """Draw Figure 10: the RHE's yaw error, and traction with the bounds of eq. (14).

    Each column shows the first drive over time, with bands of two standard deviations by the
    covariance of the RHE; of κ, which may jump at every sample, only a few seconds. Beside it are
    the frequencies of the same quantities in all drives.

    Args:
        drives: {title: drives}, a column for each.
    """
    grid = dict(sharey="row", squeeze=False, width_ratios=(3, 1) * len(drives))
    figure, rows = plt.subplots(3, 2 * len(drives), figsize=(DOUBLE_IN, 4.6), **grid)
    least = _least_mu(drives)
    for time, beside, (title, runs) in zip(rows.T[::2], rows.T[1::2], drives.items()):
        _one_estimate(time, runs[0])
        _many_estimates(beside, runs, least)
        name = f"{title}, seed {runs[0].scenario.seed}"
        time[0].set_title(f"{name}\n{time[0].get_title('left')}")
        beside[0].set_title(f"{len(runs)} drives", loc="center")
        log = runs[0].log
        for axes, limits in zip(time, [(0, log["t_s"].max())] * 2 + [_excerpt(log)]):
            parts.shade(axes, log["t_s"], ~log["on_straight"])
            axes.grid(axis="x", visible=False)
            axes.set_xlim(limits)
        time[1].set_xlabel("time [s]  (shaded: curves)")
        time[2].set_xlabel("time [s], an excerpt")
    labels = ("yaw error [rad],\ncut at ± 0.3", f"$\\mu$ [-],\ncut at {least:g}")
    limits = ((-0.3, 0.3), (least, 1 + (1 - least) / 5), (-0.06, 1.1))
    for axes, label, limit in zip(rows[:, 0], (*labels, r"$\kappa$ [-]"), limits):
        axes.set(ylabel=label, ylim=limit)
    parts.legend_outside(figure, rows[1, 0], "lower center")
    return figure


def _excerpt(log):
    """A time span [s] about the end of the first curve: κ shows in the curve, not on the row."""
    curves = log["t_s"][~log["on_straight"]]
    is_last = curves.diff().shift(-1, fill_value=np.inf) > 1  # of its curve
    end_s = min(curves[is_last], default=log["t_s"].max())
    return end_s - _EXCERPT_S / 2, end_s + _EXCERPT_S / 2


def stated(run):
    """The estimates of yaw error, μ and κ in a run, with their standard deviations and the truth.

    Args:
        run: A Run whose estimator has a covariance.

    Returns:
        {name: (estimate, its standard deviation, truth, share of samples, settled, in which the
        truth is within two standard deviations)}, arrays (n,). The yaw's entry is its error, whose
        truth is 0.
    """
    recorded = run_estimator(run.scenario, run, "estimate", "covariance")
    estimate = recorded["estimate"]
    sigma = np.sqrt(np.diagonal(recorded["covariance"], axis1=1, axis2=2))
    settled = run.columns["t_s"] >= SETTLED_S
    entries = {}
    for name, place in (("theta_rad", 2), ("mu", 4), ("kappa", 5)):
        value = estimate[:, place]
        truth = run.columns[name]
        if name == "theta_rad":
            value = value - truth
            truth = 0 * truth
        inside = np.abs(value - truth) <= 2 * sigma[:, place]
        entries[name] = value, sigma[:, place], truth, inside[settled].mean()
    return entries


def _one_estimate(panels, run):
    """Draw yaw error, μ and κ of a drive over time, with ± 2 σ and the truth."""
    t_s = run.log["t_s"]
    symbols = (r"$\hat\theta-\theta$", r"$\mu$", r"$\kappa$")
    for axes, (name, stated_), symbol in zip(panels, stated(run).items(), symbols):
        value, sigma, truth, inside = stated_
        look = dict(color=SKY, alpha=0.45, linewidth=0, label="± 2 σ of the RHE")
        axes.fill_between(t_s, value - 2 * sigma, value + 2 * sigma, **look)
        if name in ("mu", "kappa"):  # before the estimate, which is often at a bound
            axes.hlines([0, 1], *t_s.iloc[[0, -1]], label="constraints", **parts.BOUND)
        axes.plot(t_s, value, color=COLOURS["RHE"], linewidth=0.8, label="estimate")
        axes.plot(t_s, truth, color=COLOURS["truth"], linewidth=0.8, label="truth")
        title = f"{symbol}: {100 * inside:.0f} % within ± 2 σ"
        if name in ("mu", "kappa"):
            at_bound = np.mean((value < _NEAR_BOUND) | (value > 1 - _NEAR_BOUND))
            title += f", {100 * at_bound:.0f} % at a bound"
        axes.set_title(title)


def _least_mu(drives):
    """A tenth below nearly all values of μ and of its estimates."""
    runs = [run.columns for several in drives.values() for run in several]
    values = np.concatenate([run[name] for run in runs for name in ("mu", "mu_hat")])
    return np.floor(10 * np.quantile(values, 0.001)) / 10


def _many_estimates(panels, runs, least_mu):
    """Draw how frequent yaw errors and values of μ and κ are in all drives."""
    settled = runs[0].columns["t_s"] >= SETTLED_S
    logs = [run.columns for run in runs]
    error = [log["theta_hat_rad"] - log["theta_rad"] for log in logs]
    for axes, estimate, truth, limits in [
        (panels[0], error, None, (-0.3, 0.3)),
        (panels[1], [log["mu_hat"] for log in logs], "mu", (least_mu, 1.0)),
        (panels[2], [log["kappa_hat"] for log in logs], "kappa", (0.0, 1.0)),
    ]:
        parts.frequencies(axes, np.array(estimate)[:, settled], limits, COLOURS["RHE"])
        if truth:
            values = np.array([log[truth] for log in logs])[:, settled]
            parts.frequencies(axes, values, limits, COLOURS["truth"])
    panels[-1].set_xlabel("share [%]")


@styled
def speed(drives):
    """Draw Figure 11: measured, estimated and true speed of the tracks ν, of one drive and of many.

    The first drive is drawn over time, as in the paper; beside it are frequencies in all drives.
    """
    panels = dict(figsize=(DOUBLE_IN, 2.4), sharey=True, width_ratios=(5, 1))
    figure, (axes, beside) = plt.subplots(1, 2, **panels)
    log = drives[0].log
    settled = drives[0].columns["t_s"] >= SETTLED_S
    limits = log["nu_meas_mps"].agg(["min", "max"])
    deviations = []
    for column, name, label, width in _SPEEDS:
        axes.plot(log["t_s"], log[column], color=COLOURS[name], linewidth=width, label=label)
        values = np.array([run.columns[column] for run in drives])[:, settled]
        parts.frequencies(beside, values, limits, COLOURS[name], bins=100)
        deviations.append(f"{label} {values.std():.3f}")
    axes.axhline(drives[0].scenario.speed_mps, **parts.BOUND, label="reference")
    axes.set(ylabel=r"speed $\nu$ [m/s]", title=f"One drive: {_title(drives[0])}")
    beside.set(title="all drives", xlabel="share [%]")
    _time_axis([axes], log)
    words = f"standard deviations [m/s]: {', '.join(deviations)}"
    figure.suptitle(f"{_fields(drives)}, {words}", fontsize=8)
    parts.legend_outside(figure, axes, "lower center")
    return figure


@styled
def yaw_rate(run):
    """Draw Figure 12: the yaw rate commanded by the RHC, its bounds, and the actual one ω."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.3))
    t_s, actual, commanded = (run.log[name] for name in ("t_s", "omega_radps", "omega_cmd_radps"))
    axes.plot(t_s, actual, color=COLOURS["truth"], linewidth=0.6, label="actual (tracks)")
    look = dict(color=COLOURS["RHE"], linewidth=0.9)
    axes.step(t_s, commanded, where="post", label="reference (RHC)", **look)
    bound = run.scenario.omega_max_radps
    axes.hlines([-bound, bound], *t_s.iloc[[0, -1]], label="bounds", **parts.BOUND)
    parts.legend_outside(figure, axes, "lower center")
    # A command is held until the next sample, so it belongs to the yaw rate one row later.
    rms = np.sqrt(np.mean((actual.to_numpy()[1:] - commanded.to_numpy()[:-1]) ** 2))
    title = f"{_title(run)}: actual − reference, RMS {rms:.3f} rad/s"
    axes.set(ylabel=r"yaw rate $\omega$ [rad/s]", title=title)
    _time_axis([axes], run.log)
    return figure


@styled
def kkt(drives):
    """Draw Figure 13: KKT tolerances of RHE and RHC after one Gauss-Newton iteration.

    Time is logarithmic, because the transient ends after two or three samples.
    """
    figure, panels = parts.panels_beside(2, 2.2)
    for axes, name in zip(panels, _KKT):
        tolerance = over_fields(drives, f"kkt_{name.lower()}")
        t_s = paper.DT_S * np.arange(1, tolerance.shape[1] + 1)
        colour = COLOURS[_KKT[name]]
        low, middle, high = np.maximum(tolerance, _LEAST_KKT / 2)
        axes.fill_between(t_s, low, high, alpha=0.25, linewidth=0, color=colour)
        axes.plot(t_s, middle, linewidth=0.8, color=colour)
        largest_s = t_s[tolerance[1].argmax()]
        most = tolerance[1].max()
        title = f"{name}: largest median {most:.2g}, at {largest_s:.1f} s"
        axes.set(xscale="log", yscale="log", title=title, xlim=(t_s[0], t_s[-1]))
        axes.set_xlabel("time [s], logarithmic; the first sample is at 0.2 s")
        axes.set_xticks(ticks := [1, 10, 100], ticks)
        axes.minorticks_off()
    # The axis has a lower limit, because the RHC's tolerance is 0 if all commands are at a bound.
    panels[0].set(ylabel="KKT tolerance [-], cut at $10^{-5}$", ylim=_LEAST_KKT)
    figure.suptitle(_over(drives), fontsize=8)
    return figure
