"""The claims ledger: every checkable sentence of the paper, the rule that judges it, and what the
runs say.

A claim's rule was written before the runs it is judged on. Where the paper's words leave the bound
open, it is chosen here and stands in `test`: what is "ensured" or "never" happens must hold in
every field, what "reaches" or "stays" in at least 95 % of them, what is told of the experiments in
more than half; "much better" is at least twofold. A field is one seed: its soil and its noise
together.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.studies import timing
from rhec.studies.claims import experiments, run_sets
from rhec.studies.statistics import (
    FAILS,
    HOLDS,
    UNDECIDED,
    UNTESTABLE,
    Finding,
    always,
    combined,
    difference,
    equal,
    mean,
    possible,
    ratio,
    reported,
    share,
)

__all__ = ["CLAIMS", "Claim", "collect_evidence", "counts", "ledger"]

_RELIABLE, _USUAL = 0.95, 0.5


class _Rule(NamedTuple):
    """How a claim is judged: {condition: evidence -> Finding}, mostly under each process noise; the
    unit of its number, and the paper's number or word for it. Evidence is {process noise: {"runs",
    "logs", "experiments"}}.
    """

    by_condition: dict[str, Callable]
    unit: str = ""
    paper: object = ""


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


def _on_runs(
    labels, rule, *expressions, kind="runs", cases="fields", unit=None, paper=None, **bounds
):
    """A rule on expressions of the metrics of a label's runs, or of two labels' at equal seeds.

    Unless told, the unit is that in the name of the metric, or says what the share or ratio is of.
    """
    if rule is reported:
        bounds["paper"] = paper

    def judged(evidence, noise):
        tables = [evidence[noise][kind][label] for label in labels.split()]
        n = min(map(len, tables))
        values = [table[:n].eval(each, engine="python") for table in tables for each in expressions]
        return rule(*values, **bounds)

    if unit is None:
        suffix = expressions[0].rstrip(")").rsplit("_", 1)[-1]
        unit = suffix if suffix in ("m", "s", "rad") else "-"
        shares = dict.fromkeys((always, possible, share, _share_twice), f"share of {cases}")
        unit = ({ratio: "ratio"} | shares).get(rule, unit)
    if paper is None:
        paper = {always: "all", possible: "may"}.get(rule, "")
    return _Rule({n: partial(judged, noise=n) for n in run_sets.PROCESS_NOISES}, unit, paper)


_on_logs = partial(_on_runs, kind="logs")
_on_experiment = partial(_on_runs, kind="experiments", cases="runs")


def _on_property(name, rule, *expressions, cases="states", **options):
    """A rule on expressions of an experiment's table that no process noise touches."""
    found = _on_experiment(name, rule, *expressions, cases=cases, **options)
    return found._replace(by_condition={"": found.by_condition["printed"]})


def _under(rules):
    """One rule from {condition: rule on what no process noise touches}."""
    by_condition = {condition: rule.by_condition[""] for condition, rule in rules.items()}
    return next(iter(rules.values()))._replace(by_condition=by_condition)


def _by_solver(expression, paper):
    """A share of the samples above half, with each QP solver."""
    solvers = {"condensed QP": "times_daqp", "stage by stage QP": "times_structured"}
    options = dict(cases="samples", paper=paper, above=_USUAL)
    return _under(
        {
            solver: _on_property(name, share, expression, **options)
            for solver, name in solvers.items()
        }
    )


def _share_twice(one, other, **bounds):
    """The share of pairs where one is more than twice the other."""
    return share(one > 2 * other, **bounds)


def _milliseconds(of):
    """The whole step on this machine, at each sample [ms]."""
    return of["experiments"]["times_structured"].sum(axis=1) / 1e3


_PLACES = "reported", "after the step"
_STAYS = f"arrived & (mean_error_true_m < {paper.TOLERANCE_M})"
_LOST = "~arrived | (max_error_true_m > 1)"  # never reaches the path, or is a metre off it later
_BESIDE_M = (
    paper.ROW_SPACING_M - paper.STEM_WIDTH_M - paper.GNSS_ACCURACY_M - paper.ROBOT_WIDTH_M
) / 2
_PHASES_MS = sum(paper.TABLE_1_MS[column][1] for column in timing.PHASES)
_W_MEASURED, _W_UNMEASURED = (np.take(paper.SIGMA_W_RHE, at) for at in ([0, 1, 3], [2, 4, 5]))

