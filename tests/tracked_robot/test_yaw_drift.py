"""The yaw drift as one more state: a robot that turns on a straight, θ' = κω + μνδ."""

import numpy as np
import pytest
from helpers import answers_of, choice_of, weaving_yaw_rates, with_noise
from oracles import DT, V, drive, flat

import rhec
from notebooks.rivals import RIVALS
from rhec.tracked_robot.kinematics import QUANTITIES

HORIZON = 8
TRUTH = dict(zip(QUANTITIES, (1.0, 2.0, 0.4, 0.5, 0.9, 0.75)))
SIGMA_W = (0.01, 0.01, 0.01, 0.01, 0.003, 0.005, 0.002)
pytestmark = pytest.mark.usefixtures("virtual_machine")


def drifting_drive(omegas, delta):
    """Truth (n+1, 6) and readings (n+1, 4) of a robot with the yaw drift δ.

    With constant p, the drift acts as the yaw rate μνδ/κ of the tracks that no encoder measures.
    """
    nu, mu, kappa = (TRUTH[name] for name in ("nu_mps", "mu", "kappa"))
    truth, z = drive([*TRUTH.values()], omegas + mu * nu * delta / kappa)
    z[1:, 3] = omegas
    return truth, z


def estimates(choice, z, sigma, sigma_w=SIGMA_W, **told):
    """Estimates (n, 6), and yaw drifts (n,) where the estimator has them."""
    settings = dict(V=V, W=np.square(sigma_w), P_0=np.ones(len(sigma_w)))
    answers = answers_of(choice, z, TRUTH, *sigma, m_0=np.zeros(len(sigma_w)), **settings, **told)
    drifts = [float(of.get("yaw_drift", 0.0)) for of in answers]
    return np.array([flat(of["estimate"]) for of in answers]), np.array(drifts)


def choice_of_filtered(name, yaw_drift=False):
    return choice_of(name, HORIZON, arrival_mean="filtered")._replace(yaw_drift=yaw_drift)


# Estimators of the yaw drift, and what each is without it.
WITH_AND_WITHOUT = [
    (choice_of_filtered(RIVALS["yaw_drift_ekf"]), choice_of_filtered("bounded_ekf")),
    (choice_of_filtered("rhe", yaw_drift=True), choice_of_filtered("rhe")),
]


@pytest.mark.parametrize("drifting, plain", WITH_AND_WITHOUT, ids=["EKF", "RHE"])
def test_without_uncertainty_of_the_drift_it_is_the_estimator_without(drifting, plain):
    """A drift known to be 0 changes nothing, to rounding."""
    _, z = drifting_drive(weaving_yaw_rates(60), 0.0)
    z = with_noise(z)
    known = dict.fromkeys(QUANTITIES, 0.1)
    sure = known | dict(yaw_drift_radpm=1e-9)
    found, drifts = estimates(drifting, z, [sure], (*SIGMA_W[:6], 0.0))
    expected, _ = estimates(plain, z, [known], SIGMA_W[:6])
    np.testing.assert_allclose(found, expected, atol=1e-7)
    np.testing.assert_allclose(drifts, 0, atol=1e-7)


def test_the_oracle_is_passed_the_drift():
    """Without noise it stays on the truth, and the traction oracle does not."""
    truth, z = drifting_drive(weaving_yaw_rates(60), 0.1)
    told = dict(traction=[TRUTH["mu"], TRUTH["kappa"]], yaw_drift=0.1)
    (knowing, drifts), (other, _) = (
        estimates(choice_of_filtered(RIVALS[name]), z, (), SIGMA_W[:4], **told)
        for name in ("drift_oracle", "traction_oracle")
    )
    np.testing.assert_allclose(knowing, truth, atol=1e-5)
    assert (drifts == 0.1).all()
    assert np.abs(other - truth)[-20:, 2].mean() > 0.01


# In the closed loop


def test_the_live_controller_plans_with_a_disturbance_and_takes_it_off():
    """Its plan begins with the command, within its bounds, and is as if there never was one."""
    bound = 0.05
    ahead_m = 0.5 * 0.9 * DT * np.arange(HORIZON + 1)
    references = np.outer([1.0, 0.0, 0.0], ahead_m), np.zeros(HORIZON)
    beside = np.array([0.0, 1.0, 0.5]), np.array([0.5, 0.9, 0.8])
    disturbed, fresh = (rhec.RHC(horizon=HORIZON, omega_max=bound) for _ in range(2))
    for d in (0.02, -0.02):
        command = disturbed.solve(*beside, *references, disturbance=d)
        assert command == disturbed.omega_plan[0] == pytest.approx(-bound, abs=1e-9)
        assert (np.abs(disturbed.omega_plan) <= bound + 1e-9).all()
    # The tracks turn by ω, and the soil as if they turned by d besides.
    turned = np.diff(disturbed.xi_plan[2]) / DT
    np.testing.assert_allclose(turned, 0.8 * (disturbed.omega_plan + d), atol=1e-6)
    again = disturbed.solve(*beside, *references)
    assert again == pytest.approx(fresh.solve(*beside, *references), abs=1e-9)
    np.testing.assert_allclose(disturbed.omega_plan, fresh.omega_plan, atol=1e-6)


