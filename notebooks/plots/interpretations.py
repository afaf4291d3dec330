"""What the printed and the prediction W do to an estimate over time."""

import matplotlib.pyplot as plt

from notebooks.plots.parts import legend_above, time_axis
from rhec.style import DOUBLE_IN, styled


@styled
def errors_over_time(runs, estimate, truth, label, span_s=(0, 240)):
    """Draw the error of an estimate over time, a line a run.

    Args:
        runs: {standard deviation in W: Run} of one field, with the printed one and with that by
            prediction (`interpretations.swept`).
        estimate, truth: Columns of the log.
        label: Of the error.
        span_s: Times that are shown.
    """
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.2))
    for (sigma, run), rule in zip(runs.items(), ("as printed", "by prediction"), strict=True):
        error = run.log[estimate] - run.log[truth]
        axes.plot(run.log["t_s"], error, linewidth=0.7, label=rf"$\sigma$ = {sigma:g}, {rule}")
    time_axis([axes], run.log["t_s"], ~run.log["on_straight"], "curves")
    axes.set(xlim=span_s, ylabel=label, title=f"seed {run.scenario.seed}")
    legend_above(axes)
    return figure
