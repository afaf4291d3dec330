"""Figures of a replayed log.

`replays` is {estimator: samples of a perturbed replay} (`notebooks.further.recorded.scores`), and
`title` is plain text. Figures leave out what a log does not contain, such as the true pose.
"""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.further.recorded import scores
from notebooks.plots.parts import legend_above, time_axis
from rhec.style import COLOURS, DOUBLE_IN, ORANGE, PURPLE, SKY, styled

_COLOURS = {name: COLOURS[name] for name in ("RHE", "EKF")}
_COLOURS |= {"RHE, ν over the window": PURPLE}
# Turning more slowly counts as straight; the median over _SMOOTH samples removes encoder noise.
_STRAIGHT_RADPS = 0.05
_SMOOTH = 11


def _rows(n, height_in, sharey):
    """A figure with n panels one below the other."""
    size = (DOUBLE_IN, 0.4 + height_in * n)
    figure, panels = plt.subplots(n, figsize=size, sharex=True, sharey=sharey, squeeze=False)
    return figure, panels[:, 0]


def _broken(samples, *columns):
    """Columns as arrays with a NaN after each segment, which interrupts lines."""
    gap = np.full((1, len(columns)), np.nan)
    columns = list(columns)
    segments = [part[columns].to_numpy(dtype=float) for _, part in samples.groupby("segment")]
    return np.concatenate([np.append(part, gap, axis=0) for part in segments]).T


def _time_axis(axes, samples):
    """Label the time axis, and shade straight driving and standing."""
    turning = samples["omega_meas_radps"].abs().rolling(_SMOOTH, center=True, min_periods=1)
    straight = (turning.median() < _STRAIGHT_RADPS) & (samples["segment"].diff(-1) == 0)
    shaded = f"straight or standing, below {_STRAIGHT_RADPS} rad/s"
    time_axis(axes, samples["t_s"], straight, shaded)


@styled
def replay_yaw(replays):
    """Draw the yaw error with two standard deviations, or the yaw if the log has no truth."""
    figure, panels = _rows(len(replays), 1.2, sharey=True)
    with_truth = [samples for samples in replays.values() if "theta_rad" in samples]
    errors = [scores.yaw_error(samples) for samples in with_truth]
    for axes, (name, samples) in zip(panels, replays.items()):
        has_truth = "theta_rad" in samples
        value = scores.yaw_error(samples) if has_truth else samples["theta_hat_rad"]
        t, value, sigma = _broken(samples.assign(value=value), "t_s", "value", "sigma_theta_rad")
        value[np.abs(np.diff(value, prepend=np.nan)) > np.pi] = np.nan  # no line from π to -π
        axes.plot(t, value, color=_COLOURS.get(name), linewidth=0.7, label="error")
        title = name
        if has_truth:
            look = dict(color=SKY, alpha=0.45, linewidth=0, label="± 2 σ of the estimator")
            axes.fill_between(t, -2 * sigma, 2 * sigma, **look)
            score = scores.score(samples)
            rms = f"RMS {score['yaw_rms_rad']:.3f} rad after {scores.FROM_M:.0f} m"
            title += f": {rms}, {score['inside_95']:.0%} within 1.96 σ"
        axes.set(ylabel="yaw error [rad]" if has_truth else "yaw [rad]", title=title)
    if errors:
        extent = np.clip(1.1 * np.nanmax(np.abs(errors)), 0.1, np.pi)
        panels[0].set_ylim(-extent, extent)
        legend_above(panels[0])
    _time_axis(panels, samples)
    return figure


@styled
def replay_traction(replays, first):
    """Draw estimates of μ and κ over time.

    If the log has the truth, regressions of the true motion on the encoder measurements are added,
    over a sliding window (dots) and over the whole log (dashed). The band of two standard
    deviations is that of the estimator `first`.
    """
    figure, panels = plt.subplots(2, figsize=(DOUBLE_IN, 3.6), sharex=True)
    samples = replays[first]
    has_truth = {truth for _, truth in scores.REGRESSIONS} <= set(samples)
    for place, (axes, name) in enumerate(zip(panels, ("mu", "kappa"))):
        t, value, sigma = _broken(samples, "t_s", f"{name}_hat", f"sigma_{name}")
        band = np.clip([value - 2 * sigma, value + 2 * sigma], 0, 1)
        look = dict(color=SKY, alpha=0.45, linewidth=0, label=f"{first} ± 2 σ, in [0, 1]")
        axes.fill_between(t, *band, **look)
        for estimator, estimates in replays.items():
            look = dict(color=_COLOURS.get(estimator), linewidth=0.9 if estimator == first else 0.5)
            axes.plot(*_broken(estimates, "t_s", f"{name}_hat"), **look, label=estimator)
        drawn = [samples.loc[scores.distance_driven(samples) >= scores.FROM_M, f"{name}_hat"]]
        if has_truth:
            sliding = scores.sliding_regression(samples)[:, place]
            label = "regression over"
            look = dict(color=ORANGE, markersize=1.5, label=f"{label} {scores.WINDOW_S:.0f} s")
            axes.plot(samples["t_s"], sliding, ".", **look)
            look = dict(
                color=COLOURS["truth"], linestyle="--", linewidth=0.8, label="regression, whole log"
            )
            axes.axhline(scores.regression(samples)[place], **look)
            drawn.append(sliding)
        least = max(np.floor(10 * np.nanmin(np.concatenate(drawn))) / 10 - 0.1, 0)
        cut = f", cut at {least:.1f}" if least else ""
        axes.set(ylim=(least - 0.02, 1.05), ylabel=rf"$\{name}$ [-]{cut}")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    _time_axis(panels, samples)
    return figure
