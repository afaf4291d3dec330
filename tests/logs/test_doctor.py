"""The doctor names what is wrong with a log, and finds nothing in a healthy one.

Each defect is put into a log that the project simulates. With RHEC_LOGS, a folder of recorded logs,
those must be healthy, too.
"""

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import TRACK_WIDTH_M, recorded_log

import rhec
from rhec.cli import main

LOG = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)
T = LOG["t_s"]
RANDOM = np.random.default_rng(5)
FAULTY = (T >= 60) & (T < 90)


def change(where, **columns):
    log = LOG.copy()
    for name, values in columns.items():
        log.loc[where, name] = values[where] if isinstance(values, pd.Series) else values
    return log


def dead(left, right):
    """Tracks whose encoders show 0 from 60 to 90 s."""
    half = TRACK_WIDTH_M / 2 * LOG["yaw_rate_radps"]
    v_left = (LOG["speed_mps"] - half) * left
    v_right = (LOG["speed_mps"] + half) * right
    return change(
        FAULTY, speed_mps=(v_left + v_right) / 2, yaw_rate_radps=(v_right - v_left) / TRACK_WIDTH_M
    )


def noisy(sigma_m, where=slice(None)):
    log = LOG.copy()
    x, y = sigma_m * RANDOM.standard_normal((2, len(LOG)))
    log.loc[where, "x_m"] += x[where]
    log.loc[where, "y_m"] += y[where]
    return log


def integrated():
    """Positions that are the integral of the encoders."""
    step_s = np.gradient(T)
    theta = np.cumsum(LOG["yaw_rate_radps"] * step_s)
    steps = LOG["speed_mps"] * step_s
    return LOG.assign(x_m=np.cumsum(steps * np.cos(theta)), y_m=np.cumsum(steps * np.sin(theta)))


def moved():
    """The robot is carried 3 m while nothing is recorded for two minutes."""
    later = T > 80
    return change(later, t_s=T + 120, x_m=LOG["x_m"] + 3.0)


def late(seconds):
    rows = round(seconds / 0.1)
    return LOG.assign(**LOG[["x_m", "y_m"]].shift(rows))


def gyro(scale=1.0, bias=0.0):
    """A drive with a pause of 10 s in the middle, and a gyro."""
    rest = LOG.iloc[[600] * 100].assign(speed_mps=0.0, yaw_rate_radps=0.0, yaw_rate_true_radps=0.0)
    x, y = 0.02 * RANDOM.standard_normal((2, 100))
    rest = rest.assign(x_m=rest["x_m"] + x, y_m=rest["y_m"] + y)
    log = pd.concat([LOG[:600], rest, LOG[600:]], ignore_index=True)
    log["t_s"] = 0.1 * np.arange(len(log))
    noise = 0.005 * RANDOM.standard_normal(len(log))
    return log.assign(gyro_radps=scale * log["yaw_rate_true_radps"] + bias + noise)


