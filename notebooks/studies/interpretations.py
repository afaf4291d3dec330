"""Audit of the interpretations G1 to G18 (docs/interpretations.md): what each way to read the paper
does to the estimators, by analysis and by simulation.

Analysis of the EKF: on a straight at constant speed, (y, θ) evolve by themselves, y⁺ = y + T μν θ,
and GNSS measures y. The steady state of their Riccati recursion (SciPy's `solve_discrete_are`)
obeys K_θ = σ_θ / √S, S the variance of the innovation: since S ≥ σ_x², the yaw gain falls as 1/σ_x.
"""

import numpy as np
import pandas as pd
from scipy import linalg

import rhec
from notebooks.claims import run_sets
from notebooks.studies import statistics
from notebooks.studies.tables import interval_texts, signed
from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning

# Where an estimator's W has a standard deviation that the rules pick differently: of the position,
# and of κ.
_MOVED = {"ekf": 0, "rhe": 5}
_VALUES = 4  # of it in a table, from that as printed to that by prediction
_KAPPA = 0.8  # of a soil on which the tracks slip
_MU = 0.9


# Analysis


def between_the_rules(estimator):
    """Standard deviations from the one in W as printed to that by prediction: of the position in
    the EKF's W, of κ in the RHE's.
    """
    noises = tuning.NOISES[estimator]
    ends = (noises[rule].sigma_w[_MOVED[estimator]] for rule in ("printed", "prediction"))
    return np.geomspace(*ends, _VALUES)


def ekf_on_a_straight(sigma_x_m):
    """The steady EKF of (y, θ) on a straight, for each process noise of the position.

    With A = [1, T v; 0, 1] at the pace v = μν, H = [1, 0], W = diag(σ_x², σ_θ²) and V = σ_GNSS²,
    the predicted covariance P solves the discrete Riccati equation, K = P H' / (H P H' + V), and
    the corrected covariance is (I - K H) P. An error of the yaw decays as the slower eigenvalue λ
    of (I - K H) A, to 1/e in -T / ln |λ|.

    Args:
        sigma_x_m: Standard deviations of the position in W [m].

    Returns:
        DataFrame with columns sigma_x_m, gain_position [-], gain_yaw_radpm, sigma_yaw_rad, time_s.
    """
    A = np.array([[1, paper.DT_S * _MU * paper.SPEED_MPS], [0, 1]])
    H = np.array([[1.0, 0.0]])
    V = np.array([[paper.SIGMA_V[0] ** 2]])
    rows = []
    for sigma_x in sigma_x_m:
        W = np.diag([sigma_x**2, paper.SIGMA_W_EKF[2] ** 2])
        # SciPy's equation is that of control, which is dual: A' for A and H' for B.
        predicted = linalg.solve_discrete_are(A.T, H.T, W, V)
        K = predicted @ H.T / (H @ predicted @ H.T + V)
        corrected = (np.eye(2) - K @ H) @ predicted
        time_s = -paper.DT_S / np.log(np.abs(np.linalg.eigvals((np.eye(2) - K @ H) @ A)).max())
        row = dict(sigma_x_m=sigma_x, gain_position=K[0, 0], gain_yaw_radpm=K[1, 0])
        rows.append(row | dict(sigma_yaw_rad=np.sqrt(corrected[1, 1]), time_s=time_s))
    return pd.DataFrame(rows)


def _circle(omega_radps, samples):
    """Perfect measurements (samples, 4) on a circle, or on a straight where ω is 0.

    Within a sample the robot turns by T κ ω along an arc whose chord is T μν sinc(T κ ω / 2).
    """
    nu = paper.SPEED_MPS
    half_turn = paper.DT_S * _KAPPA * omega_radps / 2
    heading = (paper.DT_S * _KAPPA * omega_radps * np.arange(samples) + half_turn)[:-1]
    chord = paper.DT_S * _MU * nu * np.sinc(half_turn / np.pi)
    x, y = (np.cumsum(np.r_[0, chord * along(heading)]) for along in (np.cos, np.sin))
    return np.column_stack([x, y, np.full(samples, nu), np.full(samples, omega_radps)])


def rhe_sigma_kappa(sigma_kappa, omega_radps, samples=300):
    """The RHE's own standard deviation of κ after perfect measurements, bounds left aside.

    There is one for each process noise sigma_kappa of a sample; the rest of W is as printed.
    The robot drives a circle with the yaw rate omega_radps, or a straight where that is 0.
    """
    z = _circle(omega_radps, samples)
    guess = (0.0, 0.0, 0.0, paper.SPEED_MPS, _MU, _KAPPA)
    deviations = []
    for sigma in sigma_kappa:
        sigma_w = (*paper.SIGMA_W_RHE[:5], float(sigma))
        estimator = rhec.RHE(sigma_w=sigma_w, guess=guess)
        for measurement in z:
            estimator.prepare()
            estimate = estimator.feedback(measurement)
        deviations.append(np.sqrt(estimate.covariance[5, 5]))
    return np.array(deviations)


