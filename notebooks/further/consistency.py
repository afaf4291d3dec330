"""Is an estimator consistent? NEES and NIS (Bar-Shalom, Li, Kirubarajan, "Estimation with
Applications to Tracking and Navigation", 2001, ch. 5.4).

An estimator is consistent if its errors are as large as its covariance says. Then the normalised
estimation error squared ε = e'P⁻¹e of n_x states follows χ² with n_x degrees of freedom, the
normalised innovation squared y'S⁻¹y of n_z measurements χ² with n_z; their sums over m independent
runs, χ² with m times as many. Divided by the degrees of freedom, both are close to 1. Above its
bounds the estimator is overconfident, below too cautious.

All estimators see the same recorded measurements, of robots driven with the true state in the loop.
The covariance of the RHE leaves the bounds on (μ, κ) aside.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import gammaincinv

from notebooks.rivals import RIVALS
from notebooks.studies.statistics import CONFIDENCE, over_seeds, root_of_mean
from notebooks.studies.tables import interval_text
from rhec.simulation import offline
from rhec.simulation.columns import MEASUREMENTS, TRUTH
from rhec.simulation.offline import SETTLED_S
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.style import label_of
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import states_of
from rhec.tracked_robot.kinematics import QUANTITIES

STATES = ("x", "y", "θ", "ν", "μ", "κ")
_RULES = tuning.RULES_IN_DEFAULT_WORLD
ESTIMATORS = {  # fields of Scenario
    f"{label_of(estimator)}, {rule}": dict(estimator=estimator, process_noise=rule)
    for estimator in ("ekf", "rhe")
    for rule in _RULES
} | {"traction oracle, prediction": dict(estimator=RIVALS["traction_oracle"])}
# By this factor NEES by its degrees of freedom, and a state's error over σ, may be off 1.
_BAND = 1.25
_EVERY = 5  # `departure` sees every fifth sample: errors last for seconds


class Consistency(NamedTuple):
    """Errors and normalised squares of m runs with n samples each."""

    t_s: np.ndarray  # (n,)
    errors: np.ndarray  # (m, n, n_x) estimate less truth over its standard deviation
    nees: np.ndarray  # (m, n)
    nis_position: np.ndarray  # (m, n), of the measurements of x and y
    nis_speed: np.ndarray  # (m, n), of the measurement of ν

    @property
    def states(self):
        """Names of the estimated states."""
        return STATES[: self.errors.shape[2]]


def measure(scenario, runs):
    """The Consistency of a Scenario's estimator on the measurements of runs of one length.

    The estimator is "rhe" with speed_model "parameter", or any of the EKFs.
    """
    places = [0, 1, 3]  # of x, y and ν, which are measured, among the states
    R = np.diag(np.square(tuning.sigma_v_of(scenario)[:3]))
    results = []
    for run, recorded in _estimates(scenario, runs):
        estimate = recorded["estimate"]
        error, P = _errors(scenario, run, recorded)
        residuals = offline.columns(run, MEASUREMENTS[:3]) - estimate[:, places]
        y, S = innovations(residuals, P[:, places][:, :, places], R)
        nees = normalised_squared(error, P)
        # GNSS and encoders are tested apart, so that one cannot hide the other's error.
        nis_position = normalised_squared(y[:, :2], S[:, :2, :2])
        nis_speed = normalised_squared(y[:, 2:], S[:, 2:, 2:])
        scaled = error / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        results.append((scaled, nees, nis_position, nis_speed))
    return Consistency(run.columns["t_s"], *(np.array(values) for values in zip(*results)))


def _estimates(scenario, runs):
    """Pairs of a run and what the estimator recorded on it."""
    every = offline.run_estimator_on_all(scenario, runs, "estimate", "covariance")
    return zip(runs, every)


def _errors(scenario, run, recorded, some=slice(None)):
    """Errors (n, n_x) of the estimates and their covariances (n, n_x, n_x), at some samples.

    An EKF without traction states has n_x = 4; the estimate has six entries all the same. Other
    states than (x, y, θ, ν, μ, κ), such as the yaw drift, are not tested.
    """
    names = [*states_of(scenario)]
    tested = [place for place, name in enumerate(QUANTITIES) if name in names]
    rows = [names.index(QUANTITIES[place]) for place in tested]
    if not rows:
        expected = f"its covariance should cover states with names of {QUANTITIES}"
        raise ValueError(f"the estimator {label_of(scenario.estimator)} names {names}; {expected}")
    truth = offline.columns(run, [TRUTH[place] for place in tested])
    error = recorded["estimate"][some][:, tested] - truth[some]
    return error, recorded["covariance"][some][:, rows][:, :, rows]


def measure_all(seeds):
    """{name: Consistency} of all ESTIMATORS on the same runs, one a seed."""
    runs = simulate([Scenario(estimator="oracle", seed=seed) for seed in seeds])
    return {name: measure(Scenario(**fields), runs) for name, fields in ESTIMATORS.items()}


def departure(scenario, runs):
    """How far a Scenario's estimator departs from consistency on the measurements of runs.

        (ln r)² + Σ (ln r_i)² / n_x

    where r is NEES by its degrees of freedom n_x, and r_i the mean squared error of state i by its
    variance, over the settled samples. It is 0 if the covariance is as large as the errors.
    """
    nees = []
    squares = []
    for run, recorded in _estimates(scenario, runs):
        some = run.columns["t_s"] >= SETTLED_S
        some[np.arange(len(some)) % _EVERY != 0] = False
        error, P = _errors(scenario, run, recorded, some)
        nees.append(normalised_squared(error, P))
        squares.append(np.square(error) / np.diagonal(P, axis1=1, axis2=2))
    n_x = error.shape[1]
    of_states = np.concatenate(squares).mean(axis=0)
    return np.log(np.concatenate(nees).mean() / n_x) ** 2 + np.mean(np.log(of_states) ** 2)


def normalised_squared(e, P):
    """e'P⁻¹e of each error e (n, n_x) with its covariance P (n, n_x, n_x)."""
    return np.einsum("ni,ni->n", e, np.linalg.solve(P, e[..., None])[..., 0])


