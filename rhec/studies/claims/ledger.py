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

RELIABLE, USUAL = 0.95, 0.5
COLUMNS = (
    "id section claim test paper value low high n unit verdict condition above below other_condition"
    " other_value other_low other_high other_n other_verdict other_above other_below why"
).split()


class Claim(NamedTuple):
    """A claim and how it is judged. rules: {reading: evidence -> Finding}, the reading's evidence
    being {"runs", "logs", "experiments"}.
    """

    id: str
    section: str
    claim: str
    test: str
    rules: dict[str, Callable]
    paper: object = ""
    unit: str = ""
    why: str = ""


def both(rule):
    """The rule under both readings of the process noise; it takes the reading's runs, logs and
    experiments.
    """
    return {
        process_noise: lambda found, process_noise=process_noise: rule(found[process_noise])
        for process_noise in run_sets.READINGS
    }


def once(rule):
    """A rule on what no reading touches."""
    return {"": lambda found: rule(found["printed"])}


def untestable(shown=lambda of: (np.nan, np.nan, np.nan, 0)):
    """What no run here can decide; with our number (ours, low, high, n) where there is one to show."""
    return once(lambda of: Finding(*shown(of), UNTESTABLE))


def on(label, rule):
    """A rule on the metrics of one label's runs."""
    return both(lambda of: rule(of["runs"][label]))


def of_log(label, rule):
    return both(lambda of: rule(of["logs"][label]))


def experiment(name, rule):
    """A rule on an experiment's table, under both readings."""
    return both(lambda of: rule(of["experiments"][name]))


def property_of(name, rule):
    """A rule on an experiment's table that knows no reading."""
    return once(lambda of: rule(of["experiments"][name]))


def by_solver(feedback_shorter):
    """A rule on the times with each QP solver, as readings."""
    return {
        process_noise: lambda found, qp=qp: share(
            _times(found["printed"], qp).eval(feedback_shorter), above=USUAL
        )
        for process_noise, qp in {"condensed QP": "daqp", "stage by stage QP": "structured"}.items()
    }


def between(one, other, rule, kind="runs"):
    """A rule on two labels' runs (or logs), at equal seeds."""

    def paired(of):
        a, b = of[kind][one], of[kind][other]
        n = min(len(a), len(b))
        return rule(a[:n], b[:n])

    return both(paired)


def stays(runs):
    """Runs that reach the path and keep a mean true error below the tolerance."""
    return runs.arrived & (runs.mean_error_true_m < paper.TOLERANCE_M)


def lost(runs):
    """Runs that never reach the path, or are a metre off it later."""
    return ~runs.arrived | (runs.max_error_true_m > 1)


WHY_SOIL = "It is the soil that decides: here μ is 0.9 ± 0.04 and κ 0.8 ± 0.08 on average, the paper's is unknown."
WHY_WHERE = "Speed, path, soil and bumps are not in the paper; the agreement, or its lack, says little about the field."
WHY_GNSS = "Counted by raw GNSS, as in the paper, a violation may be the receiver's alone."

