"""The claims ledger: every checkable sentence of the paper, the rule that judges it, and what the
runs say.

A claim's rule was written before the runs it is judged on. Where the paper's words leave the bound
open, it is chosen here and stands in `test`: what is "ensured" or "never" happens must hold in
every field, what "reaches" or "stays" in at least 95 % of them, what is told of the experiments in
more than half; "much better" is at least twofold. A field is one seed: its soil and its noise
together.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
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
    unit of its number, and the paper's word for it. Evidence is {process noise: {"runs", "logs",
    "experiments"}}.
    """

    by_condition: dict[str, Callable]
    unit: str = ""
    paper: str = ""


class Claim(NamedTuple):
    """A sentence of the paper, its test in words, its rule, and what is known of the reason; the
    number or word of the paper and the unit where they are not the rule's.
    """

    claim: str
    test: str
    rule: _Rule
    why: str = ""
    paper: object = None
    unit: str = ""


def _under_each_noise(rule):
    """A rule under both process noises, on the evidence of each."""

    def under(noise):
        return lambda evidence: rule(evidence[noise])

    return {noise: under(noise) for noise in run_sets.PROCESS_NOISES}


def _noise_independent(rule):
    """A rule on what no process noise touches."""
    return _Rule({"": lambda evidence: rule(evidence["printed"])})


def _untestable(shown=lambda of: (np.nan, np.nan, np.nan, 0)):
    """No run here can decide; shows a number (value, low, high, n) where there is one."""
    return _noise_independent(lambda of: Finding(*shown(of), UNTESTABLE))


def _judge(rule, tables, expressions, bounds):
    """A rule on expressions of tables' columns."""
    values = [table.eval(each, engine="python") for table in tables for each in expressions]
    return rule(*values, **bounds)


def _named(by_condition, rule, cases, expression):
    """A rule with its unit, for a mean or a difference that in its column's name, and the paper's
    word.
    """
    suffix = expression.rstrip(")").rsplit("_", 1)[-1]
    unit = suffix if suffix in ("m", "s", "rad") else "-"
    if rule in (always, possible, share, _share_twice):
        unit = f"share of {cases}"
    paper = {always: "all", possible: "may"}.get(rule, "")
    return _Rule(by_condition, "ratio" if rule is ratio else unit, paper)


def _on_runs(label, rule, *expressions, kind="runs", cases="fields", **bounds):
    """A rule on expressions of the metrics of one label's runs."""
    by_condition = _under_each_noise(
        lambda of: _judge(rule, [of[kind][label]], expressions, bounds)
    )
    return _named(by_condition, rule, cases, expressions[0])


def _on_logs(label, rule, *expressions, **bounds):
    """A rule on expressions of what one label's logs show."""
    return _on_runs(label, rule, *expressions, kind="logs", **bounds)


def _on_experiment(name, rule, *expressions, cases="runs", **bounds):
    """A rule on expressions of an experiment's table."""
    return _on_runs(name, rule, *expressions, kind="experiments", cases=cases, **bounds)


def _on_property(name, rule, *expressions, cases="states", **bounds):
    """A rule on expressions of an experiment's table that no process noise touches."""
    found = _on_experiment(name, rule, *expressions, cases=cases, **bounds)
    return found._replace(by_condition={"": found.by_condition["printed"]})


def _compare(one, other, rule, expression, kind="runs", **bounds):
    """A rule on the same expression of two labels' runs (or logs), at equal seeds."""

    def paired(of):
        n = min(len(of[kind][one]), len(of[kind][other]))
        return _judge(rule, [of[kind][label][:n] for label in (one, other)], [expression], bounds)

    return _named(_under_each_noise(paired), rule, "fields", expression)


def _under(rules):
    """One rule from {condition: rule on what no process noise touches}."""
    first = next(iter(rules.values()))
    return first._replace(
        by_condition={condition: rule.by_condition[""] for condition, rule in rules.items()}
    )


