"""What several tests of logs do to a log, and to how it is replayed."""

import contextlib

import numpy as np
import pandas as pd
import pytest

from rhec.logs import replay


def in_rows_of_their_own(log, offset_s=0.0):
    """A log whose positions stand in other rows than its encoders, by a clock that is ahead."""
    positions = log[["t_s", "x_m", "y_m"]].assign(t_s=log["t_s"] + offset_s)
    both = pd.concat([log[["t_s", "speed_mps", "yaw_rate_radps"]], positions])
    return both.sort_values("t_s", kind="stable", ignore_index=True)


def late(log, rows):
    """A log with positions that are late by a number of rows."""
    return log.assign(**log[["x_m", "y_m"]].shift(rows))


def another_future(log, from_s, generator):
    """The same log until from_s [s]; then other measurements, some missing, at other times.

    Their noise is the same, because it is asked of the whole log.
    """
    later = log[log["t_s"] > from_s].copy()
    for name in ("x_m", "y_m", "speed_mps", "yaw_rate_radps"):
        later[name] = later[name] + generator.normal(0, 5.0)
        later.loc[generator.random(len(later)) < 0.2, name] = np.nan
    later["t_s"] += generator.uniform(0, 0.03, len(later))
    return pd.concat([log[log["t_s"] <= from_s], later[generator.random(len(later)) < 0.9]])


@contextlib.contextmanager
def four_headings():
    """A yaw that is not known is tried in four directions: eight take twice as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(replay, "N_HEADINGS", 4)
        yield
