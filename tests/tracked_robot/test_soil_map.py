"""The map of the soil: what a drive tells, the Gaussian process of several, the EKF with a map."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats

import rhec
from rhec.tracked_robot import soil_field, soil_pass
from rhec.tracked_robot.soil_field import Statistics
from rhec.tracked_robot.soil_pass import Evidence
from rhec.workbench.studies.calibration import run_estimator

DT_S = 0.2
SIGMA_V = (0.03, 0.03, 0.05, 0.0175)
SIGMA_W = (0.001, 0.001, 0.005, 0.002)
SOIL = Statistics(sigma_mu=0.04, sigma_kappa=0.08, length_m=4.0, track_share=0.7)
# Small horizons compile faster.
SMALL = rhec.Scenario(
    **rhec.WORLDS["former"], estimation_horizon=3, prediction_horizon=3, duration_s=120.0, seed=1001
)


@pytest.fixture(scope="module")
def drive():
    return rhec.simulate(dataclasses.replace(SMALL, estimator="bounded_ekf"))


@pytest.fixture(scope="module")
def known(drive):
    return rhec.SoilMap.from_runs([drive])


# What one drive tells


def residuals(u, z, nodes_m, n_nodes):
    """Weighted residuals of a drive, written anew from the equations of `soil_pass`."""
    n = len(z)
    x, y, theta, nu = u[: 4 * n].reshape(n, 4).T
    fields = u[4 * n :].reshape(3, n_nodes)
    run = np.cumsum(np.abs(z[:, 2])) * DT_S / nodes_m
    mu, kappa, g = (np.interp(run, np.arange(n_nodes), field) for field in fields)
    parts = [(x - z[:, 0]) / 0.03, (y - z[:, 1]) / 0.03, (nu - z[:, 2]) / 0.05]
    for k in range(n - 1):
        turn = DT_S * (kappa[k + 1] * z[k + 1, 3] + g[k + 1] * nu[k + 1])
        way = DT_S * mu[k + 1] * nu[k + 1]
        middle = theta[k] + turn / 2
        parts.append(
            [
                (x[k + 1] - x[k] - way * np.cos(middle)) / 0.001,
                (y[k + 1] - y[k] - way * np.sin(middle)) / 0.001,
                (theta[k + 1] - theta[k] - turn) / 0.005,
                (nu[k + 1] - nu[k]) / 0.002,
            ]
        )
    return np.concatenate(parts)


def short_drive(n=24):
    """Measurements (n, 4) of a drive in a curve, and the poses about it."""
    rng = np.random.default_rng(5)
    t = np.arange(n) * DT_S
    theta = 0.3 * t + 0.1 * np.sin(t)
    x, y = np.cumsum([0.1 * np.cos(theta), 0.1 * np.sin(theta)], axis=1)
    noise = rng.standard_normal((n, 4)) * (0.03, 0.03, 0.02, 0.01)
    z = np.column_stack([x, y, np.full(n, 0.55), 0.35 + 0.1 * np.cos(t)]) + noise
    return z, np.column_stack([x, y, theta, np.full(n, 0.55)])


def test_the_evidence_of_a_drive_is_that_of_a_dense_least_squares_fit(monkeypatch):
    monkeypatch.setattr(soil_pass, "_ITERATIONS", 20)
    z, first = short_drive()
    evidence = soil_pass.evidence_of(z, first, SIGMA_V, SIGMA_W, DT_S, nodes_m=1.0)
    m = len(evidence.place_m)
    # The weak prior of the iteration decides where it ends, so the fit has it as well.
    mean, sigma = np.repeat(soil_pass._WEAK, m, axis=0).T
    fit = optimize.least_squares(
        lambda u: np.concatenate([residuals(u, z, 1.0, m), (u[first.size :] - mean) / sigma]),
        np.concatenate([first.ravel(), mean]),
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    J = fit.jac[: -3 * m]
    by_poses, by_soil = J[:, : first.size], J[:, first.size :]
    seen, *_ = np.linalg.lstsq(by_poses, by_soil)
    information = by_soil.T @ (by_soil - by_poses @ seen)
    np.testing.assert_allclose(evidence.information, information, atol=1e-4 * information.max())
    posterior = np.linalg.solve(
        evidence.information + np.diag(sigma**-2.0), evidence.score + mean / sigma**2
    )
    np.testing.assert_allclose(posterior, fit.x[first.size :], atol=1e-4)


def test_missing_measurements_only_take_knowledge_away():
    z, first = short_drive()
    whole = soil_pass.evidence_of(z, first, SIGMA_V, SIGMA_W, DT_S, nodes_m=1.0)
    z[5:9, :2] = np.nan
    z[12, 2] = np.inf
    part = soil_pass.evidence_of(z, first, SIGMA_V, SIGMA_W, DT_S, nodes_m=1.0)
    assert np.isfinite(part.information).all()
    assert np.trace(part.information) < np.trace(whole.information)


# Several drives


def k(one, other, sigma):
    """Covariance of one field between places, by its definition, with the unknown mean's."""
    r = np.linalg.norm(one[:, None] - other[None], axis=2)
    return 0.2**2 + sigma**2 * np.exp(-np.pi / 4 * (r / SOIL.length_m) ** 2)


