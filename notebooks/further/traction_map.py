"""When does estimating the traction pay? A map over the soil's mean κ and its variation.

The rival of an estimator of (μ, κ) is a robot that was told two constants. They may be right, too
low or too high, or 1, as of a robot without a slip model. Both are Kalman filters in the same loop
(`bounded_ekf`, `fixed_traction`), and both choose their settings on the same training fields of
each soil: the controller's weight R, and the process noise of the yaw and of the traction. A robot
that estimates with the paper's R stands beside them.

μ slips half as much as κ, varies half as much, and a constant μ is wrong by half as much.
"""

import dataclasses
import itertools

import numpy as np
import pandas as pd

from notebooks.rivals import RIVALS
from notebooks.studies.parallel import true_errors
from notebooks.studies.statistics import over_seeds, ratio_of_means
from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.path import path_of
from rhec.tracked_robot.terrain import Terrain, random_for

VARIATIONS = (0.1, 0.33)  # deviation of κ by its mean slip, 1 - κ
ERRORS = (-0.2, 0.0, 0.2)  # of the constant κ that a robot is told
_RIGHT = 0.0
_OVER_RIGHT = "over_right", "over_right_low", "over_right_high"
NO_SLIP = "no slip model"  # it is told that μ = κ = 1
ESTIMATED = "estimated"
WITH_PAPERS_R = "estimated, R as printed"
_TRAINING = 1000  # the first seed of the training fields
_DURATION_S = 120.0
_ROW_M = 8.0  # so short that a drive has a turn to either side
_R = (0.01, 0.04, 0.2)  # to choose from
# Standard deviations in W that each loop chooses from: of the yaw [rad], of μ and κ [1].
_YAW = (0.01, 0.03, 0.1)
_SOIL = (0.003, 0.015, 0.06)
_XY_M = 0.01
_SPEED_MPS = 0.2
_ROUNDING = 1e-9
_PAYS = 0.9  # the worth of an effort: 10 % of the error


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Told(Terrain):
    """Soil of whose mean traction a robot with fixed traction is told this (μ, κ) instead."""

    told: tuple[float, float]

    @property
    def mean(self) -> np.ndarray:
        return np.array(self.told)


def soil(kappa, variation):
    """The fields of Scenario of a soil: mean of κ, and its deviation by its mean slip."""
    deviation = variation * (1 - kappa)
    return dict(
        kappa_mean=kappa,
        kappa_deviation=deviation,
        mu_mean=(1 + kappa) / 2,
        mu_deviation=deviation / 2,
    )


def told_soil(terrain, error):
    """A terrain of which the robot is told a κ with this error, or that there is no slip."""
    told = np.ones(2)
    if error != NO_SLIP:
        # The mean of one field may be a little above that of the soil.
        told = np.minimum(terrain.mean + np.array([error / 2, error]), 1)
    return Told(terrain.mu, terrain.kappa, terrain.origin_m, terrain.cell_m, tuple(told.tolist()))


def loops(kappa):
    """The loops that drive on a soil of this mean κ: no robot is told a κ above 1."""
    errors = [error for error in ERRORS if kappa + error < 1 + _ROUNDING]
    return [ESTIMATED, WITH_PAPERS_R, *errors, NO_SLIP]


def _estimates(loop):
    """Whether a loop estimates the traction."""
    return loop in (ESTIMATED, WITH_PAPERS_R)


def _settings(loop):
    """The fields of Scenario that a loop chooses from."""
    weights = (paper.R,) if loop == WITH_PAPERS_R else _R
    soils = _SOIL if _estimates(loop) else (None,)
    return [
        dict(r=r, sigma_w=(_XY_M, _XY_M, yaw, _SPEED_MPS) + (() if noise is None else (noise,) * 2))
        for r, yaw, noise in itertools.product(weights, _YAW, soils)
    ]


def _fields(kappas, seeds):
    """{(κ, variation): its fields, one Scenario a seed with its terrain}."""
    fields = {}
    for place in itertools.product(kappas, VARIATIONS):
        scenarios = [
            Scenario(duration_s=_DURATION_S, row_length_m=_ROW_M, seed=n, **soil(*place))
            for n in seeds
        ]
        path = path_of(scenarios[0])
        fields[place] = [dataclasses.replace(s, terrain=random_for(s, path)) for s in scenarios]
    return fields


def _drives(fields, loop, settings):
    """The Scenarios of a loop with its settings on fields: it estimates, or is told a constant."""
    if _estimates(loop):
        return [dataclasses.replace(each, estimator="bounded_ekf", **settings) for each in fields]
    return [
        dataclasses.replace(
            each,
            estimator=RIVALS["fixed_traction"],
            terrain=told_soil(each.terrain, loop),
            **settings,
        )
        for each in fields
    ]