BURST = FAULTY & (RANDOM.random(len(LOG)) < 0.1)
SPEED, TURN = LOG["speed_mps"], LOG["yaw_rate_radps"]
X, Y = LOG["x_m"], LOG["y_m"]
# {defect: (code that must be among the findings, log)}
DEFECTS = {
    "speed in km/h": ("implausible", LOG.assign(speed_mps=3.6 * SPEED)),
    "speed in mm/s": ("unusable", LOG.assign(speed_mps=1e3 * SPEED)),
    "positions in cm": ("implausible", LOG.assign(x_m=100 * X, y_m=100 * Y)),
    "positions in feet": ("implausible", LOG.assign(x_m=3.28 * X, y_m=3.28 * Y)),
    "degrees per second": ("implausible", LOG.assign(yaw_rate_radps=np.rad2deg(TURN))),
    "yaw rate clockwise": ("implausible", LOG.assign(yaw_rate_radps=-TURN)),
    "x and y swapped": ("implausible", LOG.assign(x_m=Y, y_m=X)),
    "frozen positions": ("implausible", LOG.assign(x_m=1.0, y_m=1.0)),
    "no column of speeds": ("unusable", LOG.drop(columns="speed_mps")),
    "constant time": ("unusable", LOG.assign(t_s=7.0)),
    "rows twice": ("clock", pd.concat([LOG, LOG[::3]]).sort_values("t_s")),
    "positions 0.4 s late": ("late_positions", late(0.4)),
    "positions 0.3 s early": ("late_positions", late(-0.3)),
    "left encoder dead": ("track_dead", dead(0, 1)),
    "right encoder dead": ("track_dead", dead(1, 0)),
    "both encoders dead": ("encoders_dead", dead(0, 0)),
    "encoders silent": ("dropout", change(FAULTY, speed_mps=np.nan, yaw_rate_radps=np.nan)),
    "no positions for 30 s": ("dropout", change(FAULTY, x_m=np.nan, y_m=np.nan)),
    "positions at 0.5 Hz": ("low_rate", change(LOG.index % 20 > 0, x_m=np.nan, y_m=np.nan)),
    "outliers": ("jumps", change(BURST, x_m=X + 4.0)),
    "jump": ("jumps", change(FAULTY, x_m=X + 3.0)),
    "carried in silence": ("moved_in_silence", moved()),
    "wheels too small": ("scale_of_speed", LOG.assign(speed_mps=0.75 * SPEED)),
    "yaw rate corrected": ("corrected_yaw_rate", LOG.assign(yaw_rate_radps=0.5 * TURN)),
    "noise declared too low": ("declared_noise", noisy(0.2).assign(position_sigma_m=0.02)),
    "RTK float": ("float_positions", LOG.assign(position_sigma_m=0.02 + 0.4 * FAULTY)),
    "odometry as positions": ("own_integral", integrated()),
    "gyro clockwise": ("implausible", gyro(scale=-1.0)),
    "too short": ("too_short", LOG[:150]),
    "straight on": ("never_turns", LOG.assign(yaw_rate_radps=0.0)),
}


@pytest.mark.parametrize("log", [LOG, gyro(), noisy(0.1), recorded_log(5.0, 120.0, noise_m=0.03)])
def test_a_healthy_log_has_no_findings(log):
    diagnosis = rhec.doctor(log)
    assert diagnosis.ok, str(diagnosis)


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_named(defect):
    code, log = DEFECTS[defect]
    diagnosis = rhec.doctor(log)
    assert code in [finding.code for finding in diagnosis.findings], str(diagnosis)
    assert all(f.sentence.endswith(".") and f.remedy.endswith(".") for f in diagnosis.findings)


@pytest.mark.parametrize("file", sorted(Path(os.environ.get("RHEC_LOGS", "-")).glob("*.csv")))
def test_recorded_logs_are_healthy(file):
    assert rhec.doctor(rhec.logs.read(file)).ok


def test_a_path_is_diagnosed_as_its_log_and_a_missing_file_is_refused(tmp_path):
    file = tmp_path / "log.csv"
    change(FAULTY, x_m=np.nan, y_m=np.nan).to_csv(file, index=False)
    diagnosis = rhec.doctor(file)
    assert not diagnosis.ok
    assert str(diagnosis) == str(rhec.doctor(str(file))) == str(rhec.doctor(rhec.logs.read(file)))
    with pytest.raises(ValueError, match="^log was .*none.csv'; it should be an existing .csv"):
        rhec.doctor(tmp_path / "none.csv")


def test_the_command_ends_with_the_exit_code_of_its_findings(tmp_path, capsys):
    for name, log, code in (("good", LOG, 0), ("bad", dead(0, 1), 1)):
        log.to_csv(tmp_path / f"{name}.csv", index=False)
        assert main(["doctor", str(tmp_path / f"{name}.csv"), "--json"]) == code
        assert json.loads(capsys.readouterr().out)["ok"] == (code == 0)
    LOG.rename(columns=dict(x_m="east")).to_csv(tmp_path / "east.csv", index=False)
    assert main(["doctor", str(tmp_path / "east.csv"), "--columns", "x_m=east"]) == 0
    assert "found separator: comma" in capsys.readouterr().err
    assert main(["doctor", str(tmp_path / "none.csv")]) == 2
    assert "none.csv" in capsys.readouterr().err