_WHY_SOIL = (
    "It is the soil that decides: here μ is 0.9 ± 0.04 and κ 0.8 ± 0.08 on average, the paper's is "
    "unknown."
)
_WHY_WHERE = (
    "Speed, path, soil and bumps are not in the paper; the agreement, or its lack, says little "
    "about the field."
)
_SECTIONS = (  # of the paper, each from the claim on that it names
    "I1 Introduction, S1 System, H1 RHE, H3 Arrival cost, M1 Implementation, M7 EKF, M10 Solution, "
    "A1 Scenario A, B0 Scenario B, T1 Times, K1 KKT, C1 Conclusion"
)
_COLUMNS = (
    "id section claim test paper value low high n unit verdict condition above below "
    "other_condition other_value other_low other_high other_n other_verdict other_above "
    "other_below why"
).split()

_SENTENCES = {
    "I1 Rows of 0.78 m leave 0.12 m on either side of the robot": Claim(
        "(row - stem - GNSS - width) / 2, to the nearest cm, is the tolerance",
        _independent(lambda _: equal(_BESIDE_M, paper.TOLERANCE_M, 0.005), "m", paper.TOLERANCE_M),
    ),
    "I2 A tolerance of strictly less than 0.12 m is ensured": Claim(
        "share of fields where the RHEC's true error never reaches 0.12 m after arrival; ensured: "
        "every field",
        _on_runs("rhe", always, f"max_error_true_m < {paper.TOLERANCE_M}"),
        "All of the path counts, headlands too, by the true position.",
    ),
    "I3 Learning the traction keeps tracking robust where uncertainty is high": Claim(
        "true mean error on soil half as sure (κ 0.6 ± 0.16, μ 0.8 ± 0.08, at 0.4 m/s), RHE over "
        "EKF, paired; at most half",
        _on_runs("rhe_uncertain ekf_uncertain", ratio, "mean_error_true_m", below=0.5),
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
        "share of fields where μ̂ or κ̂ of an augmented EKF is below 0 at any sample, slippery "
        "soil (κ 0.5 ± 0.2, μ 0.7 ± 0.15, 0.3 m/s); seen at all",
        _on_logs("augmented_ekf_slippery", possible, "below_zero"),
        "The paper has no such filter: W is the RHE's as printed, or by the same likelihood. For "
        "the other bound see M8.",
    ),
    "M8 … and beyond what is physical, that is above one": Claim(
        "share of fields where μ̂ or κ̂ of an augmented EKF is above 1 at any sample, on the "
        "default soil; seen at all",
        _on_logs("augmented_ekf", possible, "above_one"),
    ),
    "M9 … which makes the control unstable": Claim(
        "share of fields lost on slippery soil, augmented EKF - RHE, paired; above 0",
        _on_logs(
            "augmented_ekf_slippery rhe_slippery",
            difference,
            _LOST,
            above=0,
            unit="share of fields",
        ),
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
        "overshoot on the first row, Q² over Q³, paired; at least 2",
        _on_runs("q2 q3", ratio, "overshoot_m", above=2, paper="oscillates"),
    ),
    "A3 With Q³ it reaches the path in reasonable time …": Claim(
        "share of fields where Q³ stays within 0.12 m from 15 s on or sooner; at least 95 %",
        _on_runs("q3", share, "settling_time_s <= 15", above=_RELIABLE, paper="reaches"),
    ),
    "A4 … and stays on track": Claim(
        "share of fields where the true error stays below 0.12 m to the end of the first row; at "
        "least 95 %",
        _on_runs(
            "q3",
            share,
            f"arrived & (max_error_true_m < {paper.TOLERANCE_M})",
            above=_RELIABLE,
            paper="stays",
        ),
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
        "share of fields where it arrives and its true mean error is below 0.12 m; at least 95 %",
        _on_runs("rhe", share, _STAYS, above=_RELIABLE, paper="stays"),
    ),
    "B2 With the EKF it does so, too": Claim(
        "share of fields where it arrives and its true mean error is below 0.12 m; at least 95 %",
        _on_runs("ekf", share, _STAYS, above=_RELIABLE, paper="stays"),
    ),
    "B3 The RHE's mean Euclidean error is 0.0423 m": Claim(
        "the paper's value lies in the middle 95 % of single runs (their interval is given)",
        _on_runs("rhe", reported, "mean_error_m", paper=paper.MEAN_ERROR_RHE_M),
        _WHY_WHERE,
    ),
    "B4 The EKF's mean Euclidean error is 0.0514 m": Claim(
        "the paper's value lies in the middle 95 % of single runs (their interval is given)",
        _on_runs("ekf", reported, "mean_error_m", paper=paper.MEAN_ERROR_EKF_M),
        _WHY_WHERE,
    ),
    "B5 The RHE's error is the smaller": Claim(
        "mean error by raw GNSS, RHE - EKF, paired; below 0",
        _on_runs(
            "rhe ekf",
            difference,
            "mean_error_m",
            below=0,
            paper=round(paper.MEAN_ERROR_RHE_M - paper.MEAN_ERROR_EKF_M, 4),
        ),
    ),
    "B6 It benefits from the traction estimates": Claim(
        "true mean error, EKF told the true traction - EKF told none, paired; below 0",
        _on_runs("known_traction ekf", difference, "mean_error_true_m", below=0),
    ),
    "B7 The RHEC does not violate 0.12 m on straight lines": Claim(
        "share of fields without a violation by raw GNSS; every field",
        _on_runs("rhe", always, "violations == 0"),
        "Counted by raw GNSS, as in the paper, a violation may be the receiver's alone.",
    ),
    "B8 … by the true position": Claim(
        "share of fields without a violation by the true position; every field",
        _on_runs("rhe", always, "violations_true == 0", paper=""),
    ),
    "B9 The EKF violates it 17 times": Claim(
        "17 lies in the middle 95 % of single runs (their interval is given)",
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
        "true mean error, EKF with the true constants - RHE, on soil of constant traction, "
        "paired; below 0",
        _on_runs("fixed_traction_constant rhe_constant", difference, "mean_error_true_m", below=0),
    ),
    "B16 … but only there: on varying soil estimating is better": Claim(
        "true mean error, EKF with the soil's means hard-coded - RHE, on the default soil, "
        "paired; above 0",
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
        "Below 1 the estimate is the better one. What is left is mostly the tracks' own jitter, "
        "which one speed over 3 s cannot follow.",
    ),
    "B19 The RHC's output reaches its bounds": Claim(
        "share of fields where it does; at least 95 %",
        _on_logs("rhe", share, "reaches_bound", above=_RELIABLE, paper="reaches"),
    ),
    "B20 … and never violates them": Claim(
        "every sample of a run; every run", _on_logs("rhe", always, "within_bound")
    ),
    "B21 The low-level controller of the speed is sufficient": Claim(
        "RMS distance of the yaw rate from the commanded one; below the 0.0175 rad/s to which the "
        "paper measures it in at least 95 % of runs",
        _on_logs(
            "rhe",
            share,
            f"rms_yaw_rate_radps < {paper.SIGMA_V[3]}",
            above=_RELIABLE,
            paper="sufficient",
        ),
        "The speed loops are this project's own; the distance is what the encoders' noise makes "
        "of them.",
    ),
    "T1 RHE and RHC take 0.88 ms on average": Claim(
        "-",
        _untestable(lambda of: mean(_milliseconds(of))[:4], "ms", paper.STEP_MEAN_MS),
        "Another machine: the paper's was a Raspberry Pi 3.",
    ),
    "T2 … and 2.85 ms at worst": Claim(
        "-",
        _untestable(
            lambda of: (_milliseconds(of).max(), np.nan, np.nan, len(_milliseconds(of))),
            "ms",
            paper.STEP_MAX_MS,
        ),
        "Another machine, and the worst of some hundred samples.",
    ),
    "T3 The table's parts add up to its totals": Claim(
        "preparation + feedback of RHE and RHC, averages; within 0.01 ms of 0.88",
        _independent(
            lambda _: equal(_PHASES_MS, paper.STEP_MEAN_MS, 0.01), "ms", paper.STEP_MEAN_MS
        ),
    ),
    "T4 Feedback is shorter than preparation: RHE": Claim(
        "share of samples where it is; above half",
        _by_solver("RHE_feedback < RHE_preparation", paper="0.13 < 0.35 ms"),
    ),
    "T5 Feedback is shorter than preparation: RHC": Claim(
        "share of samples where it is; above half",
        _by_solver("RHC_feedback < RHC_preparation", paper="0.02 < 0.38 ms"),
        "The paper's ratio is that of ACADO's generated code with qpOASES; which phase is the "
        "longer depends on the code.",
    ),
    "T6 One iteration instead of many lessens the computation time": Claim(
        "time of a sample, one iteration over ten, paired; at most half",
        _on_experiment("iterations", ratio, "one_us", "many_us", below=0.5),
    ),
    "T7 The framework is feasible in real time at 5 Hz": Claim(
        "share of samples that take less than 0.2 s; every sample",
        _independent(
            lambda of: always(_milliseconds(of) < 1e3 * paper.DT_S), "share of samples", "all"
        ),
        "On this machine.",
    ),
    "K1 The KKT tolerance is zero for linear systems": Claim(
        "RHC problem that is linear (yaw alone weighs), random states; below 1e-9 in all",
        _under(
            {
                place: _on_property("kkt", always, f"`linear_{place}` < 1e-9", paper=0)
                for place in _PLACES
            }
        ),
        "\"Reported\" is each sample's tolerance by ACADO's formula, taken where the iteration "
        'begins: it is zero only where nothing changed. "After the step" is taken at the '
        "iteration's result.",
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
        "median over the second half of the run over median of its first 3 s, paired; below 1",
        _on_logs("rhe", ratio, "kkt_rhe_late", "kkt_rhe_first", below=1),
    ),
    "K7 A single iteration may leave a sub-optimal solution": Claim(
        "share of runs where the command is 0.0001 rad/s (RMS) or more from the converged one; "
        "seen at all",
        _on_experiment("iterations", possible, "rms_warm >= 1e-4"),
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
        "share of fields without a violation by the true position, soil of κ 0.6 ± 0.16, μ 0.8 ± "
        "0.08, at 0.4 m/s; every field",
        _on_runs("rhe_uncertain", always, "violations_true == 0"),
    ),
}


