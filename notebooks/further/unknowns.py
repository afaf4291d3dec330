"""Which unknown is worth estimating: the traction, the yaw drift, or the yaw rate, by a gyro?

The paper estimates the traction (μ, κ). On soil that differs between the tracks the robot also
turns on a straight, by the yaw drift δ in θ' = κω + μνδ, which the paper's model lacks. So the
paper's RHE drives with each of them and without, and with a gyro, at the paper's R = 10 and with
the R that suits it. Its rivals stand beside it: Kalman filters, filters that are told the truth of
the soil, and an oracle, which has all of the true state.

All have V and W by the one rule that needs no truth, "prediction", of the default world
(`rhec/tracked_robot/tuned.csv`), and all choose R on the same training fields of each world.
"""

import dataclasses
import itertools

import numpy as np
import pandas as pd

from notebooks.further import traction_map
from notebooks.studies import answer, which_worlds
from notebooks.studies.statistics import over_seeds, ratio_of_means
from rhec import paper
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.scenario import Scenario
from rhec.simulation.worlds import WORLDS as NAMED_WORLDS

NOTHING = "RHE of nothing"
TRACTION = "RHE of the traction"
DRIFT = "RHE of the yaw drift"
BOTH = "RHE of both"
GYRO = "RHE of the traction, with a gyro"
ALL = "RHE of both, with a gyro"
TOLD_TRACTION = "EKF, told the traction"
TOLD_BOTH = "EKF, told both"
ORACLE = "oracle"
ROBOTS = {  # {robot: fields of Scenario}; the RHE is the paper's, with μ = κ = 1 where it has none
    "EKF of nothing": dict(estimator="ekf"),
    NOTHING: dict(estimator="rhe_no_slip"),
    "bounded EKF of the traction": dict(estimator="bounded_ekf"),
    TRACTION: dict(estimator="rhe"),
    DRIFT: dict(estimator="rhe_no_slip", yaw_drift=True),
    "bounded EKF of both": dict(estimator="yaw_drift_ekf"),
    BOTH: dict(estimator="rhe", yaw_drift=True),
    GYRO: dict(estimator="rhe", sensors=("gyro",)),
    ALL: dict(estimator="rhe", yaw_drift=True, sensors=("gyro",)),
    TOLD_TRACTION: dict(estimator="traction_oracle"),
    TOLD_BOTH: dict(estimator="drift_oracle"),
    ORACLE: dict(estimator="oracle"),
}
# What an unknown is worth: (what, the robot with it, the robot without it).
WORTH = [
    ("the traction", TRACTION, NOTHING),
    ("the traction, beside the yaw drift", BOTH, DRIFT),
    ("the yaw drift", DRIFT, NOTHING),
    ("the yaw drift, beside the traction", BOTH, TRACTION),
    ("a gyro, beside the traction", GYRO, TRACTION),
    ("a gyro, beside both", ALL, BOTH),
    ("to be told the traction", TOLD_TRACTION, TRACTION),
]
DIFFERENCES = (-0.01, -0.005, 0.0, 0.005, 0.01)  # d, by which the left track slips more
POSTERIOR = "posterior"
SOFT = "soft"
_MILDER = 2 * paper.OMEGA_MAX_RADPS
WORLDS = {f"d = {d:g}": dict(slip_difference=d) for d in DIFFERENCES} | {
    "mean κ 0.85": dict(kappa_mean=0.85, kappa_deviation=0.03),
    SOFT: NAMED_WORLDS["soft"],
    # On soft soil a turn may need more than the paper's bound.
    f"soft, ω up to {_MILDER:g} rad/s": NAMED_WORLDS["soft"] | dict(omega_max_radps=_MILDER),
}
DEFAULT = "d = 0.005"
AS_PRINTED = "R as printed"
TUNED = "R tuned"
ERROR = "mean true error [m]"
RATIO = "true error with it over without it"
_R = (1.0, 0.3, 0.1, 0.03)  # to choose from
_TRAINING = 1000  # the first seed of the training fields
_PAYS = 0.9  # the worth of an effort: 10 % of the error