def _by_solver(expression):
    """A share of the samples above half, with each QP solver."""
    solvers = {"condensed QP": "times_daqp", "stage by stage QP": "times_structured"}
    return _under(
        {
            solver: _on_property(name, share, expression, cases="samples", above=_USUAL)
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
_PHASES_MS = sum(
    paper.TABLE_1_MS[problem, phase][1]
    for problem in ("RHE", "RHC")
    for phase in ("preparation", "feedback")
)
_W_MEASURED, _W_UNMEASURED = (np.take(paper.SIGMA_W_RHE, at) for at in ([0, 1, 3], [2, 4, 5]))

_WHY_SOIL = (
    "It is the soil that decides: here μ is 0.9 ± 0.04 and κ 0.8 ± 0.08 on average, the paper's is "
    "unknown."
)
_WHY_WHERE = (
    "Speed, path, soil and bumps are not in the paper; the agreement, or its lack, says little "
    "about the field."
)
_SECTIONS = {
    "Introduction": "I1 I2 I3 I4 I5",
    "System": "S1 S2 S3 S4",
    "RHE": "H1 H2",
    "Arrival cost": "H3 H4 H5 H6",
    "Implementation": "M1 M2 M3 M4 M5 M6",
    "EKF": "M7 M8 M9",
    "Solution": "M10 M11",
    "Scenario A": "A1 A2 A3 A4 A5 A6 A7 A8",
    "Scenario B": " ".join(f"B{number}" for number in range(22)),
    "Times": "T1 T2 T3 T4 T5 T6 T7",
    "KKT": "K1 K2 K3 K4 K5 K6 K7",
    "Conclusion": "C1 C2 C3 C4",
}
_SECTION_OF = {id_: section for section, ids in _SECTIONS.items() for id_ in ids.split()}
_COLUMNS = (
    "id section claim test paper value low high n unit verdict condition above below "
    "other_condition other_value other_low other_high other_n other_verdict other_above "
    "other_below why"
).split()

CLAIMS = {
    "I1": Claim(
        "Rows of 0.78 m leave 0.12 m on either side of the robot",
        "(row - stem - GNSS - width) / 2, to the nearest cm, is the tolerance",
        _noise_independent(lambda _: equal(_BESIDE_M, paper.TOLERANCE_M, 0.005)),
        paper=paper.TOLERANCE_M,
        unit="m",
    ),
    "I2": Claim(
        "A tolerance of strictly less than 0.12 m is ensured",
        "share of fields where the RHEC's true error never reaches 0.12 m after arrival; ensured: "
        "every field",
        _on_runs("rhe", always, f"max_error_true_m < {paper.TOLERANCE_M}"),
        "All of the path counts, headlands too, by the true position.",
    ),
    "I3": Claim(
        "Learning the traction keeps tracking robust where uncertainty is high",
        "true mean error on soil half as sure (κ 0.6 ± 0.16, μ 0.8 ± 0.08, at 0.4 m/s), RHE over "
        "EKF, paired; at most half",
        _compare("rhe_uncertain", "ekf_uncertain", ratio, "mean_error_true_m", below=0.5),
    ),
    "I4": Claim(
        "Linear MPC and PID track poorly off the path and on unknown soil",
        "-",
        _untestable(),
        "Neither is specified in the paper, and none is implemented here; a strawman would prove "
        "nothing.",
    ),
    "I5": Claim(
        "A tube-based MPC stays on track without high accuracy",
        "-",
        _untestable(),
        "Another paper's controller.",
    ),
    "S1": Claim(
        "Two batteries drive the robot for over 3 hours",
        "-",
        _untestable(),
        "The simulated robot has no batteries.",
    ),
    "S2": Claim(
        "With μ = κ = 1 the model is the traditional one, without slip",
        "one step of the model at random states against the unicycle's circle; equal to 0.1 mm or "
        "mrad in all",
        _on_property("models", always, "off_unicycle_m < 1e-4"),
    ),
    "S3": Claim(
        "f(0, 0, p) = 0 for all p",
        "|f(0, 0, p)| at random p; below 1 nm/s in all",
        _on_property("models", always, "at_rest_mps < 1e-9"),
        "At ξ = 0, u = 0 the model gives ẋ = μν: the speed is a parameter, so that a robot "
        "without input still drives.",
    ),
    "S4": Claim(
        "Traction must be estimated, or the estimates are biased",
        "|mean yaw error| in the curves, EKF (μ = κ = 1) over RHE, paired; at least twice",
        _compare("ekf", "rhe", ratio, "abs(yaw_bias_rad)", "logs", above=2),
    ),
    "H1": Claim(
        "Parameters taken as random constants become biased where they drift",
        "RMS error of μ, RHE with W = 0 for μ and κ over RHE, paired; above 1",
        _compare("rhe_constant_parameters", "rhe", ratio, "rms_mu", "logs", above=1),
    ),
    "H2": Claim(
        "Large values in W make the estimates vary more",
        "RMS change of κ̂ from sample to sample, RHE over RHE with a tenth of W's μ and κ, "
        "paired; above 1",
        _compare("rhe", "rhe_small_w", ratio, "step_kappa", "logs", above=1),
    ),
    "H3": Claim(
        "H_N is bounded by the inverse of W",
        "least eigenvalue of P - W in units of W, P the inverse of H_N, over all samples of a "
        "run; at least -1e-9 in all runs",
        _on_experiment("arrival_cost", always, "least >= -1e-9"),
    ),
    "H4": Claim(
        "A constant, large arrival weight makes the estimates chatter",
        "RMS change of κ̂ from sample to sample, constant weight 100 times the mean one over "
        "adaptive, paired; above 1",
        _on_experiment("arrival_cost", ratio, "step_heavy", "step_adaptive", above=1),
        "A large weight holds the estimates to the previous ones: by the paper's own cost "
        "function it makes them slow, not lively.",
    ),
    "H5": Claim(
        "A constant, small arrival weight keeps them from the true values for long",
        "time until κ̂ is within 0.1 of κ for 5 s, constant weight of 1/100 of the mean one over "
        "adaptive, paired; above 1",
        _on_experiment("arrival_cost", ratio, "reached_s_light", "reached_s_adaptive", above=1),
        "A small weight leaves κ̂ to the noise of the window: it comes near the truth and does "
        "not stay.",
    ),
    "H6": Claim(
        "The arrival cost is necessary for the stability of the RHE",
        "share of runs whose yaw estimate is more than 0.5 rad off at any time when the arrival "
        "cost has no weight; at least half",
        _on_experiment("arrival_cost", share, "lost_none", above=_USUAL),
        "Bounds on μ and κ and 3 s of positions keep the pose without it.",
    ),
    "M1": Claim(
        "Low process noise estimates more accurately",
        "RMS error of κ, RHE with a tenth of W's μ and κ over RHE, paired; below 1",
        _compare("rhe_small_w", "rhe", ratio, "rms_kappa", "logs", below=1),
    ),
    "M2": Claim(
        "Low process noise makes the estimates lag behind the true values",
        "lag of μ̂ behind μ, RHE with a tenth of W's μ and κ - RHE, paired; above 0",
        _compare("rhe_small_w", "rhe", difference, "lag_mu_s", "logs", above=0),
    ),
    "M3": Claim(
        "W is large for what is measured and small for what is not",
        "the least of W's numbers for x, y, ν exceeds the largest for θ, μ, κ, whatever their "
        "units",
        _noise_independent(lambda _: always([min(_W_MEASURED) > max(_W_UNMEASURED)])),
        paper="all",
        unit="share of cases",
    ),
    "M4": Claim(
        "The path's yaw rate as input reference may leave a steady error",
        "|mean offset| from the path in the curves, EKF (μ = κ = 1), input reference path's over "
        "measured yaw rate, paired; above 1",
        _compare("ekf_path_yaw_rate", "ekf", ratio, "abs(offset_curves_m)", "logs", above=1),
    ),
    "M5": Claim(
        "R larger than Q keeps the closed loop well damped",
        "overshoot on the first row, R = 0.1 over R = 10, paired; above 1",
        _compare("q3_small_r", "q3", ratio, "overshoot_m", above=1),
    ),
    "M6": Claim(
        "The weight on the horizon's end (Q_N = 10 Q) is critical for stability",
        "share of fields lost on the first row (never arrived, or 1 m off later) with Q_N = 0; at "
        "least half",
        _on_runs("q3_no_terminal_weight", share, _LOST, above=_USUAL),
    ),
    "M7": Claim(
        "If an EKF estimates the traction, the estimates may be below zero",
        "share of fields where μ̂ or κ̂ of an augmented EKF is below 0 at any sample, slippery "
        "soil (κ 0.5 ± 0.2, μ 0.7 ± 0.15, 0.3 m/s); seen at all",
        _on_logs("augmented_ekf_slippery", possible, "below_zero"),
        "The paper has no such filter: W is the RHE's as printed, or by the same likelihood. For "
        "the other bound see M8.",
    ),
    "M8": Claim(
        "… and beyond what is physical, that is above one",
        "share of fields where μ̂ or κ̂ of an augmented EKF is above 1 at any sample, on the "
        "default soil; seen at all",
        _on_logs("augmented_ekf", possible, "above_one"),
    ),
    "M9": Claim(
        "… which makes the control unstable",
        "share of fields lost on slippery soil, augmented EKF - RHE, paired; above 0",
        _compare("augmented_ekf_slippery", "rhe_slippery", difference, _LOST, "logs", above=0),
        unit="share of fields",
    ),
    "M10": Claim(
        "One iteration gives results similar to iterating to convergence",
        "true mean error, one iteration over ten, paired; within 0.95 to 1.05",
        _on_experiment("iterations", ratio, "error_one_m", "error_many_m", above=0.95, below=1.05),
        paper=1.0,
    ),
    "M11": Claim(
        "Starting from the previous solution improves convergence",
        "distance of the first iteration's command from the converged one, warm over cold "
        "(previous estimate, nothing planned), paired; below 1",
        _on_experiment("iterations", ratio, "rms_warm", "rms_cold", below=1),
    ),
    "A1": Claim(
        "With Q¹ the robot cannot reach the path in reasonable time",
        "share of fields where Q¹ takes more than twice as long as Q³ to stay within 0.12 m; "
        "above half",
        _compare("q1", "q3", _share_twice, "settling_time_s", above=_USUAL),
        paper="cannot",
    ),
    "A2": Claim(
        "With Q² it oscillates around the path",
        "overshoot on the first row, Q² over Q³, paired; at least 2",
        _compare("q2", "q3", ratio, "overshoot_m", above=2),
        paper="oscillates",
    ),
    "A3": Claim(
        "With Q³ it reaches the path in reasonable time …",
        "share of fields where Q³ stays within 0.12 m from 15 s on or sooner; at least 95 %",
        _on_runs("q3", share, "settling_time_s <= 15", above=_RELIABLE),
        paper="reaches",
    ),
    "A4": Claim(
        "… and stays on track",
        "share of fields where the true error stays below 0.12 m to the end of the first row; at "
        "least 95 %",
        _on_runs(
            "q3", share, f"arrived & (max_error_true_m < {paper.TOLERANCE_M})", above=_RELIABLE
        ),
        paper="stays",
    ),
    "A5": Claim(
        "A fixed forward distance repairs Q²",
        "overshoot on the first row, Q² with 0.5 m look-ahead over Q², paired; at most half",
        _compare("q2_look_ahead", "q2", ratio, "overshoot_m", below=0.5),
    ),
    "A6": Claim(
        "A small R essentially leads to low-gain control",
        "answer of the converged RHC to a small offset, R = 0.1 over R = 10, at random speeds and "
        "tractions; below 1",
        _on_property("gains", ratio, "small_r", "large_r", below=1),
        "R weighs the input: a smaller one makes control livelier, in any linear-quadratic "
        "problem.",
    ),
    "A7": Claim(
        "A large R with the yaw weight tracks better than a small R without",
        "mean error from the start on the first row, Q³ with R = 10 - Q² with R = 0.1, paired; "
        "below 0",
        _compare("q3", "q2_small_r", difference, "mean_error_from_start_m", below=0),
    ),
    "A8": Claim(
        "… and so it does once on track",
        "true mean error after arrival on the first row, Q³ with R = 10 - Q² with R = 0.1, "
        "paired; below 0",
        _compare("q3", "q2_small_r", difference, "mean_error_true_m", below=0),
    ),
    "B0": Claim(
        "Slip makes a time-based reference run far ahead of or behind the robot",
        "time by which the robot trails the set speed at the end of a run of 240 s; mean above "
        "the horizon of 3 s",
        _on_logs("rhe", mean, "abs(late_s)", above=3),
        paper="large",
    ),
    "B1": Claim(
        "With the RHE the robot reaches the path and stays on it",
        "share of fields where it arrives and its true mean error is below 0.12 m; at least 95 %",
        _on_runs("rhe", share, _STAYS, above=_RELIABLE),
        paper="stays",
    ),
    "B2": Claim(
        "With the EKF it does so, too",
        "share of fields where it arrives and its true mean error is below 0.12 m; at least 95 %",
        _on_runs("ekf", share, _STAYS, above=_RELIABLE),
        paper="stays",
    ),
    "B3": Claim(
        "The RHE's mean Euclidean error is 0.0423 m",
        "the paper's value lies in the middle 95 % of single runs (their interval is given)",
        _on_runs("rhe", reported, "mean_error_m", paper=paper.MEAN_ERROR_RHE_M),
        _WHY_WHERE,
        paper=paper.MEAN_ERROR_RHE_M,
    ),
    "B4": Claim(
        "The EKF's mean Euclidean error is 0.0514 m",
        "the paper's value lies in the middle 95 % of single runs (their interval is given)",
        _on_runs("ekf", reported, "mean_error_m", paper=paper.MEAN_ERROR_EKF_M),
        _WHY_WHERE,
        paper=paper.MEAN_ERROR_EKF_M,
    ),
    "B5": Claim(
        "The RHE's error is the smaller",
        "mean error by raw GNSS, RHE - EKF, paired; below 0",
        _compare("rhe", "ekf", difference, "mean_error_m", below=0),
        paper=round(paper.MEAN_ERROR_RHE_M - paper.MEAN_ERROR_EKF_M, 4),
    ),
    "B6": Claim(
        "It benefits from the traction estimates",
        "true mean error, EKF told the true traction - EKF told none, paired; below 0",
        _compare("known_traction", "ekf", difference, "mean_error_true_m", below=0),
    ),
    "B7": Claim(
        "The RHEC does not violate 0.12 m on straight lines",
        "share of fields without a violation by raw GNSS; every field",
        _on_runs("rhe", always, "violations == 0"),
        "Counted by raw GNSS, as in the paper, a violation may be the receiver's alone.",
    ),
    "B8": Claim(
        "… by the true position",
        "share of fields without a violation by the true position; every field",
        _on_runs("rhe", always, "violations_true == 0"),
        paper="",
    ),
    "B9": Claim(
        "The EKF violates it 17 times",
        "17 lies in the middle 95 % of single runs (their interval is given)",
        _on_runs("ekf", reported, "violations", paper=paper.VIOLATIONS_EKF),
        _WHY_WHERE,
        paper=paper.VIOLATIONS_EKF,
        unit="samples",
    ),
    "B10": Claim(
        "The RHEC violates it less often",
        "violations on straights by raw GNSS, RHE - EKF, paired; below 0",
        _compare("rhe", "ekf", difference, "violations", below=0),
        paper=-17,
        unit="samples",
    ),
    "B11": Claim(
        "Without an estimate of the yaw, model-based control is impossible",
        "share of fields where yaw by dead reckoning loses the path (never arrived, or 1 m off "
        "later); at least 95 %",
        _on_runs("dead_reckoning", share, _LOST, above=_RELIABLE),
    ),
    "B12": Claim(
        "The traction estimates stay within 0 and 1",
        "every sample of a run; every run",
        _on_logs("rhe", always, "in_bounds"),
    ),
    "B13": Claim(
        "… and consistently close to the upper bound",
        "share of samples with both estimates at least 0.9; mean at least 95 %",
        _on_logs("rhe", mean, "near_bound", above=_RELIABLE),
        _WHY_SOIL,
        unit="share of samples",
    ),
    "B14": Claim(
        "The estimates stabilise at certain values",
        "standard deviation of κ̂ within the second half of a run; mean at most 0.1",
        _on_logs("rhe", mean, "deviation_kappa_late", below=0.1),
        _WHY_SOIL,
    ),
    "B15": Claim(
        "On constant soil, hard-coded traction can track better",
        "true mean error, EKF with the true constants - RHE, on soil of constant traction, "
        "paired; below 0",
        _compare(
            "fixed_traction_constant", "rhe_constant", difference, "mean_error_true_m", below=0
        ),
    ),
    "B16": Claim(
        "… but only there: on varying soil estimating is better",
        "true mean error, EKF with the soil's means hard-coded - RHE, on the default soil, "
        "paired; above 0",
        _compare("fixed_traction", "rhe", difference, "mean_error_true_m", above=0),
    ),
    "B17": Claim(
        "The speed is constant",
        "standard deviation over mean of the tracks' speed, from 5 s on; below 5 % in at least 95 "
        "% of runs",
        _on_logs("rhe", share, "speed_variation < 0.05", above=_RELIABLE),
        paper="constant",
    ),
    "B18": Claim(
        "The RHE copes with noise on the speed",
        "RMS error of the speed, estimated over measured, paired; at most half",
        _on_logs("rhe", ratio, "rms_nu_hat_mps", "rms_nu_meas_mps", below=0.5),
        "Below 1 the estimate is the better one. What is left is mostly the tracks' own jitter, "
        "which one speed over 3 s cannot follow.",
    ),
    "B19": Claim(
        "The RHC's output reaches its bounds",
        "share of fields where it does; at least 95 %",
        _on_logs("rhe", share, "reaches_bound", above=_RELIABLE),
        paper="reaches",
    ),
    "B20": Claim(
        "… and never violates them",
        "every sample of a run; every run",
        _on_logs("rhe", always, "within_bound"),
    ),
    "B21": Claim(
        "The low-level controller of the speed is sufficient",
        "RMS distance of the yaw rate from the commanded one; below the 0.0175 rad/s to which the "
        "paper measures it in at least 95 % of runs",
        _on_logs("rhe", share, f"rms_yaw_rate_radps < {paper.SIGMA_V[3]}", above=_RELIABLE),
        "The speed loops are this project's own; the distance is what the encoders' noise makes "
        "of them.",
        paper="sufficient",
    ),
    "T1": Claim(
        "RHE and RHC take 0.88 ms on average",
        "-",
        _untestable(lambda of: mean(_milliseconds(of))[:4]),
        "Another machine: the paper's was a Raspberry Pi 3.",
        paper=paper.STEP_MEAN_MS,
        unit="ms",
    ),
    "T2": Claim(
        "… and 2.85 ms at worst",
        "-",
        _untestable(lambda of: (_milliseconds(of).max(), np.nan, np.nan, len(_milliseconds(of)))),
        "Another machine, and the worst of some hundred samples.",
        paper=paper.STEP_MAX_MS,
        unit="ms",
    ),
    "T3": Claim(
        "The table's parts add up to its totals",
        "preparation + feedback of RHE and RHC, averages; within 0.01 ms of 0.88",
        _noise_independent(lambda _: equal(_PHASES_MS, paper.STEP_MEAN_MS, 0.01)),
        paper=paper.STEP_MEAN_MS,
        unit="ms",
    ),
    "T4": Claim(
        "Feedback is shorter than preparation: RHE",
        "share of samples where it is; above half",
        _by_solver("RHE_feedback < RHE_preparation"),
        paper="0.13 < 0.35 ms",
    ),
    "T5": Claim(
        "Feedback is shorter than preparation: RHC",
        "share of samples where it is; above half",
        _by_solver("RHC_feedback < RHC_preparation"),
        "The paper's ratio is that of ACADO's generated code with qpOASES; which phase is the "
        "longer depends on the code.",
        paper="0.02 < 0.38 ms",
    ),
    "T6": Claim(
        "One iteration instead of many lessens the computation time",
        "time of a sample, one iteration over ten, paired; at most half",
        _on_experiment("iterations", ratio, "one_us", "many_us", below=0.5),
    ),
    "T7": Claim(
        "The framework is feasible in real time at 5 Hz",
        "share of samples that take less than 0.2 s; every sample",
        _noise_independent(lambda of: always(_milliseconds(of) < 1e3 * paper.DT_S)),
        "On this machine.",
        paper="all",
        unit="share of samples",
    ),
    "K1": Claim(
        "The KKT tolerance is zero for linear systems",
        "RHC problem that is linear (yaw alone weighs), random states; below 1e-9 in all",
        _under(
            {place: _on_property("kkt", always, f"`linear_{place}` < 1e-9") for place in _PLACES}
        ),
        "\"Reported\" is each sample's tolerance by ACADO's formula, taken where the iteration "
        'begins: it is zero only where nothing changed. "After the step" is taken at the '
        "iteration's result.",
        paper=0,
        unit="share of states",
    ),
    "K2": Claim(
        "Therefore values that are not zero show that the problem is not linear",
        "the reported tolerance of the linear problem, as in K1, is zero in all states",
        _on_property("kkt", always, "linear_reported < 1e-9"),
    ),
    "K3": Claim(
        "The RHC's largest KKT tolerances arise at the beginning, off track",
        "share of fields where the largest is before arrival; above half",
        _on_logs("rhe", share, "kkt_rhc_largest_first", above=_USUAL),
    ),
    "K4": Claim(
        "The RHC's KKT tolerance decreases until the robot is on track",
        "median after arrival over median before, paired; below 1",
        _on_logs("rhe", ratio, "kkt_rhc_after", "kkt_rhc_before", below=1),
    ),
    "K5": Claim(
        "It cannot decrease further because the references keep changing",
        "median in the second half of a run on constant soil without noise or bumps over the "
        "usual one; at least half",
        _compare("rhe_undisturbed", "rhe", ratio, "kkt_rhc_late", "logs", above=0.5),
        "Without noise the references change just as much.",
    ),
    "K6": Claim(
        "The RHE's KKT tolerance is large at the beginning and then decreases",
        "median over the second half of the run over median of its first 3 s, paired; below 1",
        _on_logs("rhe", ratio, "kkt_rhe_late", "kkt_rhe_first", below=1),
    ),
    "K7": Claim(
        "A single iteration may leave a sub-optimal solution",
        "share of runs where the command is 0.0001 rad/s (RMS) or more from the converged one; "
        "seen at all",
        _on_experiment("iterations", possible, "rms_warm >= 1e-4"),
    ),
    "C1": Claim(
        "The RHE estimates the yaw precisely",
        "RMS error of the yaw; mean at most 2° (0.035 rad)",
        _on_runs("rhe", mean, "rms_yaw_rad", below=0.035),
    ),
    "C2": Claim(
        "… and μ",
        "RMS error of μ; mean below the soil's own deviation of 0.04, which a constant would have",
        _on_runs("rhe", mean, "rms_mu", below=0.04),
    ),
    "C3": Claim(
        "… and κ",
        "RMS error of κ; mean below the soil's own deviation of 0.08, which a constant would have",
        _on_runs("rhe", mean, "rms_kappa", below=0.08),
    ),
    "C4": Claim(
        "Robots will navigate a variety of conditions without damaging the crop",
        "share of fields without a violation by the true position, soil of κ 0.6 ± 0.16, μ 0.8 ± "
        "0.08, at 0.4 m/s; every field",
        _on_runs("rhe_uncertain", always, "violations_true == 0"),
    ),
}


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
        row |= dict(id=id_, section=_SECTION_OF[id_], unit=claim.unit or claim.rule.unit)
        row |= dict(paper=claim.rule.paper if claim.paper is None else claim.paper)
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
