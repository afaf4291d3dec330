"""How well estimators do on a log without truth: hidden positions, NIS, and a smoothed reference.

Each estimator is a function from a Recording to its samples, as of `replay.estimate_samples`.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs import rivals
from rhec.logs.recording import moves
from rhec.logs.replay import estimate_samples, replay_scenario
from rhec.simulation.columns import ESTIMATE, INNOVATION, MEASUREMENTS, SIGMA
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.tuning import sigma_v_of

# Hidden are positions of HIDDEN_S in every _EVERY_S.
HIDDEN_S = 10.0
_EVERY_S = 30.0
AFTER_S = (2.0, HIDDEN_S)  # times since the last position at which errors count
_FROM_M = 8.0  # distance driven in a segment from which on the yaw has converged
_ANGLE = 1.96  # standard deviations that hold 95 % of the errors of a yaw
_BOTH = 2.236  # the same, of both coordinates of a position


def _settled(samples):
    """Whether the robot moves and has driven far enough for a yaw, at each sample (n,)."""
    step_m = paper.DT_S * samples[MEASUREMENTS[2]].abs().fillna(0.0)
    driven_m = step_m.groupby(samples["segment"]).cumsum()
    return moves(samples) & (driven_m > _FROM_M) & samples[ESTIMATE[2]].notna()


class Hidden(NamedTuple):
    """Errors of estimates while positions are hidden, {time since the last one [s]: (n,)}."""

    error_m: dict  # distance from the hidden position
    is_covered: dict  # whether it is within the 95 % of the estimate, NaN without a position


def hidden_errors(recording, estimate, sigma_v=(0.0, 0.0)):
    """The Hidden of an estimator: positions are hidden for HIDDEN_S in every _EVERY_S.

    The estimator runs for each part of _EVERY_S that may be hidden, so that all positions of a
    segment but its first ones are hidden once.

    Args:
        recording: The Recording.
        estimate: The estimator.
        sigma_v: Standard deviations of the positions (x, y) themselves [m].
    """
    rows = recording.rows
    first_s = rows.groupby("segment")["t_s"].first()
    since_s = rows["t_s"] - rows["segment"].map(first_s)
    shown = pd.concat(recording.samples(), ignore_index=True)[MEASUREMENTS[:2]].to_numpy()
    tables = []
    for begin_s in np.arange(0.0, _EVERY_S, HIDDEN_S):
        is_hidden = ((since_s - begin_s) % _EVERY_S < HIDDEN_S) & (since_s >= HIDDEN_S)
        masked = rows.copy()
        masked.loc[is_hidden, MEASUREMENTS[:2]] = np.nan
        samples = estimate(recording._replace(rows=masked))
        sample_s = samples["t_s"] - samples["segment"].map(first_s)
        # The last position was measured one sample before the first that is hidden.
        without_s = (sample_s - begin_s) % _EVERY_S + paper.DT_S
        off = samples[ESTIMATE[:2]].to_numpy() - shown
        limits = _BOTH * np.hypot(samples[SIGMA[:2]].to_numpy(), sigma_v[:2])
        errors = pd.DataFrame(dict(after_s=without_s, error=np.hypot(*off.T)))
        is_covered = (np.abs(off) < limits).all(axis=1)
        errors["covered"] = np.where(errors["error"].notna(), is_covered, np.nan)
        tables.append(errors[sample_s > HIDDEN_S])
    table = pd.concat(tables)
    at = {each: table[(table["after_s"] - each).abs() < paper.DT_S / 2] for each in AFTER_S}
    return Hidden(
        {each: rows["error"].to_numpy() for each, rows in at.items()},
        {each: rows["covered"].to_numpy() for each, rows in at.items()},
    )


def nis(samples, sigma_v):
    """Normalised innovations squared y' S⁻¹ y / 2 of the positions, (n,): 1 in the mean.

    After an update the covariance is P⁺ = V - V S⁻¹ V, from which S⁻¹ = (V - P⁺) / V². Without an
    update it is P, and S = P + V.

    Args:
        samples: DataFrame of samples.
        sigma_v: Standard deviations of (x, y) [m].
    """
    V = np.square(sigma_v[:2])
    P = np.square(samples[SIGMA[:2]].to_numpy())
    is_used = samples["position_accepted"].to_numpy()[:, None] == 1
    inverse = np.where(is_used, np.maximum(V - P, 0) / V**2, 1 / (V + P))
    return (np.square(samples[INNOVATION].to_numpy()) * inverse).sum(axis=1) / 2


def _estimators(recording, about):
    """{name: estimator}, with the RHE as it is replayed first, and the sigma_v of all.

    A RHE with a gyro or a heading is followed by one without, as the filters are. All have the same
    noise, and none is told the first yaw.
    """
    plain = replay_scenario("rhe", recording, dict(sensors=()))
    scenarios = {"RHE": plain}
    if recording.sensors:
        name = f"RHE, {' and '.join(recording.sensors)}"
        scenarios = {name: replay_scenario("rhe", recording, {})} | scenarios
    half_m = recording.track_width_m / 2
    settings = estimator_of("rhe").settings(plain)

    def rhe(scenario):
        return lambda shown: estimate_samples(shown, scenario, about)

    def filtered(rival):
        noise = rivals.same_noise(rival, settings, half_m)
        return lambda shown: pd.concat(
            [rivals.run(rival, noise, part, half_m) for part in shown.samples()], ignore_index=True
        )

    named = {name: rhe(scenario) for name, scenario in scenarios.items()}
    named |= {name: filtered(rival) for name, rival in rivals.RIVALS.items()}
    return named, sigma_v_of(plain)


class Comparison(NamedTuple):
    """Estimators on a log, as a robot would have run them on its way."""

    table: pd.DataFrame  # a row for each, a column for each number
    samples: pd.DataFrame  # of the first one, the RHE as it is replayed


def compare(recording, reference, about):
    """The Comparison of the RHE with two filters.

    Args:
        recording: The Recording.
        reference: Smoothed samples.
        about: The InitialGuess of the RHE.
    """
    named, sigma_v = _estimators(recording, about)
    rows = {}
    samples_of = {}
    for name, estimate in named.items():
        samples = samples_of[name] = estimate(recording)
        counts = _settled(samples) & reference[ESTIMATE[2]].notna()
        yaw = ESTIMATE[2]
        apart = (samples[yaw] - reference[yaw] + np.pi)[counts] % (2 * np.pi) - np.pi
        hidden = hidden_errors(recording, estimate, sigma_v)
        rows[name] = {
            f"hidden {after_s:g} s [m]": np.nanmedian(error_m)
            for after_s, error_m in hidden.error_m.items()
        } | {
            "in 95 %": np.nanmean(hidden.is_covered[HIDDEN_S]),
            "n": np.isfinite(hidden.is_covered[HIDDEN_S]).sum(),
            "NIS": np.nanmean(nis(samples, sigma_v)[counts]),
            "yaw in 95 %": (apart.abs() <= _ANGLE * samples[SIGMA[2]][counts]).mean(),
            "κ": samples.loc[counts, ESTIMATE[5]].median(),
            "μ": samples.loc[counts, ESTIMATE[4]].median(),
        }
    return Comparison(pd.DataFrame(rows).T, next(iter(samples_of.values())))
