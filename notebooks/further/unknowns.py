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
from notebooks.rivals import RIVALS
from notebooks.studies import which_worlds
from notebooks.studies.parallel import true_errors
from notebooks.studies.statistics import over_seeds, ratio_of_means
from notebooks.studies.tables import interval_texts, to_markdown
from rhec import paper
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
    NOTHING: dict(estimator=RIVALS["rhe_no_slip"]),
    "bounded EKF of the traction": dict(estimator="bounded_ekf"),
    TRACTION: dict(estimator="rhe"),
    DRIFT: dict(estimator=RIVALS["rhe_no_slip_yaw_drift"]),
    "bounded EKF of both": dict(estimator=RIVALS["yaw_drift_ekf"]),
    BOTH: dict(estimator="rhe", yaw_drift=True),
    GYRO: dict(estimator="rhe", sensors=("gyro",)),
    ALL: dict(estimator="rhe", yaw_drift=True, sensors=("gyro",)),
    TOLD_TRACTION: dict(estimator=RIVALS["traction_oracle"]),
    TOLD_BOTH: dict(estimator=RIVALS["drift_oracle"]),
    ORACLE: dict(estimator="oracle"),
}
_TOLD = "to be told the traction"
# What an unknown is worth: (what, the robot with it, the robot without it).
WORTH = [
    ("the traction", TRACTION, NOTHING),
    ("the traction, beside the yaw drift", BOTH, DRIFT),
    ("the yaw drift", DRIFT, NOTHING),
    ("the yaw drift, beside the traction", BOTH, TRACTION),
    ("a gyro, beside the traction", GYRO, TRACTION),
    ("a gyro, beside both", ALL, BOTH),
    (_TOLD, TOLD_TRACTION, TRACTION),
]
# What each is worth beside all else.
BESIDE = {
    "the yaw drift": "the yaw drift, beside the traction",
    "the traction": "the traction, beside the yaw drift",
    "a gyro": "a gyro, beside both",
}
DIFFERENCES = (-0.01, -0.005, 0.0, 0.005, 0.01)  # d, by which the left track slips more
POSTERIOR = "posterior"
SOFT = "soft"
KAPPA = "mean κ 0.85"
_MILDER = 2 * paper.OMEGA_MAX_RADPS
WORLDS = {f"d = {d:g}": dict(slip_difference=d) for d in DIFFERENCES} | {
    KAPPA: dict(kappa_mean=0.85, kappa_deviation=0.03),
    SOFT: NAMED_WORLDS["soft"],
    # On soft soil a turn may need a higher yaw rate than the paper's bound.
    f"soft, ω up to {_MILDER:g} rad/s": NAMED_WORLDS["soft"] | dict(omega_max_radps=_MILDER),
}
DEFAULT = "d = 0.005"
AS_PRINTED = "R as printed"
TUNED = "R tuned"
ERROR = "mean true error [m]"
RATIO = "true error with it over without it"
_R = (1.0, 0.3, 0.1, 0.03)  # to choose from
_TRAINING = 1000  # the first seed of the training fields
_FEW = 2  # worlds that are named
_PAYS = 0.9  # the worth of an effort: 10 % of the error
_HARDLY = 0.05  # share of drives of the oracle that may be lost in a world that counts


# The rules of W, and who drives by each of them where the tracks slip alike and where they do not.
RULES = ("printed", "consistent", "prediction", "tracking")
_BY_RULE = ("EKF of nothing", TRACTION, BOTH)
_ALIKE_OR_NOT = ("d = -0.01", "d = 0", DEFAULT)


def _fields(worlds, seeds):
    """{world: its fields, one Scenario a seed}."""
    return {name: [Scenario(seed=n, **WORLDS[name]) for n in seeds] for name in worlds}


def _drawn(worlds):
    """Scenarios of worlds of the posterior, rows of its table, each with a seed of its own."""
    names = Scenario.__dataclass_fields__.keys() & worlds.columns
    names -= {"duration_s"}  # drives are as long as those of the other worlds
    rows = worlds[sorted(names)].to_dict("records")
    return [Scenario(seed=seed, **row) for seed, row in zip(worlds.index, rows)]


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
    means = {name: errors.mean() for name, errors in true_errors(tried).items()}
    fields = _fields(WORLDS, seeds)
    fields[POSTERIOR] = _drawn(drawn.head(posterior_worlds))
    chosen = {}
    for (world, scenarios), robot in itertools.product(fields.items(), ROBOTS):
        best = min(_R, key=lambda r: means[world, robot, r])
        chosen[world, robot, AS_PRINTED] = _drives(scenarios, robot, paper.R)
        chosen[world, robot, TUNED] = _drives(scenarios, robot, best)
    return true_errors(chosen)