CLAIMS = (
    # Abstract, Introduction
    Claim(
        "I1",
        "Introduction",
        "Rows of 0.78 m leave 0.12 m on either side of the robot",
        "(row - stem - GNSS - width) / 2, to the nearest cm, is the tolerance",
        once(
            lambda of: equal(
                (
                    paper.ROW_SPACING_M
                    - paper.STEM_WIDTH_M
                    - paper.GNSS_ACCURACY_M
                    - paper.ROBOT_WIDTH_M
                )
                / 2,
                paper.TOLERANCE_M,
                0.005,
            )
        ),
        0.12,
        "m",
    ),
    Claim(
        "I2",
        "Introduction",
        "A tolerance of strictly less than 0.12 m is ensured",
        "share of fields where the RHEC's true error never reaches 0.12 m after arrival; ensured: every field",
        on("RHE", lambda runs: always(runs.max_error_true_m < paper.TOLERANCE_M)),
        "all",
        "share of fields",
        "All of the path counts, headlands too, by the true position.",
    ),
    Claim(
        "I3",
        "Introduction",
        "Learning the traction keeps tracking robust where uncertainty is high",
        "true mean error on soil half as sure (κ 0.6 ± 0.16, μ 0.8 ± 0.08, at 0.4 m/s), RHE over EKF, paired; at most half",
        between(
            "RHE, uncertain soil",
            "EKF, uncertain soil",
            lambda rhe, ekf: ratio(rhe.mean_error_true_m, ekf.mean_error_true_m, below=0.5),
        ),
        "",
        "ratio",
    ),
    Claim(
        "I4",
        "Introduction",
        "Linear MPC and PID track poorly off the path and on unknown soil",
        "-",
        untestable(),
        why="Neither is specified in the paper, and none is implemented here; a strawman would prove nothing.",
    ),
    Claim(
        "I5",
        "Introduction",
        "A tube-based MPC stays on track without high accuracy",
        "-",
        untestable(),
        why="Another paper's controller.",
    ),
    # Field robot
    Claim(
        "S1",
        "System",
        "Two batteries drive the robot for over 3 hours",
        "-",
        untestable(),
        why="The simulated robot has no batteries.",
    ),
    Claim(
        "S2",
        "System",
        "With μ = κ = 1 the model is the traditional one, without slip",
        "one step of the model at random states against the unicycle's circle; equal to 0.1 mm or mrad in all",
        property_of("models", lambda cases: always(cases.off_unicycle_m < 1e-4)),
        "all",
        "share of states",
    ),
    Claim(
        "S3",
        "System",
        "f(0, 0, p) = 0 for all p",
        "|f(0, 0, p)| at random p; below 1 nm/s in all",
        property_of("models", lambda cases: always(cases.at_rest_mps < 1e-9)),
        "all",
        "share of states",
        "At ξ = 0, u = 0 the model gives ẋ = μν: the speed is a parameter, so that a robot without input still drives.",
    ),
    Claim(
        "S4",
        "System",
        "Traction must be estimated, or the estimates are biased",
        "|mean yaw error| in the curves, EKF (μ = κ = 1) over RHE, paired; at least twice",
        between(
            "EKF",
            "RHE",
            lambda ekf, rhe: ratio(ekf.yaw_bias_rad.abs(), rhe.yaw_bias_rad.abs(), above=2),
            "logs",
        ),
        "",
        "ratio",
    ),
    # Receding horizon estimation
    Claim(
        "H1",
        "RHE",
        "Parameters taken as random constants become biased where they drift",
        "RMS error of μ, RHE with W = 0 for μ and κ over RHE, paired; above 1",
        between(
            "RHE, constant parameters",
            "RHE",
            lambda fixed, rhe: ratio(fixed.rms_mu, rhe.rms_mu, above=1),
            "logs",
        ),
        "",
        "ratio",
    ),
    Claim(
        "H2",
        "RHE",
        "Large values in W make the estimates vary more",
        "RMS change of κ̂ from sample to sample, RHE over RHE with a tenth of W's μ and κ, paired; above 1",
        between(
            "RHE",
            "RHE, small W",
            lambda rhe, small: ratio(rhe.step_kappa, small.step_kappa, above=1),
            "logs",
        ),
        "",
        "ratio",
    ),
    Claim(
        "H3",
        "Arrival cost",
        "H_N is bounded by the inverse of W",
        "least eigenvalue of P - W in units of W, P the inverse of H_N, over all samples of a run; at least -1e-9 in all runs",
        experiment("arrival cost", lambda runs: always(runs.least >= -1e-9)),
        "all",
        "share of runs",
    ),
    Claim(
        "H4",
        "Arrival cost",
        "A constant, large arrival weight makes the estimates chatter",
        "RMS change of κ̂ from sample to sample, constant weight 100 times the mean one over adaptive, paired; above 1",
        experiment(
            "arrival cost", lambda runs: ratio(runs.step_heavy, runs.step_adaptive, above=1)
        ),
        "",
        "ratio",
        "A large weight holds the estimates to the previous ones: by the paper's own cost function it makes them slow, not lively.",
    ),
    Claim(
        "H5",
        "Arrival cost",
        "A constant, small arrival weight keeps them from the true values for long",
        "time until κ̂ is within 0.1 of κ for 5 s, constant weight of 1/100 of the mean one over adaptive, paired; above 1",
        experiment(
            "arrival cost",
            lambda runs: ratio(runs.reached_s_light, runs.reached_s_adaptive, above=1),
        ),
        "",
        "ratio",
        "A small weight leaves κ̂ to the noise of the window: it comes near the truth and does not stay.",
    ),
    Claim(
        "H6",
        "Arrival cost",
        "The arrival cost is necessary for the stability of the RHE",
        "share of runs whose yaw estimate is more than 0.5 rad off at any time when the arrival cost has no weight; at least half",
        experiment("arrival cost", lambda runs: share(runs.lost_none, above=USUAL)),
        "",
        "share of runs",
        "Bounds on μ and κ and 3 s of positions keep the pose without it.",
    ),
    # Implementation
    Claim(
        "M1",
        "Implementation",
        "Low process noise estimates more accurately",
        "RMS error of κ, RHE with a tenth of W's μ and κ over RHE, paired; below 1",
        between(
            "RHE, small W",
            "RHE",
            lambda small, rhe: ratio(small.rms_kappa, rhe.rms_kappa, below=1),
            "logs",
        ),
        "",
        "ratio",
    ),
    Claim(
        "M2",
        "Implementation",
        "Low process noise makes the estimates lag behind the true values",
        "lag of μ̂ behind μ, RHE with a tenth of W's μ and κ - RHE, paired; above 0",
        between(
            "RHE, small W",
            "RHE",
            lambda small, rhe: difference(small.lag_mu_s, rhe.lag_mu_s, above=0),
            "logs",
        ),
        "",
        "s",
    ),
    Claim(
        "M3",
        "Implementation",
        "W is large for what is measured and small for what is not",
        "the least of W's numbers for x, y, ν exceeds the largest for θ, μ, κ, whatever their units",
        once(
            lambda of: always(
                [
                    min(np.take(paper.SIGMA_W_RHE, [0, 1, 3]))
                    > max(np.take(paper.SIGMA_W_RHE, [2, 4, 5]))
                ]
            )
        ),
        "all",
        "share of cases",
    ),
    Claim(
        "M4",
        "Implementation",
        "The path's yaw rate as input reference may leave a steady error",
        "|mean offset| from the path in the curves, EKF (μ = κ = 1), input reference path's over measured yaw rate, paired; above 1",
        between(
            "EKF, path's yaw rate",
            "EKF",
            lambda path, held: ratio(
                path.offset_curves_m.abs(), held.offset_curves_m.abs(), above=1
            ),
            "logs",
        ),
        "",
        "ratio",
    ),
    Claim(
        "M5",
        "Implementation",
        "R larger than Q keeps the closed loop well damped",
        "overshoot on the first row, R = 0.1 over R = 10, paired; above 1",
        between(
            "Q3, small R",
            "Q3",
            lambda small, large: ratio(small.overshoot_m, large.overshoot_m, above=1),
        ),
        "",
        "ratio",
    ),
    Claim(
        "M6",
        "Implementation",
        "The weight on the horizon's end (Q_N = 10 Q) is critical for stability",
        "share of fields lost on the first row (never arrived, or 1 m off later) with Q_N = 0; at least half",
        on("Q3, no terminal penalty", lambda runs: share(lost(runs), above=USUAL)),
        "",
        "share of fields",
    ),
    Claim(
        "M7",
        "EKF",
        "If an EKF estimates the traction, the estimates may be below zero",
        "share of fields where μ̂ or κ̂ of an augmented EKF is below 0 at any sample, slippery soil (κ 0.5 ± 0.2, μ 0.7 ± 0.15, 0.3 m/s); seen at all",
        of_log("augmented EKF, slippery soil", lambda runs: possible(runs.below_zero)),
        "may",
        "share of fields",
        "The paper has no such filter: W is the RHE's as printed, or by the same likelihood. For the other bound see M8.",
    ),
    Claim(
        "M8",
        "EKF",
        "… and beyond what is physical, that is above one",
        "share of fields where μ̂ or κ̂ of an augmented EKF is above 1 at any sample, on the default soil; seen at all",
        of_log("augmented EKF", lambda runs: possible(runs.above_one)),
        "may",
        "share of fields",
    ),
    Claim(
        "M9",
        "EKF",
        "… which makes the control unstable",
        "share of fields lost on slippery soil, augmented EKF - RHE, paired; above 0",
        between(
            "augmented EKF, slippery soil",
            "RHE, slippery soil",
            lambda ekf, rhe: difference(lost(ekf), lost(rhe), above=0),
            "logs",
        ),
        "",
        "share of fields",
    ),
    Claim(
        "M10",
        "Solution",
        "One iteration gives results similar to iterating to convergence",
        "true mean error, one iteration over ten, paired; within 0.95 to 1.05",
        experiment(
            "iterations",
            lambda runs: ratio(runs.error_one_m, runs.error_many_m, above=0.95, below=1.05),
        ),
        1.0,
        "ratio",
    ),
    Claim(
        "M11",
        "Solution",
        "Starting from the previous solution improves convergence",
        "distance of the first iteration's command from the converged one, warm over cold (previous estimate, nothing planned), paired; below 1",
        experiment("iterations", lambda runs: ratio(runs.rms_warm, runs.rms_cold, below=1)),
        "",
        "ratio",
    ),
    # Scenario A
    Claim(
        "A1",
        "Scenario A",
        "With Q¹ the robot cannot reach the path in reasonable time",
        "share of fields where Q¹ takes more than twice as long as Q³ to stay within 0.12 m; above half",
        between(
            "Q1",
            "Q3",
            lambda one, three: share(one.settling_time_s > 2 * three.settling_time_s, above=USUAL),
        ),
        "cannot",
        "share of fields",
    ),
    Claim(
        "A2",
        "Scenario A",
        "With Q² it oscillates around the path",
        "overshoot on the first row, Q² over Q³, paired; at least 2",
        between("Q2", "Q3", lambda two, three: ratio(two.overshoot_m, three.overshoot_m, above=2)),
        "oscillates",
        "ratio",
    ),
    Claim(
        "A3",
        "Scenario A",
        "With Q³ it reaches the path in reasonable time …",
        "share of fields where Q³ stays within 0.12 m from 15 s on or sooner; at least 95 %",
        on("Q3", lambda runs: share(runs.settling_time_s <= 15, above=RELIABLE)),
        "reaches",
        "share of fields",
    ),
    Claim(
        "A4",
        "Scenario A",
        "… and stays on track",
        "share of fields where the true error stays below 0.12 m to the end of the first row; at least 95 %",
        on(
            "Q3",
            lambda runs: share(
                runs.arrived & (runs.max_error_true_m < paper.TOLERANCE_M), above=RELIABLE
            ),
        ),
        "stays",
        "share of fields",
    ),
    Claim(
        "A5",
        "Scenario A",
        "A fixed forward distance repairs Q²",
        "overshoot on the first row, Q² with 0.5 m look-ahead over Q², paired; at most half",
        between(
            "Q2, look-ahead",
            "Q2",
            lambda ahead, two: ratio(ahead.overshoot_m, two.overshoot_m, below=0.5),
        ),
        "",
        "ratio",
    ),
    Claim(
        "A6",
        "Scenario A",
        "A small R essentially leads to low-gain control",
        "answer of the converged RHC to a small offset, R = 0.1 over R = 10, at random speeds and tractions; below 1",
        property_of("gains", lambda cases: ratio(cases.small_r, cases.large_r, below=1)),
        "",
        "ratio",
        "R weighs the input: a smaller one makes control livelier, in any linear-quadratic problem.",
    ),
    Claim(
        "A7",
        "Scenario A",
        "A large R with the yaw weight tracks better than a small R without",
        "mean error from the start on the first row, Q³ with R = 10 - Q² with R = 0.1, paired; below 0",
        between(
            "Q3",
            "Q2, small R",
            lambda three, two: difference(
                three.mean_error_from_start_m, two.mean_error_from_start_m, below=0
            ),
        ),
        "",
        "m",
    ),
    Claim(
        "A8",
        "Scenario A",
        "… and so it does once on track",
        "true mean error after arrival on the first row, Q³ with R = 10 - Q² with R = 0.1, paired; below 0",
        between(
            "Q3",
            "Q2, small R",
            lambda three, two: difference(three.mean_error_true_m, two.mean_error_true_m, below=0),
        ),
        "",
        "m",
    ),
    # Scenario B
    Claim(
        "B0",
        "Scenario B",
        "Slip makes a time-based reference run far ahead of or behind the robot",
        "time by which the robot trails the set speed at the end of a run of 240 s; mean above the horizon of 3 s",
        of_log("RHE", lambda runs: mean(runs.late_s.abs(), above=3)),
        "large",
        "s",
    ),
    Claim(
        "B1",
        "Scenario B",
        "With the RHE the robot reaches the path and stays on it",
        "share of fields where it arrives and its true mean error is below 0.12 m; at least 95 %",
        on("RHE", lambda runs: share(stays(runs), above=RELIABLE)),
        "stays",
        "share of fields",
    ),
    Claim(
        "B2",
        "Scenario B",
        "With the EKF it does so, too",
        "share of fields where it arrives and its true mean error is below 0.12 m; at least 95 %",
        on("EKF", lambda runs: share(stays(runs), above=RELIABLE)),
        "stays",
        "share of fields",
    ),
    Claim(
        "B3",
        "Scenario B",
        "The RHE's mean Euclidean error is 0.0423 m",
        "the paper's value lies in the middle 95 % of single runs (their interval is given)",
        on("RHE", lambda runs: reported(runs.mean_error_m, paper.MEAN_ERROR_RHE_M)),
        paper.MEAN_ERROR_RHE_M,
        "m",
        WHY_WHERE,
    ),
    Claim(
        "B4",
        "Scenario B",
        "The EKF's mean Euclidean error is 0.0514 m",
        "the paper's value lies in the middle 95 % of single runs (their interval is given)",
        on("EKF", lambda runs: reported(runs.mean_error_m, paper.MEAN_ERROR_EKF_M)),
        paper.MEAN_ERROR_EKF_M,
        "m",
        WHY_WHERE,
    ),
    Claim(
        "B5",
        "Scenario B",
        "The RHE's error is the smaller",
        "mean error by raw GNSS, RHE - EKF, paired; below 0",
        between(
            "RHE", "EKF", lambda rhe, ekf: difference(rhe.mean_error_m, ekf.mean_error_m, below=0)
        ),
        round(paper.MEAN_ERROR_RHE_M - paper.MEAN_ERROR_EKF_M, 4),
        "m",
    ),
    Claim(
        "B6",
        "Scenario B",
        "It benefits from the traction estimates",
        "true mean error, EKF told the true traction - EKF told none, paired; below 0",
        between(
            "traction told",
            "EKF",
            lambda told, ekf: difference(told.mean_error_true_m, ekf.mean_error_true_m, below=0),
        ),
        "",
        "m",
    ),
    Claim(
        "B7",
        "Scenario B",
        "The RHEC does not violate 0.12 m on straight lines",
        "share of fields without a violation by raw GNSS; every field",
        on("RHE", lambda runs: always(runs.violations == 0)),
        "all",
        "share of fields",
        WHY_GNSS,
    ),
    Claim(
        "B8",
        "Scenario B",
        "… by the true position",
        "share of fields without a violation by the true position; every field",
        on("RHE", lambda runs: always(runs.violations_true == 0)),
        "",
        "share of fields",
    ),
    Claim(
        "B9",
        "Scenario B",
        "The EKF violates it 17 times",
        "17 lies in the middle 95 % of single runs (their interval is given)",
        on("EKF", lambda runs: reported(runs.violations, paper.VIOLATIONS_EKF)),
        paper.VIOLATIONS_EKF,
        "samples",
        WHY_WHERE,
    ),
    Claim(
        "B10",
        "Scenario B",
        "The RHEC violates it less often",
        "violations on straights by raw GNSS, RHE - EKF, paired; below 0",
        between("RHE", "EKF", lambda rhe, ekf: difference(rhe.violations, ekf.violations, below=0)),
        -17,
        "samples",
    ),
    Claim(
        "B11",
        "Scenario B",
        "Without an estimate of the yaw, model-based control is impossible",
        "share of fields where yaw by dead reckoning loses the path (never arrived, or 1 m off later); at least 95 %",
        on("yaw not estimated", lambda runs: share(lost(runs), above=RELIABLE)),
        "",
        "share of fields",
    ),
    Claim(
        "B12",
        "Scenario B",
        "The traction estimates stay within 0 and 1",
        "every sample of a run; every run",
        of_log("RHE", lambda runs: always(runs.in_bounds)),
        "all",
        "share of fields",
    ),
    Claim(
        "B13",
        "Scenario B",
        "… and consistently close to the upper bound",
        "share of samples with both estimates at least 0.9; mean at least 95 %",
        of_log("RHE", lambda runs: mean(runs.near_bound, above=RELIABLE)),
        "",
        "share of samples",
        WHY_SOIL,
    ),
    Claim(
        "B14",
        "Scenario B",
        "The estimates stabilise at certain values",
        "standard deviation of κ̂ within the second half of a run; mean at most 0.1",
        of_log("RHE", lambda runs: mean(runs.deviation_kappa_late, below=0.1)),
        "",
        "-",
        WHY_SOIL,
    ),
    Claim(
        "B15",
        "Scenario B",
        "On constant soil, hard-coded traction can track better",
        "true mean error, EKF with the true constants - RHE, on soil of constant traction, paired; below 0",
        between(
            "hard-coded, constant soil",
            "RHE, constant soil",
            lambda hard, rhe: difference(hard.mean_error_true_m, rhe.mean_error_true_m, below=0),
        ),
        "",
        "m",
    ),
    Claim(
        "B16",
        "Scenario B",
        "… but only there: on varying soil estimating is better",
        "true mean error, EKF with the soil's means hard-coded - RHE, on the default soil, paired; above 0",
        between(
            "traction hard-coded",
            "RHE",
            lambda hard, rhe: difference(hard.mean_error_true_m, rhe.mean_error_true_m, above=0),
        ),
        "",
        "m",
    ),
    Claim(
        "B17",
        "Scenario B",
        "The speed is constant",
        "standard deviation over mean of the tracks' speed, from 5 s on; below 5 % in at least 95 % of runs",
        of_log("RHE", lambda runs: share(runs.speed_variation < 0.05, above=RELIABLE)),
        "constant",
        "share of fields",
    ),
    Claim(
        "B18",
        "Scenario B",
        "The RHE copes with noise on the speed",
        "RMS error of the speed, estimated over measured, paired; at most half",
        of_log("RHE", lambda runs: ratio(runs.rms_nu_hat_mps, runs.rms_nu_meas_mps, below=0.5)),
        "",
        "ratio",
        "Below 1 the estimate is the better one. What is left is mostly the tracks' own jitter, which one speed over 3 s cannot follow.",
    ),
    Claim(
        "B19",
        "Scenario B",
        "The RHC's output reaches its bounds",
        "share of fields where it does; at least 95 %",
        of_log("RHE", lambda runs: share(runs.reaches_bound, above=RELIABLE)),
        "reaches",
        "share of fields",
    ),
    Claim(
        "B20",
        "Scenario B",
        "… and never violates them",
        "every sample of a run; every run",
        of_log("RHE", lambda runs: always(runs.within_bound)),
        "all",
        "share of fields",
    ),
    Claim(
        "B21",
        "Scenario B",
        "The low-level controller of the speed is sufficient",
        "RMS distance of the yaw rate from the commanded one; below the 0.0175 rad/s to which the paper measures it in at least 95 % of runs",
        of_log(
            "RHE", lambda runs: share(runs.rms_yaw_rate_radps < paper.SIGMA_V[3], above=RELIABLE)
        ),
        "sufficient",
        "share of fields",
        "The speed loops are this project's own; the distance is what the encoders' noise makes of them.",
    ),
    # Computation times, KKT tolerance
    Claim(
        "T1",
        "Times",
        "RHE and RHC take 0.88 ms on average",
        "-",
        untestable(lambda of: mean(_milliseconds(of))[:4]),
        paper.STEP_MEAN_MS,
        "ms",
        "Another machine: the paper's was a Raspberry Pi 3.",
    ),
    Claim(
        "T2",
        "Times",
        "… and 2.85 ms at worst",
        "-",
        untestable(lambda of: (_milliseconds(of).max(), np.nan, np.nan, len(_milliseconds(of)))),
        paper.STEP_MAX_MS,
        "ms",
        "Another machine, and the worst of some hundred samples.",
    ),
    Claim(
        "T3",
        "Times",
        "The table's parts add up to its totals",
        "preparation + feedback of RHE and RHC, averages; within 0.01 ms of 0.88",
        once(
            lambda of: equal(
                sum(
                    paper.TABLE_1_MS[problem, phase][1]
                    for problem in ("RHE", "RHC")
                    for phase in ("preparation", "feedback")
                ),
                paper.STEP_MEAN_MS,
                0.01,
            )
        ),
        paper.STEP_MEAN_MS,
        "ms",
    ),
    Claim(
        "T4",
        "Times",
        "Feedback is shorter than preparation: RHE",
        "share of samples where it is; above half",
        by_solver("RHE_feedback < RHE_preparation"),
        "0.13 < 0.35 ms",
        "share of samples",
    ),
    Claim(
        "T5",
        "Times",
        "Feedback is shorter than preparation: RHC",
        "share of samples where it is; above half",
        by_solver("RHC_feedback < RHC_preparation"),
        "0.02 < 0.38 ms",
        "share of samples",
        "The paper's ratio is that of ACADO's generated code with qpOASES; which phase is the longer depends on the code.",
    ),
    Claim(
        "T6",
        "Times",
        "One iteration instead of many lessens the computation time",
        "time of a sample, one iteration over ten, paired; at most half",
        experiment("iterations", lambda runs: ratio(runs.one_us, runs.many_us, below=0.5)),
        "",
        "ratio",
    ),
    Claim(
        "T7",
        "Times",
        "The framework is feasible in real time at 5 Hz",
        "share of samples that take less than 0.2 s; every sample",
        once(lambda of: always(_times(of, "structured").sum(axis=1) < 1e6 * paper.DT_S)),
        "all",
        "share of samples",
        "On this machine.",
    ),
    Claim(
        "K1",
        "KKT",
        "The KKT tolerance is zero for linear systems",
        "RHC problem that is linear (yaw alone weighs), random states; below 1e-9 in all",
        {
            where: lambda found, where=where: always(
                found["printed"]["experiments"]["kkt"][f"linear_{where}"] < 1e-9
            )
            for where in ("reported", "after the step")
        },
        0,
        "share of states",
        "\"Reported\" is each sample's tolerance by ACADO's formula, taken where the iteration begins: it is zero only where nothing changed. "
        '"After the step" is taken at the iteration\'s result.',
    ),
    Claim(
        "K2",
        "KKT",
        "Therefore values that are not zero show that the problem is not linear",
        "the reported tolerance of the linear problem, as in K1, is zero in all states",
        property_of("kkt", lambda cases: always(cases.linear_reported < 1e-9)),
        "all",
        "share of states",
    ),
    Claim(
        "K3",
        "KKT",
        "The RHC's largest KKT tolerances arise at the beginning, off track",
        "share of fields where the largest is before arrival; above half",
        of_log("RHE", lambda runs: share(runs.kkt_rhc_largest_first, above=USUAL)),
        "",
        "share of fields",
    ),
    Claim(
        "K4",
        "KKT",
        "The RHC's KKT tolerance decreases until the robot is on track",
        "median after arrival over median before, paired; below 1",
        of_log("RHE", lambda runs: ratio(runs.kkt_rhc_after, runs.kkt_rhc_before, below=1)),
        "",
        "ratio",
    ),
    Claim(
        "K5",
        "KKT",
        "It cannot decrease further because the references keep changing",
        "median in the second half of a run on constant soil without noise or bumps over the usual one; at least half",
        both(lambda of: _floor(of["logs"])),
        "",
        "ratio",
        "Without noise the references change just as much.",
    ),
    Claim(
        "K6",
        "KKT",
        "The RHE's KKT tolerance is large at the beginning and then decreases",
        "median over the second half of the run over median of its first 3 s, paired; below 1",
        of_log("RHE", lambda runs: ratio(runs.kkt_rhe_late, runs.kkt_rhe_first, below=1)),
        "",
        "ratio",
    ),
    Claim(
        "K7",
        "KKT",
        "A single iteration may leave a sub-optimal solution",
        "share of runs where the command is 0.0001 rad/s (RMS) or more from the converged one; seen at all",
        experiment("iterations", lambda runs: possible(runs.rms_warm >= 1e-4)),
        "may",
        "share of runs",
    ),
    # Conclusion
    Claim(
        "C1",
        "Conclusion",
        "The RHE estimates the yaw precisely",
        "RMS error of the yaw; mean at most 2° (0.035 rad)",
        on("RHE", lambda runs: mean(runs.rms_yaw_rad, below=0.035)),
        "",
        "rad",
    ),
    Claim(
        "C2",
        "Conclusion",
        "… and μ",
        "RMS error of μ; mean below the soil's own deviation of 0.04, which a constant would have",
        on("RHE", lambda runs: mean(runs.rms_mu, below=0.04)),
        "",
        "-",
    ),
    Claim(
        "C3",
        "Conclusion",
        "… and κ",
        "RMS error of κ; mean below the soil's own deviation of 0.08, which a constant would have",
        on("RHE", lambda runs: mean(runs.rms_kappa, below=0.08)),
        "",
        "-",
    ),
    Claim(
        "C4",
        "Conclusion",
        "Robots will navigate a variety of conditions without damaging the crop",
        "share of fields without a violation by the true position, soil of κ 0.6 ± 0.16, μ 0.8 ± 0.08, at 0.4 m/s; every field",
        on("RHE, uncertain soil", lambda runs: always(runs.violations_true == 0)),
        "all",
        "share of fields",
    ),
)


