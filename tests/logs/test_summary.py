"""What a log says at a glance: the traction with its interval, and when not to trust it."""

import numpy as np
import pandas as pd
import pytest
from helpers import KAPPA, MU, recorded_log

from rhec.cli import main
from rhec.logs.summary import summarise

LOG = recorded_log(5.0, 150.0, noise_m=0.02, seed=3)


@pytest.fixture(scope="module")
def summary():
    return summarise(LOG)


def test_the_traction_has_an_interval_that_covers(summary):
    for name, truth in (("μ", MU), ("κ", KAPPA)):
        row = summary.traction.loc[name]
        assert row["low"] < truth < row["high"] and row["high"] - row["low"] < 0.1
        assert row["on the way"] == pytest.approx(truth, abs=0.05)


def test_a_good_log_is_to_be_trusted_and_says_what_is_next(summary):
    assert summary.verdict.startswith("Trust it.") and "rhec calibrate" in summary.verdict
    text = str(summary)
    assert "positions: x_m, y_m" in text and "encoders: speed_mps, yaw_rate_radps" in text
    assert "truth: x_true_m" in text and "--track-width-m" in text


def test_a_log_without_turns_does_not_tell_kappa():
    rng = np.random.default_rng(0)
    t = np.arange(0, 120, 0.2)
    log = pd.DataFrame(dict(t_s=t, x_m=0.45 * t, y_m=0.0, speed_mps=0.5, yaw_rate_radps=0.0))
    log[["x_m", "y_m"]] += 0.02 * rng.standard_normal((len(t), 2))
    verdict = summarise(log).verdict
    assert verdict.startswith("Do not trust it yet") and "two figures of eight" in verdict


def test_positions_that_contradict_the_encoders_are_not_trusted():
    """They come from another drive, so that no yaw explains them."""
    other = recorded_log(5.0, 150.0, start_rad=2.0, noise_m=0.02, seed=4)
    mixed = LOG.assign(x_m=other["y_m"].to_numpy()[::-1], y_m=other["x_m"].to_numpy()[::-1])
    assert summarise(mixed, trust_log=True).verdict.startswith("Do not trust it yet")


def test_a_log_that_is_refused_has_no_estimate_and_the_reason():
    refused = summarise(LOG.assign(speed_mps=3.6 * LOG["speed_mps"]))
    assert refused.traction is None and "km/h" in refused.verdict
    assert summarise(LOG.drop(columns="x_m")).verdict.startswith("No estimate: The log had no col")


def test_the_command_prints_it_and_writes_tables(capsys, tmp_path):
    LOG.to_csv(tmp_path / "drive.csv", index=False)
    words = ["log", str(tmp_path / "drive.csv"), "--folder", str(tmp_path / "out")]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "Trust it." in said.out and said.err.count("found") == 0
    assert len(pd.read_csv(tmp_path / "out" / "estimates.csv")) == len(LOG)
    assert main(words) == 2
    assert "exists" in capsys.readouterr().err
    LOG.assign(x_m=1.0, y_m=1.0).to_csv(tmp_path / "frozen.csv", index=False)
    assert main(["log", str(tmp_path / "frozen.csv")]) == 1
    assert "No estimate" in capsys.readouterr().out