def sigma_kappa_table(sigma_kappa):
    """`rhe_sigma_kappa` on a straight and in the headland's curve: a DataFrame with columns
    sigma_kappa, straight, curve.
    """
    omega_radps = _MU * paper.SPEED_MPS / paper.HEADLAND_RADIUS_M / _KAPPA
    columns = {
        name: rhe_sigma_kappa(sigma_kappa, omega)
        for name, omega in (("straight", 0.0), ("curve", omega_radps))
    }
    return pd.DataFrame(dict(sigma_kappa=sigma_kappa) | columns)


# One interpretation at a time

# id: (what it says, fields of the scenario for both estimators, or for RHE and EKF); READINGS
# concern what is reported, not what is driven; G11, G12, G15 and G16 are left out
INTERPRETATIONS = {
    "G3 a": ("speed 0.3 m/s", dict(speed_mps=0.3)),
    "G3 b": ("speed 0.6 m/s", dict(speed_mps=0.6)),
    "G3 c": ("start 2 m off", dict(start_offset_m=2.0)),
    "G3 d": ("headland of 10 m radius", dict(headland_radius_m=10.0)),
    "G4": ("GNSS: nine tenths slow", dict(gnss_slow_share=0.9)),
    "G5": ("window of N terms", dict(estimation_horizon=14), dict()),
    "G6, G13": ("ν an input, p = (μ, κ)", dict(speed_model="input"), dict()),
    "G7": ("prior mean smoothed", dict(arrival_mean="smoothed"), dict()),
    "G8": ("path's yaw rate as reference", dict(input_reference="curvature")),
    "G9": ("backwards, λ = 1", dict(backwards=True)),
    "G10": ("command one sample late", dict(command_delay=1)),
    "G18 a": ("turns to the left only", dict(turns="left")),
    "G18 b": ("turns to the right only", dict(turns="right")),
    "G18 c": ("a figure of eight", dict(turns="figure_of_eight")),
}
# id: (what it says, {quantity: what is reported in its place}), of the same drives
READINGS = {"G14": ("errors from the start", dict(mean_error_m="mean_error_from_start_m"))}
QUANTITIES = {
    "mean_error_m": "mean error, raw GNSS [m]",
    "mean_error_true_m": "mean error, true [m]",
    "violations": "violations, raw GNSS",
    "rms_kappa": "RMS error of κ [-]",
    "advantage_m": "true error, RHE - EKF [m]",
}


def _scenarios(baseline, seeds, interpretations):
    """{(interpretation, estimator): scenarios, one a seed}."""
    scenarios = {}
    for name, (_, *of_both) in interpretations.items():
        for estimator, fields in (("rhe", of_both[0]), ("ekf", of_both[-1])):
            choice = dict(process_noise=baseline) | fields | dict(estimator=estimator)
            scenarios[name, estimator] = [Scenario(**choice, seed=seed) for seed in range(seeds)]
    return scenarios


def one_at_a_time(baseline, seeds, folder=None):
    """How much each interpretation moves the RHE's results from the baseline's, paired by seed.

    G1 and G2 are the other W, for one estimator at a time.

    Args:
        baseline: Its process noise, "printed" or "prediction".
        seeds: How many fields, from seed 0 on.
        folder: Where the campaign keeps its rows.

    Returns:
        DataFrame, one row an interpretation and quantity: value, and its change from the baseline,
        with their 95 % intervals. "advantage_m" is RHE - EKF, both under the interpretation.
    """
    other = "prediction" if baseline == "printed" else "printed"
    interpretations = {
        "baseline": ("baseline", dict()),
        "G1": (f"EKF: W {other}", dict(), dict(process_noise=other)),
        "G2": (f"RHE: W {other}", dict(process_noise=other), dict()),
    } | INTERPRETATIONS
    runs = run_sets.drive(_scenarios(baseline, seeds, interpretations), folder)
    results = {}
    for name in interpretations:
        rhe = runs[name, "rhe"]
        advantage_m = rhe.mean_error_true_m - runs[name, "ekf"].mean_error_true_m
        results[name] = rhe.assign(advantage_m=advantage_m)
    usual = results["baseline"]
    for name, (_, instead) in READINGS.items():
        results[name] = usual.assign(**{of: usual[column] for of, column in instead.items()})
    rows = []
    for name, (words, *_) in (interpretations | READINGS).items():
        for column, quantity in QUANTITIES.items():
            least = -np.inf if column == "advantage_m" else 0.0
            value = statistics.over_seeds(np.mean, results[name][column], least=least)
            moved = statistics.difference(results[name][column], usual[column])
            rows.append(
                dict(interpretation=name, words=words, quantity=quantity)
                | dict(value=value.mean, low=value.low, high=value.high, change=moved.value)
                | dict(change_low=moved.low, change_high=moved.high, n=moved.n)
            )
    return pd.DataFrame(rows)


def readable_changes(table):
    """The table of `one_at_a_time` for readers: "+0.0034 [+0.0021, +0.0047]" in each cell.

    The baseline's row has its values, all others their changes from it.
    """
    values = interval_texts(table, "value")
    changes = interval_texts(table, "change", "change_low", "change_high", signed)
    cells = values.where(table["interpretation"] == "baseline", changes)
    names = ["interpretation", "words"]
    return table.assign(cell=cells).pivot_table(
        "cell", index=names, columns="quantity", aggfunc="first", sort=False
    )
