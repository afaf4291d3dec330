"""What is done to a recorded log, and what must follow for all that is said of it.

A log read in a mirror, elsewhere, turned by a right angle, later, with its columns in another order
or its rows twice is a log of the same robot. (Rows in another order are refused: their times fall.)
"""

import functools

import numpy as np
import pytest
from helpers import BY_M, in_a_mirror, later, moved, recorded_log, turned
from invariances import Change, difference
from spoilt_logs import four_headings

import rhec
from rhec.simulation.columns import ESTIMATE, SIGMA


def log_with_a_gyro():
    log = recorded_log(duration_s=40.0, noise_m=0.02)
    noise = 0.01 * np.random.default_rng(5).standard_normal(len(log))
    return log.assign(gyro_radps=log["yaw_rate_true_radps"] + 0.004 + noise)


LOG = log_with_a_gyro()


@pytest.fixture(scope="module", autouse=True)
def quickly():
    with four_headings():
        yield


def told(log):
    """All that is said of a log, {name: series}, and its sentences.

    On the way the first yaw is a guess, which does not turn with the world.
    """
    summary = rhec.log(log)
    parts = [
        {name: np.array(number, dtype=float) for name, number in summary.numbers.items()},
        {f"smoothed {name}": v for name, v in series(summary.estimates).items()},
        {f"on the way {name}": v for name, v in series(summary.way[1:]).items()},
    ]
    for table in (summary.traction, summary.parameters):
        rows = table[["value", "low", "high"]].astype(float)
        parts.append({name: row.to_numpy() for name, row in rows.iterrows()})
    return {name: v for part in parts for name, v in part.items()}, summary.verdict, summary.doubts


def series(estimates):
    """Estimates and their standard deviations; the yaw as a direction, which has no turns."""
    theta = estimates["theta_hat_rad"]
    columns = [name for name in (*ESTIMATE, *SIGMA[:6]) if estimates[name].notna().all()]
    found = {name: estimates[name].to_numpy() for name in columns if name != theta.name}
    return found | dict(along_x=np.cos(theta).to_numpy(), along_y=np.sin(theta).to_numpy())


@functools.cache
def first():
    return told(LOG)


def back_from_the_mirror(found):
    """What is on the left was on the right, and the ends of its interval change places."""
    series = {name: -v if name.endswith(("y_hat_m", "along_y")) else v for name, v in found.items()}
    signed = [name for name in found if name.startswith(("drift", "antenna left", "gyro bias"))]
    return series | {name: -found[name][[0, 2, 1]] for name in signed}


def moved_back(found):
    by_m = {"x_hat_m": BY_M[0], "y_hat_m": BY_M[1]}
    return {name: v - by_m.get(name.split()[-1], 0.0) for name, v in found.items()}


def turned_back(found):
    before = dict(found)
    for place in ("smoothed", "on the way"):
        for along_x, along_y in (("x_hat_m", "y_hat_m"), ("along_x", "along_y")):
            before[f"{place} {along_x}"] = found[f"{place} {along_y}"]
            before[f"{place} {along_y}"] = -found[f"{place} {along_x}"]
        before[f"{place} sigma_x_m"] = found[f"{place} sigma_y_m"]
        before[f"{place} sigma_y_m"] = found[f"{place} sigma_x_m"]
    return before


def rows_once(found):
    """Of the rows half are of use, and a sample on the way comes from two."""
    smoothed = {name: v[::2] for name, v in found.items() if name.startswith("smoothed")}
    return found | smoothed | dict(rows_usable=2 * found["rows_usable"])


CHANGES = {
    "in a mirror": Change(in_a_mirror, back_from_the_mirror),
    "turned": Change(turned, turned_back),
    "rows twice": Change(lambda log: log.loc[log.index.repeat(2)], rows_once),
    "moved": Change(moved, moved_back),
    "later": Change(later, dict),
    "columns in another order": Change(lambda log: log[log.columns[::-1]], dict),
}


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("name", CHANGES)
def test_what_is_said_of_a_log_follows(name):
    change = CHANGES[name]
    found, *sentences = told(change.apply(LOG))
    expected, *expected_sentences = first()
    assert sentences == expected_sentences
    assert difference(expected, change.undo(found)) < 1e-6