def scattered(n=7):
    """Places (n, 2), headings (n,), and what was seen of (μ, κ, g) there with its σ, (3, n)."""
    rng = np.random.default_rng(3)
    place_m = rng.uniform(0, 8, (n, 2))
    seen = np.array([[0.9], [0.8], [0.0]]) + rng.standard_normal((3, n)) * [[0.04], [0.08], [0.01]]
    sigma = rng.uniform(0.5, 2, (3, n)) * [[0.02], [0.05], [0.01]]
    return place_m, rng.uniform(-np.pi, np.pi, n), seen, sigma


def evidence_of(place_m, heading_rad, seen, sigma):
    information = np.diag(sigma.ravel() ** -2)
    return Evidence(place_m, heading_rad, information, information @ seen.ravel())


def dense_prior(place_m, heading_rad):
    """Mean and covariance of (μ, κ, g), the slopes by finite differences of k."""
    h = 1e-3
    left = h * np.column_stack([-np.sin(heading_rad), np.cos(heading_rad)])
    n = len(place_m)
    # μ at the places and at both sides of them, of which g is a difference.
    points = np.concatenate([place_m, place_m + left, place_m - left])
    covariance = k(points, points, SOIL.sigma_mu)
    g = np.hstack([np.zeros((n, n)), -np.eye(n), np.eye(n)]) * SOIL.track_share / (2 * h)
    of_mu = np.vstack([np.eye(n, 3 * n), g])
    of_mu = of_mu @ covariance @ of_mu.T
    K = np.zeros((3 * n, 3 * n))
    K[np.ix_([*range(n), *range(2 * n, 3 * n)], [*range(n), *range(2 * n, 3 * n)])] = of_mu
    K[n : 2 * n, n : 2 * n] = k(place_m, place_m, SOIL.sigma_kappa)
    K[2 * n :, 2 * n :] += 0.1**2 + 0.002**2 * np.eye(n)
    return np.repeat([0.85, 0.85, 0.0], n), K


def test_the_map_is_a_textbook_gaussian_process():
    place_m, heading_rad, seen, sigma = scattered()
    evidence = evidence_of(place_m, heading_rad, seen, sigma)
    n = len(place_m)
    m, K = dense_prior(place_m, heading_rad)
    S = K + np.diag(sigma.ravel() ** 2)
    # The places themselves: the joint posterior of the dense process.
    mean = m + K @ np.linalg.solve(S, seen.ravel() - m)
    variance = np.diag(K - K @ np.linalg.solve(S, K))
    field = soil_field.posterior(evidence, SOIL, place_m)
    np.testing.assert_allclose(field.mean[:2].ravel(), mean[: 2 * n], atol=1e-6)
    np.testing.assert_allclose(field.variance[:2].ravel(), variance[: 2 * n], rtol=1e-4)
    # g is made of the slopes and what is constant, but for what changes from node to node.
    g = field.mean[2] * np.sin(heading_rad) - field.mean[3] * np.cos(heading_rad)
    own = 0.002**2 * np.linalg.solve(S, seen.ravel() - m)[2 * n :]
    np.testing.assert_allclose(g + field.constant_yaw[0], mean[2 * n :] - own, atol=1e-6)


def test_the_likelihood_is_that_of_the_dense_process():
    place_m, heading_rad, seen, sigma = scattered()
    evidence = evidence_of(place_m, heading_rad, seen, sigma)
    nothing = SOIL._replace(sigma_mu=1e-9, sigma_kappa=1e-9)
    difference = soil_field.log_likelihood(evidence, SOIL)
    difference -= soil_field.log_likelihood(evidence, nothing)
    expected = []
    for spread in (1.0, 0.0):
        m, K = dense_prior(place_m, heading_rad)
        n = len(place_m)
        if not spread:
            K = np.kron(np.diag([0.2**2, 0.2**2, 0.1**2]), np.ones((n, n)))
            K[2 * n :, 2 * n :] += 0.002**2 * np.eye(n)
        S = K + np.diag(sigma.ravel() ** 2)
        expected.append(stats.multivariate_normal(m, S).logpdf(seen.ravel()))
    assert difference == pytest.approx(expected[0] - expected[1], abs=1e-3)


