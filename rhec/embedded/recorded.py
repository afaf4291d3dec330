"""The estimator that `rhec.log` judged, as C: its window, its noise, and its unknown first yaw.

On its way a robot does not know its first yaw. As `rhec.replay`, the C (`c/search.c`) runs the
estimator from several directions until one is left that explains the positions, and it moves late
measurements to the sample (`rhec.logs.replay.estimated`).
"""

from functools import partial

import casadi as ca
import numpy as np
import pandas as pd

from rhec.core._casadi.build import casadi_function
from rhec.core.estimator.rhe import Window
from rhec.core.model.limits import is_valid_measurement
from rhec.embedded.exported_functions import Recorded
from rhec.logs.recording import with_ages
from rhec.logs.replay import (
    N_HEADINGS,
    estimated,
    first_guess,
    first_memory_of,
    motion_of,
    moved_to_sample,
    replay_of,
    used_of,
)
from rhec.logs.summary import Judgement

MOST_SAMPLES = 3000  # of an example


def build_move(window: Window) -> ca.Function:
    """Function (estimate, measured, held, ages) -> (z_N, square).

    Late measurements (n_z,) become those of the sample, by the motion from the last estimate;
    `square` is that of the innovation of the position. `held` has the newest number of each
    measurement, by which the motion goes on where one is missing.
    """
    model, names = window.model, window.estimated
    motion = motion_of(model, names)
    n_z = len(model.outputs)
    shapes = dict(estimate=(len(names), 1), measured=(n_z, 1), held=(n_z, 1), ages=(n_z, 1))

    @casadi_function("rhec_move_measured", ca.MX, **shapes)
    def move(estimate, measured, held, ages):
        z = moved_to_sample(motion, estimate, measured, ages, model, window.dt_s)
        _, predicted = motion(estimate, held, window.dt_s - ages[0])
        innovation = measured[:2] - predicted[:2]
        there = [is_valid_measurement(measured[row], model.limits[row]) for row in (0, 1)]
        return dict(z_N=z, square=ca.if_else(there[0] * there[1], ca.sumsqr(innovation), 0))

    return move


def recorded_of(judged: Judgement) -> Recorded:
    """The Recorded of what was judged."""
    recording, scenario, first, inflation = judged
    how = replay_of(scenario)
    guess, sigma = first_guess(first, 0.0, (0.0, 0.0), 0.0, np.pi / N_HEADINGS)
    return Recorded(
        window=how.window,
        settings=how.settings,
        guess=guess,
        sigma_guess=sigma,
        inflation=inflation,
        headings=N_HEADINGS,
        move=build_move(how.window),
    )


def example_of(judged: Judgement) -> pd.DataFrame:
    """The first segment from its first position on, and Python's results: an example for the C.

    The columns are the measurements, their ages [s], the estimates and their standard deviations.
    """
    recording, scenario, first, inflation = judged
    how = replay_of(scenario)
    for part in recording.samples():
        stream = with_ages(used_of(part, scenario), how.measured)
        has_position = np.isfinite(stream[:, :2]).all(axis=1)
        if has_position.any():
            break
    stream = stream[np.argmax(has_position) :][:MOST_SAMPLES]
    start = partial(first_memory_of, how, scenario, first, np.nan_to_num(stream[0, 2]))
    results = estimated(how, stream, start, None, np.pi / N_HEADINGS)
    ages = [f"{name}_age_s" for name in how.measured]
    columns = [*how.measured, *ages]
    sigmas = inflation * results[how.sigmas]
    return pd.DataFrame(stream, columns=columns).join(results[how.hats]).join(sigmas)
