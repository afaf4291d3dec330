"""The drives by which the verdict on a log is judged, and how its rates are counted."""

import re

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further.recorded import page, verdicts


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


def test_what_is_true_of_a_log_is_what_its_robot_does():
    """By the regression on its true path, of the robot's centre: not of an antenna beside it."""
    log = verdicts.open_loop_log(3, drift_radpm=0.05, slip=0.0, lag_s=0.0, duration_s=90.0)
    samples = rhec.log(log, trust_log=True).samples.assign(arm_forward_hat_m=0.5)
    found = [slope.value for slope in verdicts.true_slopes(samples)]
    assert found == pytest.approx([verdicts.MU, verdicts.KAPPA, 0.05], abs=0.01)


def test_each_log_of_the_page_is_judged(monkeypatch):
    monkeypatch.setattr(verdicts, "judged", lambda log: dict(rows=len(log)))
    monkeypatch.setattr(page, "aligned", lambda log: log[1:])
    log = verdicts.open_loop_log(3)
    found = page.said(dict(whole=log, part=log[:100]))
    assert found.to_dict("list") == dict(log=["whole", "part"], rows=[len(log) - 1, 99])


def test_errors_of_positions_are_as_large_as_is_said_and_late_ones_are_late():
    white, wandering, late = (
        verdicts.open_loop_log(5, noise_m=noise_m, **changes)
        for noise_m, changes in ((0.1, {}), (0.0, dict(wander_m=1.0)), (0.0, dict(late_s=0.2)))
    )
    for log, sigma_m, rel in ((white, 0.1, 0.1), (wandering, 1.0, 0.7)):
        off = (log["x_m"] - log["x_true_m"]).dropna()
        assert np.sqrt((off**2).mean()) == pytest.approx(sigma_m, rel=rel)
    off = late["x_m"] - late["x_true_m"].shift(2)
    assert off.abs().max() < 1e-2 < (late["x_m"] - late["x_true_m"]).abs().max()


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
