"""The drives by which the verdict on a log is judged, and how its rates are counted."""

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further.recorded import page, scores, verdicts


@pytest.mark.parametrize("kind", verdicts.OPEN_LOOP)
def test_a_robot_in_open_loop_is_what_its_kind_says(kind):
    """It goes μ times as far as its tracks, turns κ times, and drifts in proportion to its way."""
    said = {float(number) for number in re.findall(r"[\d.]+", kind)}
    assert said <= {*verdicts.OPEN_LOOP[kind].values()}
    changes = verdicts.OPEN_LOOP[kind] | dict(slip=0.0, lag_s=0.0)
    log = verdicts.open_loop_log(3, **changes)
    assert log["t_s"].iloc[-1] == pytest.approx(changes.get("duration_s", 180.0), abs=0.02)
    mu, kappa = changes.get("mu", verdicts.MU), changes.get("kappa", verdicts.KAPPA)
    np.testing.assert_allclose(log["v_true_mps"], mu * log["speed_mps"], atol=1e-12)
    turns = kappa * log["yaw_rate_radps"] + changes.get("drift_radpm", 0) * log["v_true_mps"]
    np.testing.assert_allclose(log["yaw_rate_true_radps"], turns, atol=1e-12)
    way_m = np.hypot(log["x_true_m"].diff(), log["y_true_m"].diff())
    np.testing.assert_allclose(way_m[1:], 0.1 * log["v_true_mps"].abs()[1:], atol=2e-3)
    assert log["x_m"].notna().sum() == pytest.approx(
        changes.get("gnss_hz", 5) * log["t_s"].iloc[-1], abs=2
    )


def test_each_log_of_the_page_is_judged(monkeypatch):
    monkeypatch.setattr(verdicts, "judged", lambda log: dict(rows=len(log)))
    monkeypatch.setattr(page, "aligned", lambda log: log[1:])
    log = verdicts.open_loop_log(3)
    found = page.said(dict(whole=log, part=log[:100]))
    assert found.to_dict("list") == dict(log=["whole", "part"], rows=[len(log) - 1, 99])


def test_errors_of_positions_are_as_large_as_is_said_and_late_ones_are_late():
    """Those that wander have forgotten all but 1/e after a minute."""
    white, wandering, late = (
        verdicts.open_loop_log(5, noise_m=noise_m, **changes)
        for noise_m, changes in ((0.1, {}), (0.0, dict(wander_m=1.0)), (0.0, dict(late_s=0.2)))
    )
    for log, sigma_m, rel in ((white, 0.1, 0.1), (wandering, 1.0, 0.7)):
        off = (log["x_m"] - log["x_true_m"]).dropna()
        assert np.sqrt((off**2).mean()) == pytest.approx(sigma_m, rel=rel)
    off = verdicts._wandering(600_000, 1.0, np.random.default_rng(0)).real
    assert off.std() == pytest.approx(1, rel=0.1)
    assert np.corrcoef(off[600:], off[:-600])[0, 1] == pytest.approx(np.exp(-1), abs=0.06)
    off = late["x_m"] - late["x_true_m"].shift(2)
    assert off.abs().max() < 1e-2 < (late["x_m"] - late["x_true_m"]).abs().max()


def test_a_robot_slips_on_a_slope_and_follows_its_encoders_late():
    """Across the slope its way is off its yaw, and its speeds are those that the encoders had."""
    log = verdicts.open_loop_log(7, slip=0.0, slope_rad=0.3, lag_s=0.3)
    for told, true, factor in (
        ("speed_mps", "v_true_mps", verdicts.MU),
        ("yaw_rate_radps", "yaw_rate_true_radps", verdicts.KAPPA),
    ):
        before = log[told].shift(3).fillna(0.0)
        np.testing.assert_allclose(log[true], factor * before, atol=1e-9)
    step = np.diff(log["x_true_m"] + 1j * log["y_true_m"])
    is_fast = (log["v_true_mps"].abs() > 0.3)[1:] & (np.sign(log["v_true_mps"]).diff() == 0)[1:]
    yaw = log["yaw_true_rad"].rolling(2).mean()[1:]
    aside = np.angle(step * np.sign(log["v_true_mps"][1:]) * np.exp(-1j * yaw))
    np.testing.assert_allclose(aside[is_fast], 0.3 * np.sin(yaw[is_fast]), atol=0.02)


def test_drives_are_of_the_kinds_and_seeds_that_the_page_says():
    """With 4 seeds 80 in closed and 44 in open loop, each robot once on a seed."""
    drives = [*verdicts.drives(4)]
    table = pd.DataFrame(drives)
    assert table["loop"].value_counts().to_dict() == dict(closed=80, open=44)
    by_kind = table.groupby(["loop", "kind"])["seed"]
    assert (by_kind.nunique() == by_kind.size()).all()
    assert set(table["seed"]) == set(range(560_000, 560_008))
    for drive in drives[:21]:
        if drive.loop == "open":
            robot = dict(mu=verdicts.MU, kappa=verdicts.KAPPA, drift_radpm=0.0)
            robot |= verdicts.OPEN_LOOP[drive.kind]
            assert drive.known == [robot["mu"], robot["kappa"], robot["drift_radpm"]]
        else:
            world, _, gyro = drive.kind.partition(", with a ")
            expected = dict(sensors=(gyro,) if gyro else (), seed=drive.seed)
            assert drive.make.args == (world, *expected.values())