def drive_by_rule(seeds):
    """Mean true errors by every rule of W with the paper's R, {(world, robot, rule): (n,)}."""
    drives = {}
    for world, fields in _fields(_ALIKE_OR_NOT, seeds).items():
        for robot, rule in itertools.product(_BY_RULE, RULES):
            scenarios = _drives(fields, robot, paper.R)
            drives[world, robot, rule] = [
                dataclasses.replace(each, process_noise=rule) for each in scenarios
            ]
    return true_errors(drives)


def rule_table(errors):
    """The mean errors of `drive_by_rule`, and those of the RHE of both over the RHE's.

    Returns:
        DataFrame with columns world, rule, robot, quantity, mean, low, high, n.
    """
    rows = []
    for world, rule in dict.fromkeys((world, rule) for world, _, rule in errors):
        about = dict(world=world, rule=rule)
        for robot in _BY_RULE:
            of_robot = over_seeds(np.mean, errors[world, robot, rule], least=0.0)
            rows.append(about | dict(robot=robot, quantity=ERROR) | of_robot._asdict())
        pair = (errors[world, robot, rule] for robot in (BOTH, TRACTION))
        row = about | dict(robot=BESIDE["the yaw drift"], quantity=RATIO)
        rows.append(row | over_seeds(ratio_of_means, *pair)._asdict())
    return pd.DataFrame(rows)


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
            row |= over_seeds(np.mean, of_robot, least=0.0)._asdict()
            rows.append(row | dict(lost=np.mean(of_robot > paper.TOLERANCE_M)))
        for what, *pair in WORTH:
            row = about | dict(robot=what, quantity=RATIO)
            both = (errors[world, robot, weights] for robot in pair)
            rows.append(row | over_seeds(ratio_of_means, *both)._asdict())
    return pd.DataFrame(rows)


def readable_errors(table):
    """The mean true errors of `worth_table` in millimetres with their intervals, as texts.

    A row is a robot with the paper's R or a tuned one, a column a world.
    """
    rows = table[table["quantity"] == ERROR]
    texts = interval_texts(1e3 * rows[["mean", "low", "high"]])
    return rows.assign(text=texts).pivot_table(
        "text", ["weights", "robot"], "world", aggfunc="first", sort=False
    )


def _ratios(table, what, weights, worlds):
    """The rows of what an unknown is worth in some worlds."""
    rows = table[(table["robot"] == what) & (table["weights"] == weights)]
    return rows.set_index("world").loc[worlds]


def drivable(table):
    """The worlds in which the oracle, which has the true state, is lost in hardly any drive."""
    oracle = table[(table["robot"] == ORACLE) & (table["weights"] == AS_PRINTED)]
    return [*oracle.loc[oracle["lost"] <= _HARDLY, "world"]]


def _taken_off(ratios):
    """By how much the errors are less, in words: a range over the worlds."""
    least, most = (round(100 * (1 - ratio)) for ratio in (ratios.max(), ratios.min()))
    if most <= 0:
        return "nothing"
    return f"{max(least, 0)} to {most} %" if least < most else f"{most} %"


def in_words(table, by_rule, worth_map):
    """When to estimate what, as sentences and a table in Markdown.

    Args:
        table: Of `worth_table`.
        by_rule: Of `rule_table`.
        worth_map: Of `traction_map.worth_map`.
    """
    rule = traction_map.against_constants(worth_map)
    words = f"{_rule(table)}\n{_by_every_rule(by_rule)}"
    return f"{words}\n\n{to_markdown(_by_world(table))}\n\n{rule}"


def in_short(table, worth_map):
    """When to estimate what, in three sentences.

    Args:
        table: Of `worth_table`.
        worth_map: Of `traction_map.worth_map`.
    """
    worlds = drivable(table)
    worth = {name: _ratios(table, what, TUNED, worlds)["mean"] for name, what in BESIDE.items()}
    first = min(worth, key=lambda name: np.log(worth[name]).mean())
    _, rule, *_ = traction_map.against_constants(worth_map).split("**")  # the part in bold
    return (
        f"Tune the controller's weight R first: it takes {_taken_off(_worth_of_r(table, worlds))} "
        f"off the mean true error, in {len(worlds)} worlds. Then estimate {first}, by which uneven "
        f"slip of the tracks turns the robot: with R tuned, that takes off another "
        f"{_taken_off(worth[first])}. "
        f"{rule.removesuffix('.')}."
    )


