"""Audit of the interpretations R1 to R14: what each way to read the paper does to the estimators,
by analysis and by simulation.

Analysis of the EKF: on a straight at constant speed, (y, θ) evolve by themselves, y⁺ = y + T μν θ,
and GNSS measures y. The steady state of their Riccati recursion (SciPy's `solve_discrete_are`)
obeys K_θ = σ_θ / √S, S the variance of the innovation: since S ≥ σ_x², the yaw gain falls as 1/σ_x.
"""

import itertools

import numpy as np
import pandas as pd
from scipy import linalg

from rhec import paper
from rhec.core.estimator.rhe import RHE
from rhec.simulation.closed_loop import simulate
from rhec.simulation.metrics import rms
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.workbench.studies import calibration, statistics
from rhec.workbench.studies.claims import run_sets

__all__ = [
    "INTERPRETATIONS",
    "QUANTITIES",
    "ekf_on_a_straight",
    "likelihood_profile",
    "one_at_a_time",
    "rhe_sigma_kappa",
    "swept",
]


def ekf_on_a_straight(sigma_x_m, sigma_theta_rad=paper.SIGMA_W_EKF[2], pace_mps=0.45):
    """The steady EKF on a straight for each process noise sigma_x_m of the position: a DataFrame of
    its gains on position [-] and yaw [rad/m], its yaw's standard deviation [rad], and the time [s]
    in which it corrects a yaw error to 1/e.
    """
    A = np.array([[1, paper.DT_S * pace_mps], [0, 1]])
    H = np.array([[1.0, 0.0]])
    V = np.array([[paper.SIGMA_V[0] ** 2]])
    rows = []
    for sigma_x in sigma_x_m:
        W = np.diag([sigma_x**2, sigma_theta_rad**2])
        predicted = linalg.solve_discrete_are(A.T, H.T, W, V)
        K = predicted @ H.T / (H @ predicted @ H.T + V)
        corrected = (np.eye(2) - K @ H) @ predicted
        time_s = -paper.DT_S / np.log(np.abs(np.linalg.eigvals((np.eye(2) - K @ H) @ A)).max())
        row = dict(sigma_x_m=sigma_x, gain_position=K[0, 0], gain_yaw_radpm=K[1, 0])
        rows.append(row | dict(sigma_yaw_rad=np.sqrt(corrected[1, 1]), time_s=time_s))
    return pd.DataFrame(rows)


def rhe_sigma_kappa(sigma_kappa, omega_radps, process_noise, samples=300):
    """The RHE's own standard deviation of κ, bounds left aside, after `samples` perfect
    measurements on a circle (or, at ω = 0, on a straight), for each process noise sigma_kappa of κ
    a sample; the rest of W is printed or calibrated.
    """
    nu = paper.SPEED_MPS
    mu = 0.9
    kappa = 0.8
    turned = paper.DT_S * kappa * omega_radps * np.arange(samples)
    chord = paper.DT_S * mu * nu * np.sinc(paper.DT_S * kappa * omega_radps / 2 / np.pi)
    heading = (turned + paper.DT_S * kappa * omega_radps / 2)[:-1]
    x, y = (np.cumsum(np.r_[0, chord * along(heading)]) for along in (np.cos, np.sin))
    z = np.column_stack([x, y, np.full(samples, nu), np.full(samples, omega_radps)])
    found = []
    guess = (0.0, 0.0, 0.0, nu, mu, kappa)
    for sigma in sigma_kappa:
        sigma_w = (*tuning.SIGMA_W["rhe"][process_noise][:5], float(sigma))
        estimator = RHE(sigma_w=sigma_w, guess=guess)
        for measurement in z:
            estimator.prepare()
            estimate = estimator.feedback(measurement)
        found.append(np.sqrt(estimate.covariance[5, 5]))
    return np.array(found)


def _entries(place):
    """Where W holds the standard deviation at this place of (x and y, θ, ν, μ, κ)."""
    return (0, 1) if place == 0 else (place + 1,)


def _with_entry(sigma_w, place, value):
    """W with the standard deviation at this place replaced, x and y moving together."""
    return tuple(value if k in _entries(place) else sigma for k, sigma in enumerate(sigma_w))


def swept(estimator, process_noise, place, values, seeds):
    """Runs with one of W's standard deviations replaced: those of the first seed {value: run}, and
    one row a run with what the sweep changes.

    place: which of (x and y, θ, ν, μ, κ) it is, x and y moving together; errors count from
    `calibration.SETTLED_S` on. κ's are split by straights and curves.
    """
    runs = {}
    rows = []
    for value, seed in itertools.product(values, range(seeds)):
        sigma_w = _with_entry(tuning.SIGMA_W[estimator][process_noise], place, float(value))
        choice = dict(estimator=estimator, process_noise=process_noise, sigma_w=sigma_w)
        run = simulate(Scenario(seed=seed, **choice))
        runs.setdefault(value, run)
        c = run.columns
        settled = c["t_s"] >= calibration.SETTLED_S
        straight = c["on_straight"]
        kappa = c["kappa_hat"] - c["kappa"]
        row = dict(sigma=value, seed=seed)
        row |= dict(rms_yaw_rad=rms((c["theta_hat_rad"] - c["theta_rad"])[settled]))
        row |= dict(rms_kappa_straights=rms(kappa[settled & straight]))
        rows.append(row | dict(rms_kappa_curves=rms(kappa[settled & ~straight])))
    return runs, pd.DataFrame(rows)