# Its slopes are known, and it has no lag.
ROBOT = dict(drift_radpm=0.05, slip=0.0, lag_s=0.0, duration_s=60.0)
KNOWN = [verdicts.MU, verdicts.KAPPA, 0.05]


@pytest.fixture(scope="module")
def summary():
    """What is said of a short drive, and which of its samples count."""
    log = verdicts.open_loop_log(3, **ROBOT)
    found = rhec.log(log, trust_log=True)
    return found, scores.distance_driven(found.way) >= scores.FROM_M


def test_what_is_true_of_a_log_is_what_its_robot_does(summary):
    """By the regression on its true path, of the robot's centre: not of an antenna beside it."""
    samples = summary[0].samples.assign(arm_forward_hat_m=0.5)
    found = [slope.value for slope in verdicts.true_slopes(samples)]
    assert found == pytest.approx(KNOWN, abs=0.01)


def test_a_drive_is_tried_as_it_is_judged(summary, monkeypatch):
    robot = verdicts.partial(verdicts.open_loop_log, 3, **ROBOT)
    drive = verdicts.Drive("open", "short", 3, robot, KNOWN)
    monkeypatch.setattr(verdicts, "drives", lambda seeds: [drive] * seeds)
    (row,) = verdicts.trials(1).to_dict("records")
    expected = verdicts.of_summary(summary[0], KNOWN)
    assert row == pytest.approx(dict(loop="open", kind="short", seed=3) | expected, nan_ok=True)
    assert [row["μ_true"], row["κ_true"], row["drift_true"]] == KNOWN
    table = summary[0].traction
    assert (row["κ_low"], row["κ_high"]) == tuple(table.loc["κ", ["low", "high"]])


@pytest.mark.parametrize(
    "place, share, off_rad, sigma_rad, kappa_off, is_wrong",
    [
        ("way", 0.04, 0.25, 0.2, 0.0, False),
        ("way", 0.06, 0.25, 0.2, 0.0, True),
        ("way", 0.06, -0.25, 0.2, 0.0, True),
        ("way", 0.06, 0.19, 0.2, 0.0, False),
        ("samples", 0.06, 0.25, 0.2, 0.0, True),
        ("way", 0.14, 0.15, 0.07, 0.0, False),
        ("way", 0.16, 0.15, 0.07, 0.0, True),
        ("way", 0.16, 0.13, 0.07, 0.0, False),
        ("samples", 0.16, 0.15, 0.07, 0.0, False),
        ("way", 0.0, 0.0, 0.1, 0.029, False),
        ("way", 0.0, 0.0, 0.1, 0.031, True),
        ("way", 0.0, 0.0, 0.1, -0.031, True),
    ],
)
def test_a_log_is_wrong_by_its_yaws_its_kappa_or_its_sigma(
    summary, place, share, off_rad, sigma_rad, kappa_off, is_wrong
):
    """A share of the yaws is off by so much; κ ± 0.01 is as far from that of the true path."""
    found, counts = summary
    exact = found.way.assign(theta_hat_rad=found.way["theta_rad"], sigma_theta_rad=sigma_rad)
    rank = counts.cumsum() / counts.sum()
    wrong = exact["theta_rad"] + np.where(counts & (rank <= share), off_rad, 0.0)
    kappa = verdicts.true_slopes(found.samples)[1].value + kappa_off
    traction = found.traction.assign(low=kappa - 0.01, high=kappa + 0.01)
    given = dict(verdict="Trust it: all is well", numbers=found.numbers, traction=traction)
    given |= dict(way=exact, samples=exact) | {place: exact.assign(theta_hat_rad=wrong)}
    row = verdicts.of_summary(SimpleNamespace(**given))
    assert row["is_wrong"] == is_wrong and row["is_trusted"]
    name = dict(way="way", samples="smoothed")[place]
    n_off = (counts & (rank <= share)).sum()
    assert row[f"{name}_rms_rad"] == pytest.approx(abs(off_rad) * np.sqrt(n_off / counts.sum()))


def test_false_trust_false_alarms_and_what_is_not_told_are_counted_by_loop():
    is_wrong = [True, True, True, False, False, False, False]
    is_trusted = [True, False, False, False, False, True, True]
    untold = "Cannot tell: no lap"
    verdict = ["Trust", untold, "Do not trust", "Do not trust", untold, "Trust", "Trust"]
    columns = dict(seed=range(7), is_wrong=is_wrong, is_trusted=is_trusted, verdict=verdict)
    rows = pd.DataFrame(dict(columns, loop="open"))
    found = verdicts.rates(rows).set_index("rate")
    assert found.loc["false trust", ["k", "n"]].tolist() == [1, 3]
    assert found.loc["false alarm", ["k", "n"]].tolist() == [1, 4]
    assert found.loc["untold", ["k", "n"]].tolist() == [1, 4]
    assert (found["low"] < found["k"] / found["n"]).all()


def test_intervals_that_are_not_known_hold_nothing_and_miss_nothing():
    ends = dict(low=[0.0, 0.0, np.nan], true=[0.5, 2.0, 0.5], high=[1.0, 1.0, np.nan])
    rows = pd.DataFrame(dict(loop="open", kind="one", way_in_95=1.0, smoothed_in_95=0.5), range(3))
    for name in ("μ", "κ", "drift"):
        rows = rows.assign(**{f"{name}_{end}": values for end, values in ends.items()})
    found = verdicts.coverage(rows)
    assert found.loc[0, ["μ", "κ", "drift"]].tolist() == [0.5] * 3
    assert found.loc[0, ["yaw on the way", "yaw smoothed"]].tolist() == [1.0, 0.5]