def _by_id(sentences):
    """{id: Claim} of {"id sentence": Claim}, each with its sentence and section."""
    claims, section = {}, ""
    starts = dict(each.split(" ", 1) for each in _SECTIONS.split(", "))
    for key, claim in sentences.items():
        id_, sentence = key.split(" ", 1)
        section = starts.get(id_, section)
        claims[id_] = claim._replace(claim=sentence, section=section)
    return claims


CLAIMS = _by_id(_SENTENCES)


def collect_evidence(seeds):
    """All the evidence, {process noise: {"runs", "logs", "experiments"}}, with at most this many
    fields a label.
    """
    parts = dict(
        runs=run_sets.runs(seeds), logs=run_sets.logs(seeds), experiments=experiments.all_of(seeds)
    )
    return {
        process_noise: {name: part[process_noise] for name, part in parts.items()}
        for process_noise in run_sets.PROCESS_NOISES
    }


def ledger(evidence, claims=CLAIMS):
    """Judge claims: what the paper says, what was found, and the verdict.

    Args:
        evidence: of `collect_evidence`.
        claims: {id: Claim}.

    Returns:
        DataFrame, one row a claim: id, section, claim, test, paper, the Finding under the condition
        that decides (value, low, high, n, unit, verdict, condition, above, below), the one under
        the other condition (other_condition, other_value, …), and why.
    """
    rows = []
    for id_, claim in claims.items():
        findings = {name: rule(evidence) for name, rule in claim.rule.by_condition.items()}
        said, deciding = combined(findings)
        row = claim._asdict() | findings.pop(deciding)._asdict()
        row |= dict(id=id_, unit=claim.rule.unit, paper=claim.rule.paper)
        row |= dict(verdict=said, condition=deciding)
        for condition, finding in findings.items():
            row["other_condition"] = condition
            row |= {f"other_{name}": value for name, value in finding._asdict().items()}
        rows.append(row)
    return pd.DataFrame(rows, columns=_COLUMNS).fillna({"other_condition": "", "other_verdict": ""})


def counts(table):
    """How many claims have each verdict, in the order of the verdicts."""
    one = f"{HOLDS} under one condition"
    kinds = table["verdict"].str.replace(f"{HOLDS} under .*", one, regex=True)
    order = [HOLDS, one, FAILS, UNDECIDED, UNTESTABLE]
    return kinds.value_counts().reindex(order, fill_value=0).rename_axis("verdict")