def likelihood_profile(estimator, place, factors, seeds=3):
    """How much less likely (in -2 log likelihood a sample) the measurements of the first training
    runs become when one of the calibrated W's standard deviations is multiplied by each factor; x
    and y move together.
    """
    runs = calibration.oracle_runs(calibration.TRAINING_SEEDS[:seeds])
    samples = sum(len(run.columns["t_s"]) for run in runs)
    calibrated = tuning.SIGMA_W[estimator]["calibrated"]
    sigmas = [factor * calibrated[_entries(place)[0]] for factor in factors]
    tried = [_with_entry(calibrated, place, sigma) for sigma in sigmas]
    found = np.array([calibration.deviance(estimator, W, runs) / samples for W in tried])
    return pd.DataFrame(dict(sigma=sigmas, deviance=found - found.min()))


# id: (what it says, fields of the scenario for both estimators, or for RHE and EKF); R11, R12
# and R14 concern what is reported, not what is driven
INTERPRETATIONS = {
    "R3 a": ("speed 0.3 m/s", dict(speed_mps=0.3)),
    "R3 b": ("speed 0.6 m/s", dict(speed_mps=0.6)),
    "R3 c": ("start 2 m off", dict(start_offset_m=2.0)),
    "R3 d": ("headland of 10 m radius", dict(headland_radius_m=10.0)),
    "R4 a": ("GNSS: half of it slow", dict(gnss_slow_share=0.5)),
    "R4 b": ("GNSS: nine tenths slow", dict(gnss_slow_share=0.9)),
    "R5": ("window of N terms", dict(estimation_horizon=14), dict()),
    "R6, R13": ("ν an input, p = (μ, κ)", dict(speed_model="input"), dict()),
    "R7": ("prior mean filtered", dict(arrival_mean="filtered"), dict()),
    "R8": ("path's yaw rate as reference", dict(input_reference="curvature")),
    "R9": ("backwards, λ = 1", dict(backwards=True)),
    "R10": ("command one sample late", dict(command_delay=1)),
}
QUANTITIES = {
    "mean_error_m": "mean error, raw GNSS [m]",
    "mean_error_true_m": "mean error, true [m]",
    "violations": "violations, raw GNSS",
    "rms_kappa": "RMS error of κ [-]",
    "advantage_m": "true error, RHE - EKF [m]",
}


def one_at_a_time(baseline, seeds):
    """How much each interpretation moves the RHE's results from those of the baseline (the process
    noise "printed" or "calibrated"), paired by seed. R1 and R2 are the other W, for one estimator
    at a time.

    Returns:
        DataFrame, one row an interpretation and quantity: value, and its change from the baseline,
        with their 95 % intervals. "advantage_m" is RHE - EKF, both under the interpretation.
    """
    other = "calibrated" if baseline == "printed" else "printed"
    asked = {
        "baseline": ("baseline", dict()),
        "R1": (f"EKF: W {other}", dict(), dict(process_noise=other)),
        "R2": (f"RHE: W {other}", dict(process_noise=other), dict()),
    } | INTERPRETATIONS
    scenarios = {}
    for name, (_, *of_both) in asked.items():
        for estimator, fields in (("rhe", of_both[0]), ("ekf", of_both[-1])):
            given = dict(process_noise=baseline) | fields | dict(estimator=estimator)
            scenarios[name, estimator] = [Scenario(**given, seed=seed) for seed in range(seeds)]
    runs = run_sets.drive(scenarios)
    found = {}
    rows = []
    for name in asked:
        rhe = runs[name, "rhe"]
        ekf = runs[name, "ekf"]
        found[name] = rhe.assign(advantage_m=rhe.mean_error_true_m - ekf.mean_error_true_m)
    usual = found["baseline"]
    found["R14"] = usual.assign(mean_error_m=usual["mean_error_from_start_m"])
    for name, (words, *_) in (asked | {"R14": ("errors from the start",)}).items():
        for column, quantity in QUANTITIES.items():
            value = statistics.mean(found[name][column])
            moved = statistics.difference(found[name][column], usual[column])
            rows.append(
                dict(interpretation=name, words=words, quantity=quantity)
                | dict(value=value.value, low=value.low, high=value.high, change=moved.value)
                | dict(change_low=moved.low, change_high=moved.high, n=moved.n)
            )
    return pd.DataFrame(rows)
