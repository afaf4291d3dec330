"""The figure of a replayed log with its truth."""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.further.recorded import scores
from notebooks.plots.parts import legend_above, time_axis
from rhec.style import COLOURS, DOUBLE_IN, PURPLE, SKY, styled

_COLOURS = {name: COLOURS[name] for name in ("RHE", "EKF")}
_COLOURS |= {"RHE, ν over the window": PURPLE}
# Turning more slowly counts as straight; the median over _SMOOTH samples removes encoder noise.
_STRAIGHT_RADPS = 0.05
_SMOOTH = 11


@styled
def replay_yaw(replays):
    """Draw the yaw's error over time with two standard deviations, a panel an estimator.

    Straight driving and standing are shaded.

    Args:
        replays: {estimator: samples of a perturbed replay} (`scores.perturbed_replay`).
    """
    size = (DOUBLE_IN, 0.4 + 1.2 * len(replays))
    grid = dict(sharex=True, sharey=True, squeeze=False)
    figure, panels = plt.subplots(len(replays), figsize=size, **grid)
    panels = panels[:, 0]
    largest = 0.0
    for axes, (name, samples) in zip(panels, replays.items()):
        error = scores.yaw_error(samples)
        largest = np.nanmax([largest, *error.abs()])
        # No line leads from segment to segment, or from π to -π.
        leaps = (samples["segment"].diff() > 0) | (error.diff().abs() > np.pi)
        t = samples["t_s"]
        axes.plot(t, error.mask(leaps), color=_COLOURS.get(name), linewidth=0.7, label="error")
        sigma = samples["sigma_theta_rad"]
        look = dict(color=SKY, alpha=0.45, linewidth=0, label="± 2 σ of the estimator")
        axes.fill_between(t, -2 * sigma, 2 * sigma, **look)
        score = scores.score(samples)
        rms = f"RMS {score['yaw_rms_rad']:.3f} rad after {scores.FROM_M:.0f} m"
        title = f"{name}: {rms}, {score['inside_95']:.0%} within 1.96 σ"
        axes.set(ylabel="yaw error [rad]", title=title)
    extent = np.clip(1.1 * largest, 0.1, np.pi)
    panels[0].set_ylim(-extent, extent)
    legend_above(panels[0])
    turning = samples["omega_meas_radps"].abs().rolling(_SMOOTH, center=True, min_periods=1)
    shaded = f"straight or standing, below {_STRAIGHT_RADPS} rad/s"
    time_axis(panels, t, turning.median() < _STRAIGHT_RADPS, shaded)
    return figure