def _fields(worlds, seeds):
    """{world: its fields, one Scenario a seed}."""
    return {name: [Scenario(seed=n, **WORLDS[name]) for n in seeds] for name in worlds}


def _drawn(worlds):
    """Scenarios of worlds of the posterior, rows of its table, each with a seed of its own."""
    names = Scenario.__dataclass_fields__.keys() & worlds.columns
    names -= {"duration_s"}  # drives are as long as those of the other worlds
    rows = worlds[sorted(names)].to_dict("records")
    return [Scenario(seed=seed, **row) for seed, row in zip(worlds.index, rows)]


def _errors(groups):
    """{name: mean true errors (n,)} of {name: Scenarios}, in one campaign in this process."""
    rows = campaign([*itertools.chain(*groups.values())], workers=1)
    errors = rows["mean_error_true_m"].fillna(np.inf).to_numpy()
    ends = np.cumsum([len(group) for group in groups.values()])[:-1]
    return dict(zip(groups, np.split(errors, ends)))


def _drives(scenarios, robot, r):
    """The Scenarios of a robot with a weight R."""
    return [dataclasses.replace(each, r=r, **ROBOTS[robot]) for each in scenarios]


def drive(seeds, training_fields, posterior_worlds):
    """Drive every robot in every world, with the paper's R and with the best of its training.

    Args:
        seeds: Of the fields, below 1000.
        training_fields: How many fields of each world, from seed 1000 on, R is chosen on. As many
            worlds of the posterior, its last ones, choose the R for all of its worlds.
        posterior_worlds: How many worlds of the posterior, its first ones, are driven.

    Returns:
        {(world, robot, AS_PRINTED or TUNED): mean true errors (n,)}.
    """
    drawn = which_worlds.posterior_table().reset_index(drop=True)
    training = _fields(WORLDS, range(_TRAINING, _TRAINING + training_fields))
    training[POSTERIOR] = _drawn(drawn.tail(training_fields))
    tried = {
        (world, robot, r): _drives(scenarios, robot, r)
        for (world, scenarios), robot, r in itertools.product(training.items(), ROBOTS, _R)
    }
    means = {name: errors.mean() for name, errors in _errors(tried).items()}
    fields = _fields(WORLDS, seeds)
    fields[POSTERIOR] = _drawn(drawn.head(posterior_worlds))
    chosen = {}
    for (world, scenarios), robot in itertools.product(fields.items(), ROBOTS):
        best = min(_R, key=lambda r: means[world, robot, r])
        chosen[world, robot, AS_PRINTED] = _drives(scenarios, robot, paper.R)
        chosen[world, robot, TUNED] = _drives(scenarios, robot, best)
    return _errors(chosen)


def worth_table(errors):
    """The mean errors of every robot, and what each unknown of WORTH is worth, in every world.

    Args:
        errors: Of `drive`.

    Returns:
        DataFrame with columns world, weights (AS_PRINTED or TUNED), robot (or unknown), quantity,
        mean, low, high, n, and of errors lost, the share of drives above 0.12 m.
    """
    rows = []
    for world, weights in dict.fromkeys((world, weights) for world, _, weights in errors):
        about = dict(world=world, weights=weights)
        for robot in ROBOTS:
            of_robot = errors[world, robot, weights]
            row = about | dict(robot=robot, quantity=ERROR)
            row |= over_seeds(np.mean, of_robot)._asdict()
            rows.append(row | dict(lost=np.mean(of_robot > paper.TOLERANCE_M)))
        for what, *pair in WORTH:
            row = about | dict(robot=what, quantity=RATIO)
            both = (errors[world, robot, weights] for robot in pair)
            rows.append(row | over_seeds(ratio_of_means, *both)._asdict())
    return pd.DataFrame(rows)


def _ratios(table, what, weights, worlds):
    """The rows of what an unknown is worth in some worlds."""
    rows = table[(table["robot"] == what) & (table["weights"] == weights)]
    return rows.set_index("world").loc[worlds]


