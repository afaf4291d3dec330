"""RHE or EKF: which is the better in the worlds in which the paper's numbers are possible.

The worlds are those of `notebooks.studies.which_worlds`. In each, RHE and EKF drive with W by the
same rule. By prediction it is fitted in each world (`fitted_noises`): this rule needs no truth, so
that whoever works in that world can follow it there. The other rules need the truth. They have the
W that was tuned in the default world, as if one had moved on with it; so has PREDICTION_OF_DEFAULT.

Where the likelihood is flat, the search ends elsewhere by rounding. Of five worlds that were fitted
again with a later version (3, 67, 150, 300, 420), eight of ten rows were the same, and the two
others, of the RHE, were as likely: -2 log likelihood 0.8 and 3.4 higher, of -14 328 and -21 906.

`python -m notebooks.studies.order_in_worlds` makes all files of this module in data/.
"""

import numpy as np
import pandas as pd

from notebooks.studies import which_worlds
from notebooks.studies.parallel import parallel_map
from notebooks.studies.tables import interval_texts
from notebooks.studies.which_worlds import DATA, UNUSED_SEED, Variant
from rhec import paper
from rhec.simulation.offline import deviances
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import tuning

NOISES = DATA / "posterior_noises.csv"
ORDER_DRIVES = DATA / "order_drives.parquet"

ESTIMATORS = ("rhe", "ekf")
PREDICTION_OF_DEFAULT = "prediction, as in the default world"
# {rule: W}, a name of `which_worlds.noise_of`.
RULES = {
    "printed": "printed",
    "consistent": "consistent",
    "prediction": "fitted",
    "tracking": "tracking",
    PREDICTION_OF_DEFAULT: "prediction",
}


# W and V by prediction, in each world

_TRAINING_SEED = UNUSED_SEED + 2**20  # of the first world's first training drive
_TRAINING_DRIVES = 2
_TRAINING_ROWS = 1.5  # one row, a headland and half a row
_CANDIDATES = 32  # of a generation
_ELITE = 8  # of those, about which the next generation is drawn
_GENERATIONS = 8
_FIRST_DEVIATION = 1.0  # of a logarithm
_LEAST = 1e-3  # less than 1 mm, 1 mrad or 1 mm/s has no effect
_MOST = 10.0
# The places in (sigma_w, sigma_v) that each unknown sets. That of the speed in W stays _LEAST, and
# the EKF has no σ_ω, since its yaw rate is an input.
_PLACES = {
    "rhe": [(0, 1), (2,), (4,), (5,), (6, 7), (8,), (9,)],
    "ekf": [(0, 1), (2,), (4, 5), (6,)],
}
_FIRST = {"rhe": (0.003, 0.01, 0.002, 0.002, 0.015, 0.025, 0.03)}
_FIRST["ekf"] = (0.003, 0.01, 0.015, 0.025)


def fitted_noises(worlds):
    """W and V of RHE and EKF by one-step prediction in each world, on training drives there.

    The true state is in the loop, so that the measurements do not depend on any estimator.

    Args:
        worlds: [of `which_worlds.fields_of`, …].

    Returns:
        DataFrame, one row a world and estimator: sigma_w and sigma_v, numbers that spaces separate.
    """
    found = parallel_map(_fitted_in, list(enumerate(worlds)))
    rows = [row for of_world in found for row in of_world]
    return pd.DataFrame(rows, columns=["world", "estimator", "sigma_w", "sigma_v"])


def _fitted_in(numbered):
    """The rows of `fitted_noises` of one world (number, fields)."""
    number, world = numbered
    fields = {name: of for name, of in world.items() if name not in which_worlds.NOT_OF_SCENARIO}
    fields |= dict(duration_s=which_worlds.duration_s(_TRAINING_ROWS, fields))
    seeds = range(_TRAINING_SEED + _TRAINING_DRIVES * number, _TRAINING_SEED + 2 * (number + 1))
    runs = simulate([Scenario(**fields, estimator="oracle", seed=seed) for seed in seeds])
    rows = []
    for estimator in ESTIMATORS:
        noise = fit_prediction(estimator, runs, seed=number)
        texts = (" ".join(f"{value:.3g}" for value in sigma) for sigma in noise)
        rows.append((number, estimator, *texts))
    return rows


def fit_prediction(estimator, runs, seed=0):
    """W and V that predict the next measurements of Runs best, each given all before it.

    The cross-entropy method: each generation of candidates is drawn from a normal distribution of
    the logarithms, which becomes that of the best ones. All candidates run at a time, in lanes.

    Args:
        estimator: "rhe" or "ekf".
        runs: The Runs.
        seed: Of the candidates.

    Returns:
        A `tuning.Noise`.
    """
    rng = np.random.default_rng(seed)
    scenario = Scenario(estimator=estimator)
    mean = np.log(_FIRST[estimator])
    root = _FIRST_DEVIATION * np.eye(len(mean))
    best = np.inf, None
    for _ in range(_GENERATIONS):
        candidates = mean + rng.standard_normal((_CANDIDATES, len(mean))) @ root.T
        candidates = np.clip(candidates, np.log(_LEAST), np.log(_MOST))
        noises = [_noise_at(estimator, candidate) for candidate in candidates]
        scores = deviances(scenario, noises, runs).sum(axis=1)
        ranked = np.argsort(scores)
        best = min(best, (scores[ranked[0]], noises[ranked[0]]), key=lambda scored: scored[0])
        elite = candidates[ranked[:_ELITE]]
        mean = elite.mean(axis=0)
        root = np.diag(elite.std(axis=0) + 0.02)
    return best[1]


