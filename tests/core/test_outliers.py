"""A wrong position must not cost an RHE of a Model more than the EKF of the same data."""

import functools

import casadi as ca
import numpy as np
import pytest

import rhec

DT_S = 0.2
BAD = 60  # the sample with a wrong position
SAMPLES = BAD + 101
DRIVES = 60
WHEELBASE_M = 1.3
SIGMA_V = (0.03, 0.03, 0.05, 0.02)


def bicycle(x, u, p, cos=ca.cos, sin=ca.sin, tan=ca.tan, join=ca.vertcat):
    return join(u[0] * cos(x[2]), u[0] * sin(x[2]), u[0] / WHEELBASE_M * tan(u[1] + p[0]))


def unicycle(x, u, p, cos=ca.cos, sin=ca.sin, tan=ca.tan, join=ca.vertcat):
    return join(p[0] * u[0] * cos(x[2]), p[0] * u[0] * sin(x[2]), p[1] * u[1])


# f, parameters with bounds, their guess and standard deviations, the range of the true ones
ROBOTS = {
    "bicycle": (bicycle, {"offset": (-0.1, 0.1)}, (0.0,), (0.08,), (-0.08, 0.08)),
    "unicycle": (unicycle, {"mu": (0, 1), "kappa": (0, 1)}, (0.8,) * 2, (0.15,) * 2, (0.6, 0.95)),
}


@functools.cache
def model(robot):
    f, parameters, *_ = ROBOTS[robot]
    outputs = ("x", "y", "speed", "turn")
    return rhec.Model(
        states=("x", "y", "yaw"),
        inputs=("speed", "turn"),
        parameters=parameters,
        outputs=outputs,
        f=f,
    )


@functools.cache
def drive(robot, seed):
    """Arguments of an estimator, measurements (n, 4) without outliers, true positions (n, 2)."""
    f, _, guess_p, sigma_p, p_range = ROBOTS[robot]
    rng = np.random.default_rng(seed)
    p = rng.uniform(*p_range, len(guess_p))
    x = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
    sigma = (0.3, 0.3, 0.2)
    guess = (*(x + rng.normal(size=3) * sigma), *guess_p)
    settings = dict(dt=DT_S, sigma_v=SIGMA_V, guess=guess, sigma_guess=(*sigma, *sigma_p))
    settings |= dict(sigma_w=(0.005,) * (3 + len(guess_p)))
    z = np.full((SAMPLES, 4), np.nan)
    places = np.empty((SAMPLES, 2))
    for k in range(SAMPLES):
        if k:
            u = np.array([1 + 0.3 * np.sin(0.1 * k), 0.25 * np.sin(0.07 * k + seed)])
            for _ in range(10):
                slope = f(x, u, p, np.cos, np.sin, np.tan, lambda *rows: np.array(rows))
                x = x + DT_S / 10 * slope
            z[k, 2:] = u
        z[k, :2] = places[k] = x[:2]
    return settings, z + rng.normal(size=z.shape) * SIGMA_V, places


def with_outlier(z, outlier):
    z = z.copy()
    z[BAD, :2] += outlier
    return z


def run(estimator, z):
    """Estimated positions (n, 2), and `ok` of each sample."""
    places = []
    ok = []
    for row in z:
        estimator.prepare()
        places.append(estimator.feedback(row).x[:2])
        ok.append(getattr(estimator, "ok", True))
    return np.array(places), np.array(ok)


def error_m(estimator, z, places):
    """The error [m] of each position, and whether the last one is `ok`."""
    found, ok = run(estimator, z)
    return np.linalg.norm(found - places, axis=1), ok


@pytest.mark.parametrize("size_m", [10, 100, 1000])
@pytest.mark.parametrize("robot", ROBOTS)
def test_after_one_wrong_position_it_is_lost_no_more_often_than_the_ekf(robot, size_m):
    """Lost: more than 0.5 m wrong 20 s later."""
    lost = dict(rhe=0, robust=0, ekf=0)
    for seed in range(DRIVES):
        settings, z, places = drive(robot, seed)
        outlier = np.random.default_rng([seed, size_m]).uniform(-size_m, size_m, 2)
        z = with_outlier(z, outlier)
        estimators = dict(
            rhe=rhec.RHE(model=model(robot), horizon=10, **settings),
            robust=rhec.RHE(model=model(robot), horizon=10, robust=True, **settings),
            ekf=rhec.EKF(model=model(robot), **settings),
        )
        for name, estimator in estimators.items():
            error, ok = error_m(estimator, z, places)
            lost[name] += error[-1] > 0.5
            if name != "ekf":
                assert not (ok & (error > 0.5))[10:].any()
    assert lost["rhe"] <= lost["ekf"]
    assert lost["robust"] <= lost["ekf"]


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("robot", ROBOTS)
def test_one_outlier_of_5_m_moves_the_estimate_by_at_most_5_cm(robot, robust):
    for seed in range(20):
        settings, z, _ = drive(robot, seed)
        found = [
            run(rhec.RHE(model=model(robot), horizon=10, robust=robust, **settings), rows)[0]
            for rows in (z, with_outlier(z, (3.0, -4.0)))
        ]
        assert np.linalg.norm(found[1] - found[0], axis=1).max() <= 0.05


def test_what_contradicts_its_measurement_is_not_ok_and_has_no_kkt():
    settings, z, _ = drive("bicycle", 0)
    mhe = rhec.RHE(model=model("bicycle"), horizon=10, **settings)
    for k, row in enumerate(with_outlier(z, (500.0, 0.0))):
        mhe.prepare()
        mhe.feedback(row)
        assert mhe.ok == (k != BAD)
        assert np.isnan(mhe.kkt) == (k == BAD)


@pytest.mark.parametrize("robot", ROBOTS)
def test_it_finds_back_to_positions_that_have_moved_for_good(robot):
    settings, z, places = drive(robot, 1)
    moved = np.where(np.arange(SAMPLES) < 30, 0, 5.0)[:, None]
    z = z.copy()
    z[:, :2] += moved
    error, ok = error_m(rhec.RHE(model=model(robot), horizon=10, **settings), z, places + moved)
    assert not ok[30:50].any()
    assert ok[-20:].all()
    assert error[-20:].max() < 0.5