def _taken_off(rows):
    """By how much the errors are less, in words: a range over the worlds."""
    least, most = (100 * (1 - rows["mean"].agg(["max", "min"]))).round().astype(int)
    if most <= 0:
        return "nothing"
    return f"{max(least, 0)} to {most} %" if max(least, 0) < most else f"{most} %"


def _counted(rows):
    """In how many worlds an unknown pays, with its whole interval."""
    return f"{(rows['high'] < _PAYS).sum()} of {len(rows)}"


def in_words(table=None, worth_map=None):
    """When to estimate what, as sentences and a table in Markdown.

    Args:
        table: Of `worth_table`; None: that of this commit.
        worth_map: Of `traction_map.worth_map`; None: that of this commit.
    """
    if table is None:
        table = pd.read_csv(answer.RESULTS / "table_unknowns.csv")
    if worth_map is None:
        worth_map = pd.read_csv(answer.RESULTS / "table_traction_map.csv", dtype=dict(told=str))
    worlds = [*WORLDS]
    worlds.remove(SOFT)  # where no robot can drive, the oracle neither
    unknowns = {
        "the yaw drift": "the yaw drift, beside the traction",
        "the traction": "the traction, beside the yaw drift",
        "a gyro": "a gyro, beside both",
    }
    worth = {name: _ratios(table, what, AS_PRINTED, worlds) for name, what in unknowns.items()}
    with_r = {name: _ratios(table, what, TUNED, worlds) for name, what in unknowns.items()}
    order = sorted(worth, key=lambda name: np.log(worth[name]["mean"]).mean())
    first, *others = order
    r_is_worth = _worth_of_r(table, worlds)
    sentences = [
        f"**Tune R, and estimate {first}.**",
        f"R, the controller's weight of the yaw rate, takes {r_is_worth} off the error of an RHE "
        f"that estimates both, against the paper's {paper.R:g}.",
        f"With the paper's R, {first} takes off {_taken_off(worth[first])}, more than 10 % with "
        f"its whole 95 % interval in {_counted(worth[first])} worlds; with R tuned "
        f"{_taken_off(with_r[first])} ({_counted(with_r[first])}).",
    ]
    for name in others:
        sentences.append(
            f"{name[0].upper()}{name[1:]} takes off {_taken_off(worth[name])} beside it "
            f"({_counted(worth[name])} worlds), with R tuned {_taken_off(with_r[name])} "
            f"({_counted(with_r[name])})."
        )
    words = " ".join(sentences)
    to_show = answer.to_markdown(_by_world(table))
    return f"{words}\n\n{to_show}\n\n{traction_map.rule_in_words(worth_map)}"


def _worth_of_r(table, worlds):
    """What tuning R takes off the error of the RHE of both, in words."""
    rows = table[(table["robot"] == BOTH) & (table["quantity"] == ERROR)]
    by_weights = rows.pivot(index="world", columns="weights", values="mean").loc[worlds]
    ratio = by_weights[TUNED] / by_weights[AS_PRINTED]
    return _taken_off(pd.DataFrame(dict(mean=ratio)))


def _by_world(table):
    """The mean true errors in millimetres by robot and world, as texts."""
    errors = table[table["quantity"] == ERROR]
    columns = {
        "d = −0.01": ("d = -0.01", AS_PRINTED),
        "0": ("d = 0", AS_PRINTED),
        "0.005, the default": (DEFAULT, AS_PRINTED),
        "the default, R tuned": (DEFAULT, TUNED),
        "mean κ 0.85": ("mean κ 0.85", AS_PRINTED),
        "posterior": (POSTERIOR, AS_PRINTED),
    }
    by_place = errors.set_index(["world", "weights", "robot"])["mean"]
    texts = {
        title: [f"{1e3 * by_place[(*place, robot)]:.1f}" for robot in ROBOTS]
        for title, place in columns.items()
    }
    return pd.DataFrame({"mean true error [mm]": [*ROBOTS]} | texts)