def _noise_at(estimator, logarithms):
    """The Noise at a point of the search."""
    sigma_w = [_LEAST] * len(tuning.NOISES[estimator]["printed"].sigma_w)
    sigma = np.array([*sigma_w, *paper.SIGMA_V])
    for places, logarithm in zip(_PLACES[estimator], logarithms):
        sigma[list(places)] = np.exp(logarithm)
    sigma = sigma.tolist()
    return tuning.Noise(tuple(sigma[: len(sigma_w)]), tuple(sigma[len(sigma_w) :]))


# Drives in the posterior's worlds

OWN = "own"  # the path and length that a world itself has
PATTERNS = ("alternate", "left", "right", "figure_of_eight")
_PATTERN_ROWS = 2.999  # three rows and the two headlands between them
# {name: Variant}
VARIANTS = {f"{e}_{rule}": Variant(e, w) for rule, w in RULES.items() for e in ESTIMATORS}
_KEPT = ("error", "violations")


def with_noises(worlds, noises):
    """Worlds with the noise that `fitted_noises` found in each, for the W "fitted"."""
    worlds = [dict(world) for world in worlds]
    for row in noises.itertuples():
        worlds[row.world][f"fitted_{row.estimator}"] = dict(
            sigma_w=tuple(map(float, row.sigma_w.split())),
            sigma_v=tuple(map(float, row.sigma_v.split())),
        )
    return worlds


def on_pattern(world, turns):
    """A world whose robot drives three rows with turns of one of PATTERNS, or as it did itself."""
    if turns == OWN:
        return world
    world = world | dict(turns=turns)
    return world | dict(duration_s=which_worlds.duration_s(_PATTERN_ROWS, world))


def drive_by_rule(worlds):
    """Drive worlds by each rule, on their own paths and on each of PATTERNS.

    RHE and EKF have the same fields and the same noise, which are those of all rules, too. A
    world has two fields on its own path, and one on each of PATTERNS.

    Args:
        worlds: Of `with_noises`.

    Returns:
        DataFrame, one row a world and field, with columns (turns and variant, error or violations);
        turns are OWN or of PATTERNS. NaN where a field was not driven.
    """
    tables = {}
    for turns in (OWN, *PATTERNS):
        driven = [on_pattern(world, turns) for world in worlds]
        fields = which_worlds.FIELDS if turns == OWN else 1
        table = which_worlds.drive(driven, UNUSED_SEED, VARIANTS, fields, paired=True)
        for variant in VARIANTS:
            tables[f"{turns} {variant}"] = table[variant][list(_KEPT)]
    return pd.concat(tables, axis=1).astype(np.float16)


def rule_rows(drives, effective):
    """RHE and EKF with W by the same rule in the posterior's worlds, by rule and path.

    A world counts by the mean of its drives; lost is a mean error above the tolerance.

    Args:
        drives: Of `drive_by_rule`.
        effective: How many of the worlds are effectively different.

    Returns:
        DataFrame, one row a rule and path: medians over worlds of both errors [m] and of EKF / RHE
        with its middle 90 %; the share of worlds in which the RHE's error is the smaller, with its
        95 % interval; how many worlds have neither robot lost, and that share among those; in which
        shares of the worlds the RHE, and the EKF, has fewer violations.
    """
    rows = []
    for rule in RULES:
        for turns in (OWN, *PATTERNS):
            rhe, ekf = (drives[f"{turns} {e}_{rule}"].groupby("world").mean() for e in ESTIMATORS)
            better = (rhe["error"] < ekf["error"]).to_numpy()
            ratio = (ekf["error"] / rhe["error"]).to_numpy()
            kept = (np.maximum(rhe["error"], ekf["error"]) <= paper.TOLERANCE_M).to_numpy()
            share, low, high = which_worlds.effective_share(better.mean(), effective)
            rows.append(
                {
                    "rule for W": rule,
                    "turns": turns,
                    "RHE [m]": rhe["error"].median(),
                    "EKF [m]": ekf["error"].median(),
                    "EKF / RHE": np.median(ratio),
                    "EKF / RHE p5": np.quantile(ratio, 0.05),
                    "EKF / RHE p95": np.quantile(ratio, 0.95),
                    "RHE better": share,
                    "low": low,
                    "high": high,
                    "neither lost": kept.mean(),
                    "RHE better, neither lost": better[kept].mean() if kept.any() else np.nan,
                    "RHE fewer violations": (rhe["violations"] < ekf["violations"]).mean(),
                    "EKF fewer violations": (rhe["violations"] > ekf["violations"]).mean(),
                    "worlds": len(better),
                    "effective worlds": effective,
                }
            )
    return pd.DataFrame(rows).round(5)


def readable_rules(table):
    """In which share of worlds the RHE is the better, and EKF / RHE in the median, as texts.

    A row is a rule, a column a path; the share has its 95 % interval, the ratio its middle 90 %.
    """
    shares = interval_texts(table, "RHE better")
    ratios = interval_texts(table, "EKF / RHE", "EKF / RHE p5", "EKF / RHE p95")
    cells = table.assign(cell=shares + "; " + ratios)
    return cells.pivot_table("cell", "rule for W", "turns", aggfunc="first", sort=False)


def order_drives():
    """The drives that ORDER_DRIVES holds, as of `drive_by_rule`."""
    return which_worlds.read(ORDER_DRIVES)


def effective_worlds():
    """How many of the posterior's worlds are effectively different."""
    return which_worlds.effective_number(which_worlds.posterior_table()["world"])


# Making the files


def main():
    """Fit the noise in each of the posterior's worlds, and drive them by each rule."""
    worlds = which_worlds.posterior_worlds()
    fitted_noises(worlds).to_csv(NOISES, index=False)
    which_worlds.write(drive_by_rule(with_noises(worlds, pd.read_csv(NOISES))), ORDER_DRIVES)


if __name__ == "__main__":
    main()