def innovations(residuals, HPH, R):
    """Innovations from what is left of them after the update.

    For an update with measurements of covariance R, z - H ξ̂ = R S⁻¹ y and R - H P H' = R S⁻¹ R.
    The residuals are z - H ξ̂ (n, n_z), HPH is H P H' after the update; the results are y (n, n_z)
    and S (n, n_z, n_z).
    """
    gain = R @ np.linalg.inv(R - HPH)
    return (gain @ residuals[..., None])[..., 0], gain @ R


def bounds(runs, degrees):
    """Bounds of a mean of χ² variables, divided by their degrees of freedom.

    With m runs and d degrees of freedom the mean is χ²(m d) / (m d); it lies between the 2.5 % and
    the 97.5 % quantile with a probability of 95 %.
    """
    ends = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
    quantiles = 2 * gammaincinv(runs * degrees / 2, ends)  # of χ²; scipy.stats takes long to load
    return quantiles / (runs * degrees)


def share_inside(normalised, degrees):
    """Share of samples at which the mean of `normalised` (m, n) over runs is within its bounds."""
    low, high = bounds(len(normalised), degrees)
    mean = normalised.mean(axis=0) / degrees
    return np.mean((low <= mean) & (mean <= high))


def normalised(measured):
    """The three tests of a Consistency once settled: (label, values (m, n), degrees of freedom)."""
    later = measured.t_s >= SETTLED_S
    return [
        ("NEES", measured.nees[:, later], len(measured.states)),
        ("NIS, position", measured.nis_position[:, later], 2),
        ("NIS, speed", measured.nis_speed[:, later], 1),
    ]


def mean_square_errors(measured):
    """Mean squares over time, settled, of errors over their standard deviations: (m, n_x)."""
    return np.square(measured.errors[:, measured.t_s >= SETTLED_S]).mean(axis=1)


def consistency_table(measured):
    """Mean NEES and NIS by their degrees of freedom (1 if consistent), and RMS errors over σ.

    `inside` is the share of samples at which the mean over the runs is within its 95 % bounds.
    """
    rows = []
    for name, consistency in measured.items():
        for label, values, degrees in normalised(consistency):
            interval = over_seeds(np.mean, values.mean(axis=1) / degrees, least=0.0)._asdict()
            interval["inside"] = share_inside(values, degrees)
            rows.append(dict(estimator=name, quantity=f"{label}, mean") | interval)
        for state, squares in zip(consistency.states, mean_square_errors(consistency).T):
            interval = over_seeds(root_of_mean, squares, least=0.0)._asdict()
            rows.append(dict(estimator=name, quantity=f"RMS error over sigma, {state}") | interval)
    return pd.DataFrame(rows)


def verdicts(table):
    """What the table of `consistency_table` says of each estimator.

    Returns:
        DataFrame with columns estimator, nees, low, high, n and verdict; NEES is that by its
        degrees of freedom. "consistent": its interval, and those of the errors over σ of all
        states, are within a factor of 1.25 of 1. "too sure", "too cautious": the whole interval of
        one of them is above or below that; of NEES first, then of the states. Else "undecided".
    """
    rows = []
    for name, of in table.groupby("estimator", sort=False):
        judged = of[of["quantity"].str.startswith(("NEES", "RMS error over sigma"))]
        outside = [*_outside(judged.iloc[:1]), *_outside(judged)]
        is_inside = (judged["low"] > 1 / _BAND) & (judged["high"] < _BAND)
        otherwise = "consistent" if is_inside.all() else "undecided"
        nees = judged.iloc[0]
        about = {"estimator": name, "nees": nees["mean"]} | dict(nees[["low", "high", "n"]])
        rows.append(about | dict(verdict=next(iter(outside), otherwise)))
    return pd.DataFrame(rows)


def _outside(rows):
    """The words for those rows whose whole interval is outside the band."""
    words = []
    for low, high in zip(rows["low"], rows["high"]):
        if low > _BAND:
            words.append("too sure")
        elif high < 1 / _BAND:
            words.append("too cautious")
    return words


def in_words(table, rule="consistent"):
    """One sentence on RHE and EKF by a rule, from the table of `consistency_table`."""
    found = verdicts(table).set_index("estimator")
    numbers = []
    words = []
    for name in ("RHE", "EKF"):
        row = found.loc[f"{name}, {rule}"]
        numbers.append(f"{interval_text(row['nees'], row['low'], row['high'])} for the {name}")
        words.append(f"the {name} is {row['verdict']}")
    return (
        f'By the rule "{rule}" NEES by its degrees of freedom is {" and ".join(numbers)}, on '
        f"{row['n']} fields that no rule has seen: {', '.join(words)}."
    )


def readable_verdicts(table):
    """The `verdicts` for readers: NEES by its degrees of freedom and its interval, and the word."""
    found = verdicts(table)
    texts = [interval_text(*row) for row in found[["nees", "low", "high"]].itertuples(index=False)]
    return pd.DataFrame(
        {
            "estimator, rule": found["estimator"],
            "NEES by its degrees of freedom": texts,
            "errors as large as it says": found["verdict"],
        }
    )
