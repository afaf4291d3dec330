"""Logs that cannot be what their columns say: each is named in the sentence that docs/your_log.md
shows, before anything is estimated; what a log may be is not.
"""

import re
import warnings
from pathlib import Path

import make_example_log
import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further.recorded.scores import yaw_error
from rhec.logs import replay as module
from rhec.simulation.columns import ESTIMATE, RECORDED_TRUTH

LOG = pd.read_csv(make_example_log.FILE)
BLIND = LOG.drop(columns=list(RECORDED_TRUTH.values()))
NOISE = np.random.default_rng(7).standard_normal((len(LOG), 2))
PAGE = Path(__file__).parents[2] / "docs" / "your_log.md"


def late(log, rows=5):
    """Positions that come so many rows late."""
    return log.assign(**log.groupby("segment")[["x_m", "y_m", "pos_ok"]].shift(rows))


CASES = {
    "rows in reverse": LOG[::-1],
    "rows unsorted": LOG.sample(frac=1.0, random_state=0),
    "time in ms": LOG.assign(t_s=1e3 * LOG["t_s"]),
    "time in ns": LOG.assign(t_s=1e9 * LOG["t_s"]),
    "a segment for each row": LOG.assign(segment=range(len(LOG))),
    "degrees per second": LOG.assign(yaw_rate_radps=np.rad2deg(LOG["yaw_rate_radps"])),
    "km/h": LOG.assign(speed_mps=3.6 * LOG["speed_mps"]),
    "cm/s": LOG.assign(speed_mps=100 * LOG["speed_mps"]),
    "mm/s": LOG.assign(speed_mps=1000 * LOG["speed_mps"]),
    "positions in mm": LOG.assign(x_m=1e3 * LOG["x_m"], y_m=1e3 * LOG["y_m"]),
    "latitude as metres": LOG.assign(x_m=11.5 + LOG["x_m"] / 76e3, y_m=48 + LOG["y_m"] / 111e3),
    "yaw rate clockwise": LOG.assign(yaw_rate_radps=-LOG["yaw_rate_radps"]),
    "positions half a second late": late(LOG),
    "a robot that never moves": LOG.assign(speed_mps=0.001, yaw_rate_radps=0.0, x_m=0.0, y_m=0.0),
}


def shown():
    """{what is wrong: sentence} of the page's list."""
    items = re.findall(r"^- ([^:]+): (.*?)$(?!\n  )", PAGE.read_text("utf-8"), re.M | re.S)
    return {what: " ".join(sentence.split()) for what, sentence in items}


@pytest.fixture
def nothing_estimated(monkeypatch):
    """A replay stops where its estimator would begin."""
    monkeypatch.setattr(
        module, "estimate_samples", lambda *_, **__: (_ for _ in ()).throw(StopIteration)
    )


@pytest.mark.parametrize("what", CASES)
def test_an_implausible_log_is_named_before_anything_is_estimated(what, nothing_estimated):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises((ValueError, UserWarning)) as named:
            rhec.replay(CASES[what])
    assert str(named.value) == shown()[what]


def test_the_page_has_these_and_no_other():
    assert list(shown()) == list(CASES)


@pytest.mark.parametrize(
    "log",
    [
        LOG,
        BLIND,
        late(LOG, 1),
        LOG.assign(x_m=LOG["x_m"] + 5e5, y_m=LOG["y_m"] + 5e6),
        LOG.assign(speed_mps=1.5 * LOG["speed_mps"], yaw_rate_radps=2 * LOG["yaw_rate_radps"]),
        LOG.assign(pos_ok=LOG["pos_ok"].where(LOG.index % 10 == 0, 0)),
        LOG.iloc[:100],
        LOG.assign(x_m=np.where(LOG.index % 40 == 0, LOG["x_m"] + 10, LOG["x_m"])),
        LOG.assign(yaw_true_rad=(LOG["yaw_true_rad"] + np.pi) % (2 * np.pi) - np.pi),
        pd.concat([late(LOG, 5)[:1300], late(LOG, -6)[1300:]]),  # no delay makes up for that
        *(
            LOG.assign(**LOG[["x_m", "y_m"]] + sigma_m * NOISE) for sigma_m in (0.1, 0.5, 2.0)
        ),
    ],
)  # fmt: skip
def test_what_a_log_may_be_is_plausible(log, nothing_estimated):
    """Slip, sparse and noisy positions, outliers, wrapped yaws, UTM coordinates, no one delay."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises((StopIteration, RuntimeError)):
            rhec.replay(log)


def test_an_unused_truth_and_a_constant_speed_say_nothing(nothing_estimated):
    t = np.arange(0, 60, 0.1)
    straight = pd.DataFrame(dict(t_s=t, x_m=0.45 * t, y_m=0.0, speed_mps=0.5, yaw_rate_radps=0.0))
    with pytest.raises((StopIteration, RuntimeError)):
        rhec.replay(straight.assign(yaw_true_rad=3.0))


def test_a_delay_that_is_told_is_made_up_for():
    given = dict(process_noise="likelihood", speed_model="input", first_yaw_rad=(0.4, -2.0))
    fresh = rhec.replay(LOG, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told = rhec.replay(late(LOG, 4), position_delay_s=0.4, **given)
    whole = LOG.groupby("segment").cumcount(ascending=False) >= 10  # the last have no position
    np.testing.assert_allclose(told[ESTIMATE][whole], fresh[ESTIMATE][whole], atol=1e-6)


def test_a_log_can_be_taken_as_it_is():
    log = CASES["km/h"][:300]
    with pytest.raises(ValueError, match="speed_mps may be in km/h"):
        rhec.replay(log)
    assert (
        len(rhec.replay(log, trust_log=True, process_noise="likelihood", speed_model="input"))
        == 300
    )


@pytest.mark.parametrize("silence_s", [5.0, 60.0])
def test_a_silence_keeps_the_traction_and_the_yaw(silence_s):
    """While the robot stands the log is off: after it, nothing begins anew."""
    stands = LOG.query("segment == 0 and 33.9 < t_s < 34.6").index
    before, after = LOG[: stands[0]], LOG[stands[-1] : stands[-1] + 200]
    after = after.assign(t_s=after["t_s"] + silence_s)
    result = rhec.replay(pd.concat([before, after], ignore_index=True), smooth=False)
    assert result["segment"].nunique() == 1 and np.isfinite(result[ESTIMATE]).all(axis=None)
    last, first = result.iloc[len(before) - 1], result.iloc[len(before) + 2]
    assert abs(first["mu_hat"] - last["mu_hat"]) < 0.02
    assert abs(first["kappa_hat"] - last["kappa_hat"]) < 0.05
    assert first["sigma_kappa"] < 0.5 * result["sigma_kappa"].iloc[0]
    error = yaw_error(result)
    assert abs(error.iloc[len(before) + 2]) < 2 * first["sigma_theta_rad"]
    assert error.iloc[-50:].abs().max() < 0.1


def test_missing_positions_leave_the_yaw_to_the_encoders():
    log = LOG[LOG["segment"] == 0].reset_index(drop=True)
    log.loc[log["t_s"].between(40, 50), ["x_m", "y_m"]] = np.nan
    result = rhec.replay(log, first_yaw_rad=0.4)
    gap = result[result["t_s"].between(40, 52)]
    assert yaw_error(gap).abs().max() < 0.15 and gap["kappa_hat"].std() < 0.02
