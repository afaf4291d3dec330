"""Logs that look like recordings and cannot be used: times, places and sizes."""

import numpy as np
import pandas as pd
import pytest
from helpers import may_be_unsure

import rhec

T = np.arange(600) * 0.2
DRIVE = pd.DataFrame(
    dict(
        t_s=T, x_m=0.5 * T, y_m=np.sin(0.1 * T), speed_mps=0.5, yaw_rate_radps=0.1 * np.cos(0.1 * T)
    )
)


@pytest.mark.parametrize(
    "t_s",
    [
        np.full(600, 5.0),
        [float(f"{t:.6g}") for t in 1_722_264_375 + T],  # as a spreadsheet prints Unix seconds
    ],
    ids=["constant", "rounded"],
)
def test_times_that_do_not_rise_are_refused(t_s):
    with pytest.raises(ValueError, match="t_s can be used in 1 of 600 rows.*constant or rounded"):
        rhec.replay(DRIVE.assign(t_s=t_s))


@may_be_unsure
def test_some_unusable_times_are_no_reason_to_refuse():
    t_s = np.where(np.arange(600) % 5 == 0, np.nan, T)
    assert rhec.replay(DRIVE.assign(t_s=t_s)).attrs["faults"]["unusable_times"] == 120


def test_positions_that_never_change_are_refused():
    frozen = DRIVE.assign(x_m=1.0, y_m=1.0)
    with pytest.raises(ValueError, match="x_m, y_m should be of a robot that moves"):
        rhec.replay(frozen)


def written(tmp_path, log):
    file = tmp_path / "log.csv"
    log.to_csv(file, index=False)
    return file


def with_angles(latitude, longitude):
    log = DRIVE.drop(columns=["x_m", "y_m"])
    return log.assign(latitude=latitude, longitude=longitude)


@pytest.mark.parametrize(
    "latitude, longitude, name",
    [(5213.5, 4.3, "latitude"), (52.1, 43012.1, "longitude"), (521_000_000, 4.3, "latitude")],
)
def test_angles_in_other_units_are_refused(tmp_path, latitude, longitude, name):
    with pytest.raises(ValueError, match=f"the log's {name} is .* should be in degrees"):
        rhec.logs.read(written(tmp_path, with_angles(latitude + 1e-6 * T, longitude)))


def test_a_receiver_without_a_fix_gives_no_origin(tmp_path):
    latitude = np.where(T < 2, 0.0, 52.1 + 1e-6 * T)
    longitude = np.where(T < 2, 0.0, 4.3)
    log = rhec.logs.read(written(tmp_path, with_angles(latitude, longitude)))
    assert log["x_m"][T < 2].isna().all()
    assert log["y_m"].abs().max() < 100


@pytest.mark.nightly
def test_files_too_large_for_a_log_are_refused(tmp_path):
    file = tmp_path / "wide.csv"
    file.write_text(",".join(f"c{i}" for i in range(20_000)) + "\n")
    with pytest.raises(ValueError, match="20000 columns"):
        rhec.logs.read(file)
    file.write_text("t_s,x_m\n" + 20 * ("0" + 20_000 * ",0" + "\n"))
    with pytest.raises(ValueError, match="20001 columns"):
        rhec.logs.read(file)
    bomb = tmp_path / "bomb.parquet"
    pd.DataFrame(dict.fromkeys("abcdefghij", np.zeros(6_000_000))).to_parquet(bomb)
    with pytest.raises(ValueError, match="60000000 values"):
        rhec.logs.read(bomb)


@pytest.mark.parametrize("path", [5, None, b"log.csv", "a" * 5_000])
def test_what_is_no_path_is_refused_in_a_sentence(path):
    with pytest.raises(ValueError, match="log was .* it (should|cannot) be a path"):
        rhec.logs.read(path)


def test_segments_that_cannot_be_told_apart_are_refused():
    with pytest.raises(ValueError, match="segment should be one column of numbers or words"):
        rhec.replay(DRIVE.assign(segment=[[1]] * 600))