# Soil that turns the robot by a constant amount; a quiet robot, so that nothing else does.
SLIPPING_ASIDE = dict(
    duration_s=60.0,
    mu_deviation=0.0,
    kappa_deviation=0.0,
    soil_under="tracks",
    slip_difference=0.02,
    gnss_sigma_m=0.003,
    bump_sigma_radps=0.0,
    start_offset_m=0.2,
    process_noise="prediction",
    seed=1,
)


def mean_error_m(**fields):
    run = rhec.simulate(rhec.Scenario(**SLIPPING_ASIDE | fields))
    assert run.metrics["solver_ok"]
    return run.metrics["mean_error_true_m"]


# What estimates the drift, beside what does not.
PAIRS = [
    (dict(yaw_drift=True), {}),
    (dict(estimator=RIVALS["yaw_drift_ekf"]), dict(estimator="bounded_ekf")),
]


@pytest.mark.parametrize("drifting, plain", PAIRS, ids=["RHE", "EKF"])
def test_the_controller_cancels_the_drift(drifting, plain):
    """A standing offset to the path without it is gone with it."""
    assert mean_error_m(**drifting) < 0.4 * mean_error_m(**plain)


@pytest.mark.parametrize(
    "drift, disturbance",
    [(0.1, 0.1 * 0.5 * 0.9 / 0.75), (9, 0.1), (-9, -0.1), (np.nan, 0), (np.inf, 0), (None, 0)],
)
def test_a_disturbance_takes_at_most_half_of_the_bound_of_the_yaw_rate(drift, disturbance):
    """d = μνδ/κ within ±ω_max/2, so that the rest is left for steering."""
    estimate = rhec.RHE(horizon=2).step((0.0, 0.0, 0.5, 0.0))
    estimate = estimate._replace(nu=0.5, mu=0.9, kappa=0.75, yaw_drift=drift)
    found = rhec.RHC(horizon=2, omega_max=0.2).disturbance(estimate)
    assert found == pytest.approx(disturbance, abs=1e-12)


@pytest.mark.parametrize("speed_model", ["parameter", "input", "slipping"])
def test_an_estimate_is_shown_with_the_deviations_that_its_covariance_has(speed_model):
    """Each quantity with that of its own, and none where it has none."""
    rhe = rhec.RHE(horizon=2, speed_model=speed_model, yaw_drift=speed_model != "slipping")
    estimate = rhe.step((1.0, 2.0, 0.5, 0.1))
    names = [name for name in rhe.model.joint_names if name not in rhe.model.inputs]
    sigma = dict(zip(names, np.sqrt(np.diag(estimate.covariance))))
    values = dict(zip((*QUANTITIES, "yaw_drift_radpm"), [*estimate[:6], estimate.yaw_drift]))
    expected = [
        f"{name}: {value:.4g}" + (f" ± {sigma[name]:.2g}" if name in sigma else "")
        for name, value in values.items()
        if value is not None
    ]
    assert repr(estimate).split("\n    ")[1:] == expected


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("d", [0.02, -0.02])
def test_an_rhe_and_a_replay_find_the_drift_that_the_soil_has(d):
    """δ = (μ_r - μ_l) / (b μ), with μ_l = μ (1 - d/2) and μ_r = μ (1 + d/2): δ = d / b."""
    scenario = rhec.Scenario(**SLIPPING_ASIDE | dict(slip_difference=d, yaw_drift=True))
    log = rhec.simulate(scenario).log
    expected = d / scenario.track_width_m
    assert log["yaw_drift_radpm"].mean() == pytest.approx(expected, rel=1e-9)
    assert log["yaw_drift_hat_radpm"].tail(100).mean() == pytest.approx(expected, rel=0.1)
    how = dict(speed_model="input", yaw_drift=True, process_noise="prediction", first_yaw_rad=0.0)
    for smooth in (False, True):
        replayed = rhec.replay(log, smooth=smooth, **how).tail(50)
        assert replayed["yaw_drift_hat_radpm"].mean() == pytest.approx(expected, abs=0.01)
        assert (replayed["sigma_yaw_drift_radpm"] < 0.025).all()