def test_two_drives_are_added_up():
    place_m, heading_rad, seen, sigma = scattered(8)
    halves = [
        evidence_of(place_m[part], heading_rad[part], seen[:, part], sigma[:, part])
        for part in (slice(0, 3), slice(3, 8))
    ]
    whole = soil_field.posterior(evidence_of(place_m, heading_rad, seen, sigma), SOIL, place_m)
    merged = soil_field.posterior(soil_field.merged(halves), SOIL, place_m)
    np.testing.assert_allclose(merged.mean, whole.mean, atol=1e-9)
    np.testing.assert_allclose(merged.variance, whole.variance, atol=1e-9)


def test_far_from_all_drives_the_map_is_the_prior(known):
    far = np.array([[1e4, 1e4]])
    field = soil_field.posterior(known.evidence, known.statistics, far)
    # The mean of the fields is known from the drive, the field itself is not.
    assert np.sqrt(field.variance[0, 0]) > 0.99 * known.statistics.sigma_mu
    assert field.mean[2:, 0] == pytest.approx([0, 0], abs=1e-12)
    assert np.all(known.sigma_mu <= np.sqrt(field.variance[0, 0]) + 1e-9)


def test_a_map_of_no_drive_knows_nothing():
    nothing = rhec.SoilMap.from_runs([])
    assert np.ptp(nothing.mu) == 0 and nothing.sigma_mu.min() > 0.3
    assert nothing.evidence is None


def test_a_map_is_near_the_soil_that_it_was_made_on(drive, known):
    """Within three of its own standard deviations, and nearer than the field's mean."""
    soil = drive.terrain
    i, j = (np.round((known.evidence.place_m - soil.origin_m) / soil.cell_m).astype(int)).T
    a, b = (np.round((known.evidence.place_m - known.origin_m) / known.cell_m).astype(int)).T
    errors = known.mu[a, b] - soil.mu[i, j]
    assert np.sqrt(np.mean(errors**2)) < 0.6 * soil.mu[i, j].std()
    assert np.mean(np.abs(errors) < 3 * np.maximum(known.sigma_mu[a, b], 0.005)) > 0.95


def test_a_second_drive_makes_the_map_surer(drive, known):
    more = known.update(drive)
    assert len(more.evidence.place_m) == 2 * len(known.evidence.place_m)
    assert np.median(more.sigma_mu) < np.median(known.sigma_mu)


# The estimator


def test_a_map_that_knows_nothing_is_as_good_as_none(drive):
    """The same walk on a grid of its own gives the same estimates."""
    scenario = dataclasses.replace(SMALL, estimator="map_ekf")
    nothing = rhec.SoilMap.from_runs([])
    wide = {
        name: np.full((40, 30), getattr(nothing, name)[0, 0])
        for name in ("mu", "kappa", "sigma_mu", "sigma_kappa")
    }
    same = rhec.SoilMap(
        **wide, origin_m=(-9.0, -7.0), cell_m=1.0, length_m=nothing.length_m,
        constant_yaw=nothing.constant_yaw,
    )  # fmt: skip
    plain = run_estimator(scenario, drive, "estimate")["estimate"]
    told = run_estimator(dataclasses.replace(scenario, soil_map=same), drive, "estimate")
    np.testing.assert_allclose(told["estimate"], plain, atol=1e-9)


def test_without_a_map_and_drift_it_is_nearly_the_bounded_ekf(drive):
    """Both are random walks of the traction with the noise that is the likeliest."""
    bounded = dataclasses.replace(SMALL, estimator="bounded_ekf", process_noise="calibrated")
    plain = run_estimator(dataclasses.replace(SMALL, estimator="map_ekf"), drive, "estimate")
    # On the headland, where κ can be seen.
    settled = slice(450, None)
    expected = run_estimator(bounded, drive, "estimate")["estimate"][settled]
    difference = np.abs(plain["estimate"][settled] - expected)
    assert difference[:, :2].max() < 0.005
    assert difference[:, 4:].mean(axis=0) == pytest.approx([0, 0], abs=0.02)