def _by_every_rule(by_rule):
    """What the yaw drift takes off by every rule of W in the default world, in a sentence."""
    rows = by_rule[(by_rule["quantity"] == RATIO) & (by_rule["world"] == DEFAULT)]
    words = [
        f"{rule} {_taken_off(rows.loc[rows['rule'] == rule, 'mean'])}" for rule in rows["rule"]
    ]
    return (
        f"- By each rule of W, in the default world, the yaw drift takes off: {', '.join(words)}."
    )


def _rule(table):
    """Which unknown is worth estimating: a sentence, and a list with what each takes off."""
    worlds = drivable(table)
    worth = {
        name: [_ratios(table, what, weights, worlds) for weights in (AS_PRINTED, TUNED)]
        for name, what in BESIDE.items()
    }
    order = sorted(worth, key=lambda name: np.log(worth[name][0]["mean"]).mean())
    told = _ratios(table, _TOLD, AS_PRINTED, worlds)["mean"]
    head = (
        f"**Tune R, and estimate {order[0]}**, by which soil that differs between the tracks turns "
        f"the robot. What each takes off the mean true error beside the others, in {len(worlds)} "
        f"worlds; it *pays* where it takes off more than 10 % with its whole 95 % interval:"
    )
    lines = [
        f"- **R**, instead of the paper's {paper.R:g}: {_taken_off(_worth_of_r(table, worlds))} of "
        "the error of an RHE that estimates traction and yaw drift."
    ]
    for name in order:
        printed, tuned = worth[name]
        lines.append(
            f"- **{name[0].upper()}{name[1:]}**: {_taken_off(printed['mean'])} with the paper's R, "
            f"where it pays {_where(printed)}; {_taken_off(tuned['mean'])} with R tuned, where it "
            f"pays {_where(tuned)}."
        )
    lines.append(
        f"- A filter that is *told* the true traction has {told.min():.2f} to {told.max():.2f} "
        "times the error of the RHE that estimates it."
    )
    return "\n".join([head, "", *lines, *_of_other_worlds(table, worlds)])


def _where(ratios):
    """In which worlds an unknown pays, in words."""
    paid = [*ratios.index[ratios["high"] < _PAYS]]
    if not paid:
        return "nowhere"
    names = f" ({'; '.join(paid)})" if len(paid) <= _FEW else ""
    return f"in {len(paid)}{names}"


def _worth_of_r(table, worlds):
    """The error of the RHE of both with R tuned over that with the paper's R, by world."""
    rows = table[(table["robot"] == BOTH) & (table["quantity"] == ERROR)]
    by_weights = rows.pivot(index="world", columns="weights", values="mean").loc[worlds]
    return by_weights[TUNED] / by_weights[AS_PRINTED]


def _of_other_worlds(table, worlds):
    """A sentence about the worlds in which an oracle is lost, too; none if there is none."""
    oracle = table[(table["robot"] == ORACLE) & (table["weights"] == AS_PRINTED)]
    lost = oracle.set_index("world")["lost"].drop(worlds)
    if lost.empty:
        return []
    names = " and ".join(lost.index)
    return [
        f"- Not counted is the world {names!r}, where the oracle is lost in "
        f"{100 * lost.max():.0f} % of the drives, too: turns there need more than the paper's "
        f"{paper.OMEGA_MAX_RADPS:g} rad/s."
    ]


def _by_world(table):
    """The mean true errors in millimetres by robot and world, as texts."""
    errors = table[table["quantity"] == ERROR].set_index(["world", "weights", "robot"])["mean"]
    columns = {
        "d = −0.01": (f"d = {DIFFERENCES[0]:g}", AS_PRINTED),
        "d = 0": ("d = 0", AS_PRINTED),
        "d = 0.005 (default)": (DEFAULT, AS_PRINTED),
        "mean κ 0.85": (KAPPA, AS_PRINTED),
        "posterior": (POSTERIOR, AS_PRINTED),
        "default, R tuned": (DEFAULT, TUNED),
    }
    texts = {
        title: [f"{1e3 * errors[(*place, robot)]:.1f}" for robot in ROBOTS]
        for title, place in columns.items()
    }
    return pd.DataFrame({"mean true error [mm]": [*ROBOTS]} | texts)
