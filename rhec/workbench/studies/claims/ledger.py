"""The claims ledger: every checkable sentence of the paper, the rule that judges it, and what the
runs say.

Where the paper's words leave the bound open, it is chosen here and stands in `test`: what is
"never" or "always" so must be so in every case, what "reaches" or "settles" in at least 95 % of
the fields, what is told of the experiments in more than half; "much better" is at least twofold.
"Stays" has one meaning: the true error never reaches 0.12 m after arrival. What is to stay within a
bound is judged beside a robot that knows its true pose and soil (the oracle): of the fields where
that one does, at least 95 %. What "may" happen is searched for. A field is one seed: its soil and
its noise together.

A claim is tested only if its rule can come out either way: `outcomes` looks for both verdicts under
the conditions of the ledger and, where these are of one mind, in other worlds
(`rhec.workbench.studies.claims.run_sets.WORLDS`). What comes out one way everywhere follows from equations,
or nothing was found that it depends on; it is reported, and not counted.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from rhec import paper
from rhec.tracked_robot.kinematics import SPEED_MODELS
from rhec.workbench.studies import timing
from rhec.workbench.studies.claims import experiments, run_sets
from rhec.workbench.studies.statistics import (
    AS_PRINTED,
    FAILS,
    HOLDS,
    UNDECIDED,
    UNTESTABLE,
    Finding,
    always,
    beside,
    combined,
    coverage,
    difference,
    difference_of_means,
    equal,
    mean,
    possible,
    ratio,
    ratio_of_means,
    reported,
    share,
)

__all__ = [
    "CLAIMS",
    "ONE_WAY",
    "Claim",
    "collect_evidence",
    "counts",
    "coverages",
    "ledger",
    "outcomes",
    "survivors",
]

_RELIABLE = 0.95
_USUAL = 0.5
_CALIBRATED = "W calibrated"
_SIGNS = dict(above=">", below="<")
_PAIRS = ("rhe", "ekf"), ("rhe", "no_slip"), ("fixed_traction", "rhe"), ("q3", "q2")


class _Rule(NamedTuple):
    """How a claim is judged: {condition: evidence -> Finding}, the paper's text first, then
    departures from it; the unit of its number, the paper's number or word for it, the bound beyond
    which it comes out otherwise, and the tables {kind: ids} that it needs. Evidence is {process
    noise: {"runs", "logs", "experiments"}}.
    """

    by_condition: dict[str, Callable]
    unit: str = ""
    paper: object = ""
    bound: str = ""
    tables: dict[str, list] | None = None


class Claim(NamedTuple):
    """The test of a sentence of the paper in words, its rule, and what is known of the reason; the
    sentence and its section.
    """

    test: str
    rule: _Rule
    why: str = ""
    claim: str = ""
    section: str = ""


def _independent(rule, unit="", paper=""):
    """A rule on what no process noise touches."""
    return _Rule({"": lambda evidence: rule(evidence["printed"])}, unit, paper)


def _untestable(shown=lambda of: (np.nan, np.nan, np.nan, 0), unit="", paper=""):
    """No run here can decide; shows a number (value, low, high, n) where there is one."""
    return _independent(lambda of: Finding(*shown(of), UNTESTABLE), unit, paper)


# Departures from the text: what is put in the place of what, with W as printed and calibrated.
_FILTERED = ("filtered arrival mean", {"rhe": "rhe_filtered"})  # R7
_FROM_START = ("errors from the start", {"mean_error_m": "mean_error_from_start_m"})  # R14
_TRUE_FROM_START = (_FROM_START[0], {"mean_error_true_m": "mean_error_from_start_m"})
_TRACKING = (  # a W of its own
    "W by tracking",
    {"rhe": "rhe_tracking", "bounded_ekf": "bounded_ekf_tracking"},
    {"printed": ""},
)
_CAUTIOUS = ("a speed of its own and dual estimation", {"rhe": "cautious"}, {"printed": ""})
_SPEEDS = ("0.3 m/s", {"q2": "q2_slow"}), ("0.7 m/s", {"q2": "q2_fast"})  # R3


def _on_runs(
    labels,
    rule,
    *expressions,
    kind="runs",
    cases="fields",
    unit=None,
    paper=None,
    departures=(),
    **bounds,
):
    """A rule on expressions of the metrics of a label's runs, or of two labels' at equal seeds,
    with W as printed and calibrated, and so with each departure (the RHE's: its arrival mean).

    Unless told, the unit is that in the name of the metric, or says what the share or ratio is of.
    """
    labels = labels.split()
    if rule is reported:
        bounds["paper"] = paper
    if "rhe" in labels and kind != "experiments":
        departures = (_FILTERED, *departures)

    def judged(evidence, noise, instead):
        tables = [evidence[noise][kind][instead.get(label, label)] for label in labels]
        n = min(map(len, tables))
        asked = [instead.get(each, each) for each in expressions]
        values = [table[:n].eval(each, engine="python") for table in tables for each in asked]
        return rule(*values, **bounds)

    if unit is None:
        suffix = expressions[0].rstrip(")").rsplit("_", 1)[-1]
        unit = suffix if suffix in ("m", "s", "rad") else "-"
        rules = always, beside, possible, share, _share_twice
        unit = ({ratio: "ratio"} | dict.fromkeys(rules, f"share of {cases}")).get(rule, unit)
    if paper is None:
        paper = {always: "all", possible: "may"}.get(rule, "")
    names = {"printed": AS_PRINTED, "calibrated": _CALIBRATED}
    conditions = {name: partial(judged, noise=noise, instead={}) for noise, name in names.items()}
    both = {"printed": "", "calibrated": f"{_CALIBRATED}, "}
    for departure, instead, *noises in departures:
        for noise, before in (noises[0] if noises else both).items():
            conditions[before + departure] = partial(judged, noise=noise, instead=instead)
    words = {always: "every case", possible: "one case", reported: "usual"}
    sides = [f"{sign} {bounds[side]:g}" for side, sign in _SIGNS.items() if side in bounds]
    return _Rule(conditions, unit, paper, words.get(rule, " and ".join(sides)), {kind: labels})


_on_logs = partial(_on_runs, kind="logs")
_on_experiment = partial(_on_runs, kind="experiments", cases="runs")


def _on_property(name, rule, *expressions, cases="states", **options):
    """A rule on expressions of an experiment's table that no process noise touches."""
    found = _on_experiment(name, rule, *expressions, cases=cases, **options)
    return found._replace(by_condition={"": found.by_condition[AS_PRINTED]}, tables=None)


def _share_twice(one, other, **bounds):
    """The share of pairs where one is more than twice the other."""
    return share(one > 2 * other, **bounds)


_STAYS = f"arrived & (max_error_true_m < {paper.TOLERANCE_M})"
_LOST = "~arrived | (max_error_true_m > 1)"  # never reaches the path, or is a metre off it later
_BESIDE_M = (
    paper.ROW_SPACING_M - paper.STEM_WIDTH_M - paper.GNSS_ACCURACY_M - paper.ROBOT_WIDTH_M
) / 2
_PHASES_MS = sum(paper.TABLE_1_MS[column][1] for column in timing.PHASES)
_SUMMED_MS = [  # of each problem, minimum and maximum: the sum of the two phases, and overall
    (
        sum(paper.TABLE_1_MS[problem, phase][at] for phase in ("preparation", "feedback")),
        paper.TABLE_1_MS[problem, "overall"][at],
    )
    for problem in ("RHE", "RHC")
    for at in (0, 2)
]
_W_MEASURED, _W_UNMEASURED = (np.take(paper.SIGMA_W_RHE, at) for at in ([0, 1, 3], [2, 4, 5]))


def _entries_of_p(speed_model):
    """How many parameters the model has under this reading of eq. (6)."""
    return len(SPEED_MODELS[speed_model].model.parameters)


_WHY_SOIL = (
    "It is the soil that decides: here μ is 0.9 ± 0.04 and κ 0.8 ± 0.08 on average, the paper's is "
    "unknown."
)
_WHY_WHERE = (
    "Speed, path, soil and bumps are not in the paper; the agreement, or its lack, says little "
    "about the field."
)
_SECTIONS = (  # of the paper, each from the claim on that it names
    "I1 Introduction, S1 System, H1 RHE, H3 Arrival cost, N1 RHC, M1 Implementation, M7 EKF, "
    "M10 Solution, A1 Scenario A, B0 Scenario B, T1 Times, K1 KKT, C1 Conclusion"
)
_COLUMNS = (
    "id section claim test bound paper value low high n unit verdict kind condition above below p "
    "p_adjusted conditions other_condition other_value other_low other_high other_n other_verdict "
    "other_above other_below reached why"
).split()
_DISCOVERIES = 0.05  # false discovery rate over the whole ledger
ONE_WAY = "only one outcome found, so not tested"

_SENTENCES = {
    "I1 Rows of 0.78 m leave 0.12 m on either side of the robot": Claim(
        "(row - stem - GNSS - width) / 2, to the nearest cm, is the tolerance",
        _independent(lambda _: equal(_BESIDE_M, paper.TOLERANCE_M, 0.005), "m", paper.TOLERANCE_M),
        '0.12 m is 4.7 in; the paper\'s "(4.5 in)" is 0.114 m.',
    ),
    "I2 A tolerance of strictly less than 0.12 m is ensured": Claim(
        "share of the fields where the oracle stays within 0.12 m, headlands too, in which the "
        "RHEC does; at least 95 %",
        _on_runs(
            "rhe oracle", beside, _STAYS, departures=[_CAUTIOUS], above=_RELIABLE, paper="ensured"
        ),
        "At a constant speed no robot can in all: the oracle's own turns exceed 0.12 m in some "
        "fields. The cautious one slows down there.",
    ),
    "I6 … with a sampling time in the range of milliseconds": Claim(
        "the sampling time of 1/(5 Hz); below 0.1 s",
        _independent(lambda _: always([paper.DT_S < 0.1]), "share of cases", "all"),
        "It is 0.2 s; milliseconds is what a step takes to compute.",
    ),
    "I3 Learning the traction keeps tracking robust where uncertainty is high": Claim(
        "true mean error on soil half as sure (κ 0.6 ± 0.16, μ 0.8 ± 0.08, at 0.4 m/s), RHE over "
        "the same RHE with μ = κ = 1 held, paired; at most half",
        _on_runs("rhe_uncertain no_slip_uncertain", ratio, "mean_error_true_m", below=0.5),
    ),
    "I4 Linear MPC and PID track poorly off the path and on unknown soil": Claim(
        "-",
        _untestable(),
        "Neither is specified in the paper, and none is implemented here; a strawman would prove "
        "nothing.",
    ),
    "I5 A tube-based MPC stays on track without high accuracy": Claim(
        "-", _untestable(), "Another paper's controller."
    ),
    "S1 Two batteries drive the robot for over 3 hours": Claim(
        "-", _untestable(), "The simulated robot has no batteries."
    ),
    "S2 With μ = κ = 1 the model is the traditional one, without slip": Claim(
        "one step of the model at random states against the unicycle's circle; equal to 0.1 mm or "
        "mrad in all",
        _on_property("models", always, "off_unicycle_m < 1e-4"),
    ),
    "S5 1 - κ is the side slip": Claim(
        "speed across the heading of eq. (2) at random states with κ < 1; above 1 nm/s in all",
        _on_property("models", always, "sideways_mps > 1e-9"),
        "Eq. (2) has no speed across the heading: κ scales the yaw rate.",
    ),
    "S6 μ and κ must be between zero and one": Claim(
        "-",
        _untestable(),
        "The simulated soil is made so. A robot that is pushed, or turned by a slope, has more "
        "than one.",
    ),
    "S3 f(0, 0, p) = 0 for all p": Claim(
        "|f(0, 0, p)| at random p; below 1 nm/s in all",
        _on_property("models", always, "at_rest_mps < 1e-9"),
        "At ξ = 0, u = 0 the model gives ẋ = μν: the speed is a parameter, so that a robot "
        "without input still drives.",
    ),
    "S4 Traction must be estimated, or the estimates are biased": Claim(
        "|mean yaw error| in the curves, EKF (μ = κ = 1) over RHE, paired; at least twice",
        _on_logs("ekf rhe", ratio, "abs(yaw_bias_rad)", above=2),
    ),
    "H1 Parameters taken as random constants become biased where they drift": Claim(
        "RMS error of μ, RHE with W = 0 for μ and κ over RHE, paired; above 1",
        _on_logs("rhe_constant_parameters rhe", ratio, "rms_mu", above=1),
    ),
    "H2 Large values in W make the estimates vary more": Claim(
        "RMS change of κ̂ from sample to sample, RHE over RHE with a tenth of W's μ and κ, "
        "paired; above 1",
        _on_logs("rhe rhe_small_w", ratio, "step_kappa", above=1),
    ),
    "H3 H_N is bounded by the inverse of W": Claim(
        "least eigenvalue of P - W in units of W, P the inverse of H_N, over all samples of a "
        "run; at least -1e-9 in all runs",
        _on_experiment("arrival_cost", always, "least >= -1e-9"),
    ),
    "H4 A constant, large arrival weight makes the estimates chatter": Claim(
        "RMS change of κ̂ from sample to sample, constant weight 100 times the mean one over "
        "adaptive, paired; above 1",
        _on_experiment("arrival_cost", ratio, "step_heavy", "step_adaptive", above=1),
        "A large weight holds the estimates to the previous ones: by the paper's own cost "
        "function it makes them slow, not lively.",
    ),
    "H5 A constant, small arrival weight keeps them from the true values for long": Claim(
        "time until κ̂ is within 0.1 of κ for 5 s, constant weight of 1/100 of the mean one over "
        "adaptive, paired; above 1",
        _on_experiment("arrival_cost", ratio, "reached_s_light", "reached_s_adaptive", above=1),
        "A small weight leaves κ̂ to the noise of the window: it comes near the truth and does "
        "not stay.",
    ),
    "H6 The arrival cost is necessary for the stability of the RHE": Claim(
        "share of runs whose yaw estimate is more than 0.5 rad off at any time when the arrival "
        "cost has no weight; at least half",
        _on_experiment("arrival_cost", share, "lost_none", above=_USUAL),
        "Bounds on μ and κ and 3 s of positions keep the pose without it.",
    ),
    "N1 By certainty equivalence, control on estimates is precisely that on the truth": Claim(
        "true mean error, RHE over oracle, paired; within 0.95 to 1.05",
        _on_runs("rhe oracle", ratio, "mean_error_true_m", above=0.95, below=1.05, paper=1.0),
        "Certainty equivalence is a theorem of linear systems with quadratic cost.",
    ),
    "M1 Low process noise estimates more accurately": Claim(
        "RMS error of κ, RHE with a tenth of W's μ and κ over RHE, paired; below 1",
        _on_logs("rhe_small_w rhe", ratio, "rms_kappa", below=1),
    ),
    "M2 Low process noise makes the estimates lag behind the true values": Claim(
        "lag of μ̂ behind μ, RHE with a tenth of W's μ and κ - RHE, paired; above 0",
        _on_logs("rhe_small_w rhe", difference, "lag_mu_s", above=0),
    ),
    "M3 W is large for what is measured and small for what is not": Claim(
        "the least of W's numbers for x, y, ν exceeds the largest for θ, μ, κ, whatever their "
        "units",
        _independent(
            lambda _: always([min(_W_MEASURED) > max(_W_UNMEASURED)]), "share of cases", "all"
        ),
    ),
    "M4 The path's yaw rate as input reference may leave a steady error": Claim(
        "|mean offset| from the path in the curves, EKF (μ = κ = 1), input reference path's over "
        "measured yaw rate, paired; above 1",
        _on_logs("ekf_path_yaw_rate ekf", ratio, "abs(offset_curves_m)", above=1),
    ),
    "M5 R larger than Q keeps the closed loop well damped": Claim(
        "overshoot on the first row, R = 0.1 over R = 10, paired; above 1",
        _on_runs("q3_small_r q3", ratio, "overshoot_m", above=1),
    ),
    "M6 The weight on the horizon's end (Q_N = 10 Q) is critical for stability": Claim(
        "share of fields lost on the first row (never arrived, or 1 m off later) with Q_N = 0; at "
        "least half",
        _on_runs("q3_no_terminal_weight", share, _LOST, above=_USUAL),
    ),
    "M7 If an EKF estimates the traction, the estimates may be below zero": Claim(
        "runs of a search over start, first yaw, soil, bumps and field where μ̂ or κ̂ of an "
        "augmented EKF is below 0 at any sample; found in 400 runs",
        _on_experiment("search", possible, "lowest < 0")._replace(tables=None),
        "The paper has no such filter: W is the RHE's as printed, or by the same likelihood. The "
        "search ends with the first that is found.",
    ),
    "M8 … and beyond what is physical, that is above one": Claim(
        "share of fields where μ̂ or κ̂ of an augmented EKF is above 1 at any sample, on the "
        "default soil; seen at all",
        _on_logs("augmented_ekf", possible, "above_one"),
    ),
    "M9 … which makes the control unstable": Claim(
        "share of fields lost on slippery soil (κ 0.5 ± 0.2, μ 0.7 ± 0.15, 0.3 m/s), augmented EKF "
        "- the same EKF with bounds, paired; above 0",
        _on_logs(
            "augmented_ekf_slippery bounded_ekf_slippery",
            difference,
            _LOST,
            above=0,
            unit="share of fields",
        ),
    ),
    "M12 An EKF cannot deal with constraints on parameters": Claim(
        "true mean error, augmented EKF conditioned on the bound that it violates over RHE, "
        "paired; above 1",
        _on_runs(
            "bounded_ekf rhe",
            ratio,
            "mean_error_true_m",
            departures=[_TRACKING],
            above=1,
            paper="cannot",
        ),
        "Its estimates are within the bounds at every sample, by construction.",
    ),
    "M10 One iteration gives results similar to iterating to convergence": Claim(
        "true mean error, one iteration over ten, paired; within 0.95 to 1.05",
        _on_experiment(
            "iterations", ratio, "error_one_m", "error_many_m", above=0.95, below=1.05, paper=1.0
        ),
    ),
    "M11 Starting from the previous solution improves convergence": Claim(
        "distance of the first iteration's command from the converged one, warm over cold "
        "(previous estimate, nothing planned), paired; below 1",
        _on_experiment("iterations", ratio, "rms_warm", "rms_cold", below=1),
    ),
    "A1 With Q¹ the robot cannot reach the path in reasonable time": Claim(
        "share of fields where Q¹ takes more than twice as long as Q³ to stay within 0.12 m; "
        "above half",
        _on_runs("q1 q3", _share_twice, "settling_time_s", above=_USUAL, paper="cannot"),
    ),
    "A2 With Q² it oscillates around the path": Claim(
        "share of fields where Q² swings to the other side of the first row and back, each time "
        "by more than 0.05 m; above half",
        _on_logs("q2", share, "swings >= 2", departures=_SPEEDS, above=_USUAL, paper="oscillates"),
        "Without noise it comes back damped; what swings it back at 0.5 m/s is mostly noise. The "
        "slower the robot, the more it swings.",
    ),
    "A10 … that is, it overshoots more than with Q³": Claim(
        "overshoot on the first row, Q² over Q³, paired; at least 2",
        _on_runs("q2 q3", ratio, "overshoot_m", above=2),
        "The ratio falls with the speed, which the paper does not give and which was chosen here "
        "since Scenario A looks at it as described: see the multiverse.",
    ),
    "A9 To penalise the yaw error is extremely important": Claim(
        "true mean error after arrival on the first row, Q³ - Q² at equal R, paired; below 0",
        _on_runs("q3 q2", difference, "mean_error_true_m", departures=[_TRUE_FROM_START], below=0),
    ),
    "A3 With Q³ it reaches the path in reasonable time …": Claim(
        "share of fields where Q³ stays within 0.12 m from 15 s on or sooner; at least 95 %",
        _on_runs("q3", share, "settling_time_s <= 15", above=_RELIABLE, paper="reaches"),
    ),
    "A4 … and stays on track": Claim(
        "share of the fields where the oracle stays within 0.12 m to the end of the first row, in "
        "which it does; at least 95 %",
        _on_runs("q3 oracle_row", beside, _STAYS, above=_RELIABLE, paper="stays"),
    ),
    "A5 A fixed forward distance repairs Q²": Claim(
        "overshoot on the first row, Q² with 0.5 m look-ahead over Q², paired; at most half",
        _on_runs("q2_look_ahead q2", ratio, "overshoot_m", below=0.5),
    ),
    "A6 A small R essentially leads to low-gain control": Claim(
        "answer of the converged RHC to a small offset, R = 0.1 over R = 10, at random speeds and "
        "tractions; below 1",
        _on_property("gains", ratio, "small_r", "large_r", below=1),
        "R weighs the input: a smaller one makes control livelier, in any linear-quadratic "
        "problem.",
    ),
    "A7 A large R with the yaw weight tracks better than a small R without": Claim(
        "mean error from the start on the first row, Q³ with R = 10 - Q² with R = 0.1, paired; "
        "below 0",
        _on_runs("q3 q2_small_r", difference, "mean_error_from_start_m", below=0),
    ),
    "A8 … and so it does once on track": Claim(
        "true mean error after arrival on the first row, Q³ with R = 10 - Q² with R = 0.1, "
        "paired; below 0",
        _on_runs("q3 q2_small_r", difference, "mean_error_true_m", below=0),
    ),
    "B0 Slip makes a time-based reference run far ahead of or behind the robot": Claim(
        "time by which the robot trails the set speed at the end of a run of 240 s; mean above "
        "the horizon of 3 s",
        _on_logs("rhe", mean, "abs(late_s)", above=3, paper="large"),
    ),
    "B1 With the RHE the robot reaches the path and stays on it": Claim(
        "share of the fields where the oracle stays within 0.12 m, in which it does; at least 95 %",
        _on_runs("rhe oracle", beside, _STAYS, above=_RELIABLE, paper="stays"),
        "The mean error stays below 0.12 m nearly always; single turns do not.",
    ),
    "B2 With the EKF it does so, too": Claim(
        "share of the fields where the oracle stays within 0.12 m, in which it does; at least 95 %",
        _on_runs("ekf oracle", beside, _STAYS, above=_RELIABLE, paper="stays"),
    ),
    "B3 The RHE's mean Euclidean error is 0.0423 m": Claim(
        "the paper's value lies in the middle 95 % of single runs (their interval is given), and "
        "the mean is within a quarter of it",
        _on_runs(
            "rhe", reported, "mean_error_m", paper=paper.MEAN_ERROR_RHE_M, departures=[_FROM_START]
        ),
        _WHY_WHERE,
    ),
    "B4 The EKF's mean Euclidean error is 0.0514 m": Claim(
        "the paper's value lies in the middle 95 % of single runs (their interval is given), and "
        "the mean is within a quarter of it",
        _on_runs(
            "ekf", reported, "mean_error_m", paper=paper.MEAN_ERROR_EKF_M, departures=[_FROM_START]
        ),
        _WHY_WHERE,
    ),
    "B5 The RHE's error is the smaller": Claim(
        "mean error by raw GNSS, RHE - EKF, paired; below 0",
        _on_runs(
            "rhe ekf",
            difference,
            "mean_error_m",
            departures=[_FROM_START],
            below=0,
            paper=round(paper.MEAN_ERROR_RHE_M - paper.MEAN_ERROR_EKF_M, 4),
        ),
    ),
    "B6 It benefits from the traction estimates": Claim(
        "true mean error, RHE - the same RHE with μ = κ = 1 held, paired; below 0",
        _on_runs("rhe no_slip", difference, "mean_error_true_m", below=0),
    ),
    "B7 The RHEC does not violate 0.12 m on straight lines": Claim(
        "share of the fields where the oracle has no violation by raw GNSS, in which the RHEC has "
        "none; at least 95 %",
        _on_runs("rhe oracle", beside, "violations == 0", above=_RELIABLE, paper="never"),
        "Counted by raw GNSS, as in the paper, a violation may be the receiver's alone.",
    ),
    "B8 … by the true position": Claim(
        "the same by the true position; at least 95 %",
        _on_runs("rhe oracle", beside, "violations_true == 0", above=_RELIABLE),
    ),
    "B9 The EKF violates it 17 times": Claim(
        "17 lies in the middle 95 % of single runs (their interval is given), and the mean is "
        "within a quarter of it",
        _on_runs("ekf", reported, "violations", paper=paper.VIOLATIONS_EKF, unit="samples"),
        _WHY_WHERE,
    ),
    "B10 The RHEC violates it less often": Claim(
        "violations on straights by raw GNSS, RHE - EKF, paired; below 0",
        _on_runs("rhe ekf", difference, "violations", below=0, paper=-17, unit="samples"),
    ),
    "B11 Without an estimate of the yaw, model-based control is impossible": Claim(
        "share of fields where yaw by dead reckoning loses the path (never arrived, or 1 m off "
        "later); at least 95 %",
        _on_runs("dead_reckoning", share, _LOST, above=_RELIABLE),
    ),
    "B12 The traction estimates stay within 0 and 1": Claim(
        "every sample of a run; every run", _on_logs("rhe", always, "in_bounds")
    ),
    "B13 … and consistently close to the upper bound": Claim(
        "share of samples with both estimates at least 0.9; mean at least 95 %",
        _on_logs("rhe", mean, "near_bound", above=_RELIABLE, unit="share of samples"),
        _WHY_SOIL,
    ),
    "B14 The estimates stabilise at certain values": Claim(
        "standard deviation of κ̂ within the second half of a run; mean at most 0.1",
        _on_logs("rhe", mean, "deviation_kappa_late", below=0.1),
        _WHY_SOIL,
    ),
    "B15 On constant soil, hard-coded traction can track better": Claim(
        "true mean error, RHE with the true constants held - RHE, on soil of constant traction, "
        "paired; below 0",
        _on_runs("fixed_traction_constant rhe_constant", difference, "mean_error_true_m", below=0),
    ),
    "B16 … but only there: on varying soil estimating is better": Claim(
        "true mean error, RHE with the soil's means held - RHE, on the default soil, paired; above "
        "0",
        _on_runs("fixed_traction rhe", difference, "mean_error_true_m", above=0),
    ),
    "B17 The speed is constant": Claim(
        "standard deviation over mean of the tracks' speed, from 5 s on; below 5 % in at least 95 "
        "% of runs",
        _on_logs("rhe", share, "speed_variation < 0.05", above=_RELIABLE, paper="constant"),
    ),
    "B18 The RHE copes with noise on the speed": Claim(
        "RMS error of the speed, estimated over measured, paired; at most half",
        _on_logs("rhe", ratio, "rms_nu_hat_mps", "rms_nu_meas_mps", below=0.5),
        "Below 1 the estimate is the better one.",
    ),
    "B19 The RHC's output reaches its bounds": Claim(
        "share of fields where it does; at least 95 %",
        _on_logs("rhe", share, "reaches_bound", above=_RELIABLE, paper="reaches"),
    ),
    "B20 … and never violates them": Claim(
        "every sample of a run; every run", _on_logs("rhe", always, "within_bound")
    ),
    "B21 The low-level controller of the speed is sufficient": Claim(
        "-",
        _untestable(
            lambda of: mean(of["logs"]["rhe"]["rms_yaw_rate_radps"])[:4], "rad/s", "sufficient"
        ),
        "The speed loops and their noise are this project's own, not the Kangaroo's. Shown: the "
        "RMS distance of the yaw rate from the commanded one.",
    ),
    "T1 RHE and RHC take 0.88 ms on average": Claim(
        "-",
        _untestable(paper=paper.STEP_MEAN_MS),
        "Another machine: the paper's was a Raspberry Pi 3. Ours: table1_computation_times.csv.",
    ),
    "T2 … and 2.85 ms at worst": Claim(
        "-", _untestable(paper=paper.STEP_MAX_MS), "Another machine, as in T1. But see T8."
    ),
    "T3 The table's parts add up to its totals": Claim(
        "preparation + feedback of RHE and RHC, averages; within 0.01 ms of 0.88",
        _independent(
            lambda _: equal(_PHASES_MS, paper.STEP_MEAN_MS, 0.01), "ms", paper.STEP_MEAN_MS
        ),
    ),
    "T8 The worst case of 2.85 ms was observed": Claim(
        "the table's overall minima and maxima differ from the sums of their parts by more than "
        "0.0002 ms, as those of a sample's total would, in all of 4",
        _independent(
            lambda _: always(np.abs(np.diff(_SUMMED_MS)).ravel() > 2e-4), "share of numbers", "all"
        ),
        "They are the sums, which a sample's total reaches only if all parts are worst at once.",
    ),
    "T4 Feedback is shorter than preparation": Claim(
        "-",
        _untestable(paper="0.15 < 0.73 ms"),
        "How the work is divided belongs to an implementation; ours: table1_computation_times.csv.",
    ),
    "T6 One iteration instead of many lessens the computation time": Claim(
        "share of runs where the median step with one iteration takes less than half as long as "
        "with ten; above half",
        _on_experiment("iterations", share, "one_us < 0.5 * many_us", above=_USUAL),
    ),
    "T7 The framework is feasible in real time at 5 Hz": Claim(
        "share of samples that take less than 0.2 s; every sample",
        _on_property("times", always, "in_time", cases="samples"),
        "On this machine.",
    ),
    "T10 The estimator has three states and two parameters": Claim(
        "entries of p in eq. (6) beside the two that are counted, without the speed and with it",
        _Rule(
            {
                AS_PRINTED: lambda _: equal(_entries_of_p("parameter"), 2, 0),
                "ν as input": lambda _: equal(_entries_of_p("input"), 2, 0),
            },
            "parameters",
            2,
        ),
        "Eq. (6) has three, p = (ν, μ, κ); R6 takes the other.",
    ),
    "K1 The KKT tolerance is zero for linear systems": Claim(
        "RHC problem that is linear (yaw alone weighs), random states; below 1e-9 in all",
        _on_property("kkt", always, "linear_reported < 1e-9", paper=0),
        "Each sample's tolerance by ACADO's formula, taken where the iteration begins (R12): zero "
        "only where nothing changed. At the iteration's result it is.",
    ),
    "K2 Therefore values that are not zero show that the problem is not linear": Claim(
        "the reported tolerance of the linear problem, as in K1, is zero in all states",
        _on_property("kkt", always, "linear_reported < 1e-9"),
    ),
    "K3 The RHC's largest KKT tolerances arise at the beginning, off track": Claim(
        "share of fields where the largest is before arrival; above half",
        _on_logs("rhe", share, "kkt_rhc_largest_first", above=_USUAL),
    ),
    "K4 The RHC's KKT tolerance decreases until the robot is on track": Claim(
        "median after arrival over median before, paired; below 1",
        _on_logs("rhe", ratio, "kkt_rhc_after", "kkt_rhc_before", below=1),
    ),
    "K5 It cannot decrease further because the references keep changing": Claim(
        "median in the second half of a run on constant soil without noise or bumps over the "
        "usual one; at least half",
        _on_logs("rhe_undisturbed rhe", ratio, "kkt_rhc_late", above=0.5),
        "Without noise the references change just as much.",
    ),
    "K6 The RHE's KKT tolerance is large at the beginning and then decreases": Claim(
        "median over the second half of the run over median of its first 3 s, first yaw 1 rad "
        "wrong, paired; below 1",
        _on_logs("rhe_poor_start", ratio, "kkt_rhe_late", "kkt_rhe_first", below=1),
    ),
    "K7 A single iteration may leave a sub-optimal solution": Claim(
        "runs where the command is 0.0001 rad/s or more from the converged one at any sample; "
        "found",
        _on_experiment("iterations", possible, "max_warm >= 1e-4"),
    ),
    "C1 The RHE estimates the yaw precisely": Claim(
        "RMS error of the yaw; mean at most 2° (0.035 rad)",
        _on_runs("rhe", mean, "rms_yaw_rad", below=0.035),
    ),
    "C2 … and μ": Claim(
        "RMS error of μ; mean below the soil's own deviation of 0.04, which a constant would have",
        _on_runs("rhe", mean, "rms_mu", below=0.04),
    ),
    "C3 … and κ": Claim(
        "RMS error of κ; mean below the soil's own deviation of 0.08, which a constant would have",
        _on_runs("rhe", mean, "rms_kappa", below=0.08),
    ),
    "C4 Robots will navigate a variety of conditions without damaging the crop": Claim(
        "share of the fields where the oracle has no violation, in which the RHEC has none, soil "
        "of κ 0.6 ± 0.16, μ 0.8 ± 0.08, at 0.4 m/s; at least 95 %",
        _on_runs("rhe_uncertain oracle_uncertain", beside, "violations_true == 0", above=_RELIABLE),
    ),
}


def _by_id(sentences):
    """{id: Claim} of {"id sentence": Claim}, each with its sentence and section."""
    claims = {}
    section = ""
    starts = dict(each.split(" ", 1) for each in _SECTIONS.split(", "))
    for key, claim in sentences.items():
        id_, sentence = key.split(" ", 1)
        section = starts.get(id_, section)
        claims[id_] = claim._replace(claim=sentence, section=section)
    return claims


CLAIMS = _by_id(_SENTENCES)


def collect_evidence(seeds, folder=None):
    """All the evidence, {process noise: {"runs", "logs", "experiments"}}, with at most this many
    fields a label. folder: where the campaign's rows are kept.
    """
    runs = run_sets.runs(seeds, folder=folder)
    logs = run_sets.logs(seeds)
    parts = dict(runs=runs, logs=logs, experiments=experiments.all_of(seeds))
    return {
        process_noise: {name: part[process_noise] for name, part in parts.items()}
        for process_noise in run_sets.PROCESS_NOISES
    }


def _in_world(wanted, world, seeds):
    """Evidence of the tables {kind: ids} in a world of WORLDS, with W calibrated."""
    noise = "calibrated"
    found = {kind: {} for kind in ("runs", "logs", "experiments")}
    for kind, drive in {"runs": run_sets.runs, "logs": partial(run_sets.logs, part=1.0)}.items():
        if kind in wanted:
            found[kind] = drive(seeds, wanted[kind], [noise], world)[noise]
    if "experiments" in wanted:
        found["experiments"] = experiments.of_estimators(seeds, noise, world)
    return {noise: found}


def outcomes(evidence, seeds, claims=CLAIMS, worlds=run_sets.WORLDS):
    """Where each claim holds and where it does not, {id: {verdict: condition or world}}: under the
    ledger's conditions and, as long as one verdict is missing, in one world after the other, on so
    many fields.
    """
    found = {id_: {} for id_ in claims}
    for id_, claim in claims.items():
        for condition, rule in claim.rule.by_condition.items():
            found[id_].setdefault(rule(evidence).verdict, condition or "everywhere")
    for name, world in worlds.items():
        open_ = {id_: claims[id_].rule for id_ in claims if not {HOLDS, FAILS} <= {*found[id_]}}
        open_ = {id_: rule for id_, rule in open_.items() if rule.tables}
        if not open_:
            break
        wanted = {}
        for kind, ids in (each for rule in open_.values() for each in rule.tables.items()):
            wanted[kind] = [*dict.fromkeys([*wanted.get(kind, []), *ids])]
        elsewhere = _in_world(wanted, world, seeds)
        for id_, rule in open_.items():
            found[id_].setdefault(rule.by_condition[_CALIBRATED](elsewhere).verdict, name)
    return {
        id_: {verdict: where[verdict] for verdict in (HOLDS, FAILS) if verdict in where}
        for id_, where in found.items()
    }


def ledger(evidence, reached, claims=CLAIMS):
    """Judge claims: what the paper says, what was found, and the verdict.

    Args:
        evidence: of `collect_evidence`.
        reached: of `outcomes`.
        claims: {id: Claim}.

    Returns:
        DataFrame, one row a claim: id, section, claim, test, bound, paper, the Finding under the
        condition that decides (value, low, high, n, unit, verdict, condition, above, below); kind,
        the verdict or ONE_WAY; the verdict under each condition; the Finding under the first that
        says otherwise, or else the next (other_condition, other_value, …); where either verdict was
        reached; and why. p is the largest of the conditions', p_adjusted the same with the false
        discovery rate held over the whole ledger (Benjamini and Yekutieli); NaN where nothing is
        left to chance.
    """
    rows = []
    for id_, claim in claims.items():
        findings = {name: rule(evidence) for name, rule in claim.rule.by_condition.items()}
        said, deciding = combined(findings)
        own = findings[deciding]
        row = claim._asdict() | own._asdict() | claim.rule._asdict()
        row |= dict(id=id_, verdict=said, condition=deciding, other_condition="", other_verdict="")
        ps = [
            each.p for each in findings.values() if said == UNDECIDED or each.verdict != UNDECIDED
        ]
        row["p"] = np.nanmax([*ps, -1])
        row["conditions"] = "; ".join(f"{name}: {each.verdict}" for name, each in findings.items())
        either = {HOLDS, FAILS} <= {*reached[id_]} or said == UNTESTABLE
        row["kind"] = said if either else ONE_WAY
        row["reached"] = "; ".join(f"{verdict}: {at}" for verdict, at in reached[id_].items())
        others = {name: each for name, each in findings.items() if name != deciding}
        for name, found in sorted(others.items(), key=lambda e: e[1].verdict == own.verdict)[:1]:
            row["other_condition"] = name
            row |= {f"other_{field}": value for field, value in found._asdict().items()}
        rows.append(row)
    table = pd.DataFrame(rows, columns=_COLUMNS).replace({"p": {-1.0: np.nan}})
    chance = table["p"].notna()
    adjusted = stats.false_discovery_control(table.loc[chance, "p"], method="by")
    table.loc[chance, "p_adjusted"] = adjusted
    return table


def counts(table):
    """How many claims have each verdict: those that were tested, in order; then the others."""
    order = [HOLDS, *sorted({*table["kind"]} - {HOLDS, FAILS, UNDECIDED, ONE_WAY, UNTESTABLE})]
    order += [FAILS, UNDECIDED, ONE_WAY, UNTESTABLE]
    return table["kind"].value_counts().reindex(order, fill_value=0).rename_axis("verdict")


def survivors(table):
    """How many verdicts there are that rest on an interval, and the ids of those that do not remain
    with the false discovery rate of the whole ledger held at 5 %.
    """
    at_risk = table[table["p"].notna() & ~table["kind"].isin([UNDECIDED, ONE_WAY, UNTESTABLE])]
    return len(at_risk), list(at_risk.loc[at_risk["p_adjusted"] >= _DISCOVERIES, "id"])


def coverages(evidence, trials=2000):
    """How often the intervals behind the ledger cover, by resampling: one row a metric of RUNS that
    a mean, difference or ratio is taken of, and process noise.
    """
    asked = [
        (np.mean, ["rhe"], metric)
        for metric in ("mean_error_m", "mean_error_true_m", "violations", "rms_kappa")
    ]
    asked += [(difference_of_means, [one, other], "mean_error_true_m") for one, other in _PAIRS]
    asked += [(ratio_of_means, ["rhe", "oracle"], "mean_error_true_m")]
    return pd.DataFrame(
        dict(statistic=statistic.__name__, runs=" ".join(ids), metric=metric, process_noise=noise)
        | dict(n=len(samples[0]), coverage=coverage(statistic, *samples, trials=trials))
        for noise, of in evidence.items()
        for statistic, ids, metric in asked
        for samples in [list(zip(*zip(*(of["runs"][id_][metric] for id_ in ids))))]
    )