def _times(of, qp):
    return of["experiments"]["times"][qp]


def _milliseconds(of):
    """The whole step on this machine, at each sample [ms]."""
    return _times(of, "structured").sum(axis=1) / 1e3


def _floor(logs):
    quiet, usual = logs["RHE, nothing disturbs"], logs["RHE"]
    n = min(len(quiet), len(usual))
    return ratio(quiet.kkt_rhc_late[:n], usual.kkt_rhc_late[:n], above=0.5)


def gathered(seeds):
    """All the evidence, {reading: {"runs", "logs", "experiments"}}, with at most this many fields a
    label.
    """
    parts = dict(
        runs=run_sets.runs(seeds), logs=run_sets.logs(seeds), experiments=experiments.all_of(seeds)
    )
    return {
        process_noise: {name: part[process_noise] for name, part in parts.items()}
        for process_noise in run_sets.READINGS
    }


def ledger(evidence, claims=CLAIMS):
    """The ledger: what the paper says, what was found, and the verdict.

    Args:
        evidence: of `collect_evidence`.
        claims: the claims to judge.

    Returns:
        DataFrame, one row a claim: id, section, claim, test, paper, the Finding under the condition
        that decides (value, low, high, n, unit, verdict, condition, above, below), the one under the
        other condition (other_condition, other_value, …), and why.
    """
    rows = []
    for claim in claims:
        findings = {condition: rule(evidence) for condition, rule in claim.rules.items()}
        said, deciding = combined(findings)
        about = claim._asdict()
        del about["rules"]
        row = about | findings.pop(deciding)._asdict() | dict(verdict=said, condition=deciding)
        for condition, finding in findings.items():
            row["other_condition"] = condition
            row |= {f"other_{name}": value for name, value in finding._asdict().items()}
        rows.append(row)
    table = pd.DataFrame(rows, columns=COLUMNS)
    return table.fillna({"other_condition": "", "other_verdict": ""})


def counts(table):
    """How many claims have each verdict, in the order of the verdicts."""
    kinds = table["verdict"].str.replace(
        f"{HOLDS} under .*", f"{HOLDS} under one reading", regex=True
    )
    return (
        kinds.value_counts()
        .reindex([HOLDS, f"{HOLDS} under one reading", FAILS, UNDECIDED, UNTESTABLE], fill_value=0)
        .rename_axis("verdict")
    )