def drive(kappas, seeds, training_fields):
    """Drive every loop on every soil with the settings that were best on its training fields.

    Args:
        kappas: Means of κ, one a soil and variation.
        seeds: Of the fields, below 1000.
        training_fields: How many, from seed 1000 on.

    Returns:
        {(κ, variation, loop): mean true errors (n,)}; a loop is ESTIMATED, WITH_PAPERS_R, NO_SLIP,
        or the error of the κ that it is told.
    """
    training = _fields(kappas, range(_TRAINING, _TRAINING + training_fields))
    every = [(*place, loop) for place in training for loop in loops(place[0])]
    tried = {
        (*name, number): _drives(training[name[:2]], name[-1], settings)
        for name in every
        for number, settings in enumerate(_settings(name[-1]))
    }
    means = {name: errors.mean() for name, errors in true_errors(tried).items()}
    fields = _fields(kappas, seeds)
    chosen = {}
    for name in every:
        *place, loop = name
        settings = _settings(loop)
        best = min(range(len(settings)), key=lambda number: means[(*name, number)])
        chosen[name] = _drives(fields[tuple(place)], loop, settings[best])
    return true_errors(chosen)


def worth_map(errors):
    """The errors with estimated traction over those of each rival, at equal seeds.

    Args:
        errors: Of `drive`.

    Returns:
        DataFrame with columns kappa, variation, told (the error of the constant, or NO_SLIP), mean,
        low, high, n (of the ratio), the means with estimated traction: error_m, and
        error_papers_r_m with the paper's R; and over_right, over_right_low, over_right_high, the
        rival's error over that of a robot that is told the right constants.
    """
    rows = []
    for (kappa, variation, loop), of_rival in errors.items():
        if _estimates(loop):
            continue
        estimated = errors[kappa, variation, ESTIMATED]
        about = dict(kappa=kappa, variation=variation, told=str(loop))
        about |= over_seeds(ratio_of_means, estimated, of_rival)._asdict()
        papers_r = errors[kappa, variation, WITH_PAPERS_R]
        about |= dict(error_m=estimated.mean(), error_papers_r_m=papers_r.mean())
        over_right = over_seeds(ratio_of_means, of_rival, errors[kappa, variation, _RIGHT])[:3]
        rows.append(about | dict(zip(_OVER_RIGHT, over_right)))
    return pd.DataFrame(rows)


def counts(table):
    """On how many soils estimating pays, for each constant that is told.

    It pays where the whole 95 % interval of the ratio is below 0.9. Soils on which the robot is
    lost with estimated traction, too, are left out.

    Args:
        table: Of `worth_map`.

    Returns:
        DataFrame with columns told, pays, soils, and ratio, the geometric mean of the ratios
        over the soils.
    """
    of_rivals = dict([*_driven(table).groupby("told")])
    rows = [
        dict(
            told=told,
            pays=(of_rivals[told]["high"] < _PAYS).sum(),
            soils=len(of_rivals[told]),
            ratio=np.exp(np.log(of_rivals[told]["mean"]).mean()),
        )
        for told in (*map(str, ERRORS), NO_SLIP)
        if told in of_rivals
    ]
    return pd.DataFrame(rows)


def _wrong_constants_in_words(driven):
    """What constants κ cost that are too low and too high, in a sentence after others."""
    times = {}
    texts = []
    for error in (min(ERRORS), max(ERRORS)):
        rows = driven[driven["told"] == str(error)]
        if rows.empty:
            return ""  # a κ above 1 is told to no robot
        times[error] = np.exp(np.log(rows["over_right"]).mean())
        has = f"has {times[error]:.2f} times the error of the right one"
        texts.append(f"{_in_words(str(error))} {has} ({len(rows)} soils)")
    words = f"a constant {texts[0]}, and one {texts[1].removeprefix('κ ')}"
    if times[min(ERRORS)] < times[max(ERRORS)]:
        return f" Whoever has to guess should guess low: {words}."
    return f" {words[0].upper()}{words[1:]}."


def _driven(table):
    """The rows of the soils that a robot can drive which estimates the traction."""
    return table[table["error_m"] < paper.TOLERANCE_M]


def against_constants(table):
    """When estimating the traction pays against constants that a robot is told, in sentences.

    Args:
        table: Of `worth_map`.
    """
    counted = counts(table).set_index("told")
    driven = _driven(table)
    paid = counted[counted["pays"] > 0]
    rule = "**Two constants do as well as an estimate of the traction, even if they are wrong.**"
    if len(paid):
        highest = driven.loc[driven["high"] < _PAYS, "kappa"].max()
        rivals = ", ".join(
            f"{_in_words(told)} ({row['pays']:.0f} of {row['soils']:.0f} soils)"
            for told, row in paid.iterrows()
        )
        rule = (
            f"**Against two constants that a robot is told, estimating the traction takes off more "
            f"than 10 %, with its whole 95 % interval, only where the mean κ is {highest:g} or "
            f"less, and only if they are wrong**: {rivals}. Against the right constants the error "
            f"is {counted.loc[str(_RIGHT), 'ratio']:.2f} times theirs."
        )
    return f"{rule}{_wrong_constants_in_words(driven)}"


def _in_words(told):
    """A rival by what it is told of κ."""
    if told == NO_SLIP:
        return NO_SLIP
    error = float(told)
    if not error:
        return "the right κ"
    return f"κ too {'high' if error > 0 else 'low'} by {abs(error):g}"