def test_a_sure_map_is_believed_and_a_wrong_one_is_outvoted(drive, known):
    """With σ → 0 the estimate is the map's; with a wide σ a wrong map does little harm."""
    scenario = dataclasses.replace(SMALL, estimator="map_ekf")
    grid = np.ones((2, 2))
    place = dict(origin_m=(0.0, 0.0), cell_m=1.0)
    sure = rhec.SoilMap(0.7 * grid, 0.6 * grid, 0 * grid, 0 * grid, **place, length_m=4.0)
    unsure = rhec.SoilMap(0.7 * grid, 0.6 * grid, grid, grid, **place, length_m=200.0)
    believed, outvoted = (
        run_estimator(dataclasses.replace(scenario, soil_map=one), drive, "estimate")["estimate"]
        for one in (sure, unsure)
    )
    true = drive.columns["mu"]
    assert true.mean() > 0.85
    # No map is surer than 0.005 of μ.
    assert believed[:, 4].mean() == pytest.approx(0.7, abs=0.05)
    assert np.abs(outvoted[100:, 4] - true[100:]).mean() < 0.1


def test_the_loop_with_a_map_has_the_bits_of_its_own_estimates(drive, known):
    """Fused in the loop or run over its measurements, the estimator is the same."""
    scenario = dataclasses.replace(SMALL, estimator="map_ekf", soil_map=known)
    run = rhec.simulate(dataclasses.replace(scenario, terrain=drive.terrain))
    alone = run_estimator(scenario, run, "estimate")["estimate"]
    fused = np.column_stack([run.columns[name] for name in ("x_hat_m", "mu_hat", "kappa_hat")])
    np.testing.assert_allclose(alone[:, [0, 4, 5]], fused, atol=1e-9)
    assert run.metrics["all_ok"]


# Files and errors


def test_a_saved_map_goes_on_learning(tmp_path, drive, known):
    file = tmp_path / "map.npz"
    known.save(file)
    loaded = rhec.SoilMap.load(file)
    assert repr(loaded) == repr(known)
    np.testing.assert_array_equal(loaded.update(drive).mu, known.update(drive).mu)
    rhec.SoilMap.from_runs([]).save(file)
    assert rhec.SoilMap.load(file).evidence is None


def test_another_file_is_refused_in_one_sentence(tmp_path):
    file = tmp_path / "other.npz"
    np.savez(file, mu=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match=r"other\.npz.*SoilMap\.save"):
        rhec.SoilMap.load(file)
    with pytest.raises(FileNotFoundError):
        rhec.SoilMap.load(tmp_path / "none.npz")


GRID = np.full((3, 3), 0.8)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (dict(mu=np.ones(3)), "mu had shape"),
        (dict(sigma_mu=-GRID), "sigma_mu ranged from -0.8"),
        (dict(kappa=np.nan * GRID), "kappa ranged from nan"),
        (dict(sigma_kappa=np.ones((2, 3))), "sigma_kappa had shape"),
        (dict(cell_m=0.0), "cell_m was 0.0"),
        (dict(origin_m=(0.0,)), "origin_m was"),
        (dict(length_m=np.inf), "length_m was inf"),
    ],
)
def test_an_impossible_map_is_refused_in_one_sentence(fields, message):
    place = dict(origin_m=(0.0, 0.0), cell_m=1.0, length_m=4.0)
    good = dict(mu=GRID, kappa=GRID, sigma_mu=GRID, sigma_kappa=GRID) | place
    with pytest.raises(ValueError, match=message) as error:
        rhec.SoilMap(**good | fields)
    assert "\n" not in str(error.value)


def test_what_is_no_run_or_no_map_is_refused(known):
    for wrong in (3, "log.csv", dict(x=1)):
        with pytest.raises(ValueError, match="runs was"):
            rhec.SoilMap.from_runs(wrong)
    with pytest.raises(ValueError, match=r"run was.*rhec\.Run"):
        rhec.SoilMap.from_runs([1.0])
    with pytest.raises(ValueError, match="soil_map was"):
        rhec.Scenario(estimator="map_ekf", soil_map=GRID)
    with pytest.raises(ValueError, match="only 'map_ekf' uses a map"):
        rhec.Scenario(soil_map=known)


def test_a_map_is_neither_exported_nor_replayed(tmp_path, drive, known):
    """The exported controller does not cancel its yaw drift, and a replay takes no map."""
    with pytest.raises(ValueError, match="estimator was 'map_ekf', whose yaw drift"):
        rhec.export(rhec.Scenario(estimator="map_ekf", soil_map=known), tmp_path / "robot")
    log = pd.DataFrame(drive.columns)
    with pytest.raises(ValueError, match="replay has no parameter 'soil_map'"):
        rhec.replay(log, estimator="map_ekf", soil_map=known)
    assert rhec.replay(log, estimator="map_ekf")["x_hat_m"].notna().any()
