"""The command `rhec`: the same results as in Python, one sentence for a mistake, exit codes."""

import contextlib
import dataclasses
import functools
import io
import json
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers import SIMPLE_WORLD, recorded_log

import rhec
from rhec.cli import main

SHORT = ["--duration-s", "8"]


@pytest.fixture(scope="module")
def log_file(tmp_path_factory):
    """A simulated drive as a recorded log."""
    file = tmp_path_factory.mktemp("recorded") / "drive.csv"
    run = rhec.simulate(rhec.Scenario(duration_s=20, **SIMPLE_WORLD))
    run.log.to_csv(file, index=False)
    return file


@pytest.fixture(scope="module")
def judged(log_file, tmp_path_factory):
    """What `rhec log FILE --output estimates` said, wrote, and asked of `rhec.log`."""
    folder = tmp_path_factory.mktemp("judged") / "estimates"
    seen = SimpleNamespace(folder=folder, out=io.StringIO(), err=io.StringIO())

    @functools.wraps(rhec.log)
    def log(recorded, **given):
        seen.recorded, seen.given, seen.summary = recorded, given, judge(recorded, **given)
        return seen.summary

    judge = rhec.log
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(seen.out),
        contextlib.redirect_stderr(seen.err),
    ):
        patch.setattr(rhec, "log", log)
        seen.code = main(["log", str(log_file), "--output", str(folder)])
    return seen


@pytest.mark.parametrize("q", ["[1, 1, 0.5]", "1,1,0.5"])
def test_a_run_is_that_of_python(capsys, tmp_path, q):
    file = tmp_path / "log.csv"
    words = ["simulate", *SHORT, "--world", "soft", "--seed", "3", "--q", q]
    assert main([*words, "--json", "--log", str(file)]) == 0
    metrics = json.loads(capsys.readouterr().out)
    fields = rhec.WORLDS["soft"] | dict(duration_s=8, seed=3, q=(1, 1, 0.5))
    run = rhec.simulate(rhec.Scenario(**fields))
    for name, value in run.metrics.items():
        assert metrics[name] == value or metrics[name] is None and np.isnan(value)
    pd.testing.assert_frame_equal(pd.read_csv(file), run.log, check_exact=False, rtol=1e-14)


def test_a_log_is_judged_as_in_python_and_all_of_it_is_written(capsys, log_file, judged):
    pd.testing.assert_frame_equal(judged.recorded, rhec.logs.read(log_file))
    folder, expected = judged.folder, judged.summary
    assert judged.given == {} and judged.code == 0
    table = pd.read_csv(folder / "estimates.csv")
    yaw = "theta_hat_rad"
    np.testing.assert_allclose(table[yaw], expected.estimates[yaw], rtol=1e-9)
    assert (folder / "summary.txt").read_text("utf-8").startswith(str(expected))
    assert (folder / "C" / "search.c").is_file()
    said = judged.out.getvalue()
    assert said.startswith(str(expected)) and "rows are read" in judged.err.getvalue()
    assert (folder / "robot.yaml").read_text("utf-8") == expected.yaml
    written = re.search(rf"^Written: {folder}/ \((.*)\)$", said, re.M)[1]
    files = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert {*written.split(", ")} == {file for file in files if "C/" not in file} | {"C/README.txt"}
    # A second one overwrites nothing, unless it is told to.
    assert main(["log", str(log_file), "--output", str(folder)]) == 2
    assert "exists" in capsys.readouterr().err


def test_commands_of_before_say_what_they_are_now(capsys):
    for word, now in (("doctor", "--check"), ("calibrate", "--calibrate"), ("replay", "--output")):
        assert main([word, "drive.csv"]) == 2
        assert f"it is now rhec log FILE {now}" in capsys.readouterr().err


def test_two_files_of_one_drive_are_one_log(capsys, tmp_path):
    log = recorded_log(5.0, 60.0, noise_m=0.02, seed=3)
    log[["t_s", "x_m", "y_m"]].to_csv(tmp_path / "places.csv", index=False)
    wheels = log[["t_s", "speed_mps", "yaw_rate_radps"]].rename(columns=dict(speed_mps="v"))
    wheels.to_csv(tmp_path / "wheels.csv", index=False)
    log.to_csv(tmp_path / "both.csv", index=False)
    words = ["log", "--check", "--json", "--columns", "speed_mps=v"]
    files = [str(tmp_path / name) for name in ("places.csv", "wheels.csv")]
    assert main([words[0], *files, *words[1:]]) == 0
    facts = json.loads(capsys.readouterr().out)["facts"]
    assert main(["log", str(tmp_path / "both.csv"), "--check", "--json"]) == 0
    assert facts == pytest.approx(json.loads(capsys.readouterr().out)["facts"])


def test_names_of_columns_are_asked_for_as_a_shell_takes_them(capsys, log_file, tmp_path):
    log = pd.read_csv(log_file).rename(columns=dict(x_meas_m="easting", y_meas_m="northing"))
    log[["t_s", "easting", "northing"]].to_csv(tmp_path / "renamed.csv", index=False)
    main(["log", str(tmp_path / "renamed.csv"), "--check"])
    assert "did you mean --columns x_m=easting y_m=northing" in capsys.readouterr().out


@pytest.mark.nightly
def test_an_export_is_that_of_python(capsys, tmp_path):
    assert main(["export", str(tmp_path / "one"), *SHORT]) == 0
    rhec.export(rhec.Scenario(duration_s=8), tmp_path / "two")
    for file in (tmp_path / "two").iterdir():
        assert (tmp_path / "one" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize(
    "words, sentence",
    [
        (["simulate", "--seed", "-1"], "seed was -1"),
        (["simulate", "--world", "sft"], 'for --world. Choose from: "default", "firm", "soft"'),
        (["simulate", "--log", "log.txt"], "--log was 'log.txt'"),
        (["simulate", "--log", "no/such.csv"], "--log was 'no/such.csv'; there is no folder 'no'"),
        (["simulate", "--plot", "x.nothing"], "--plot was 'x.nothing'; it should end in .png or"),
        (["log", "missing.csv", "--output", os.devnull], "--output was"),
        (["log", "missing.csv", "--output", "/proc/x/y"], "where nothing can be written ("),
        (["log", "missing.csv", "--output", "new/folder"], "log was 'missing.csv'"),
        (["campaign", "--seeds", "0"], "--seeds was 0"),
        (["campaign", "-p", "seed"], "-p seed had no value"),
        (["log", "missing.bag"], "log was 'missing.bag'"),
        (["log", "missing.bag", "--columns", "x_m"], "--columns was 'x_m'"),
        (["log", "missing.bag", "--columns", "east=x_m"], "OURS=THEIRS: write x_m=east"),
        (["log", "missing.bag", "--columns", "east=e"], "OURS=THEIRS: OURS should be one of t_s"),
        (["log"], "rhec log had no file"),
        (["export", "folder", "--estimator", "oracle"], "estimator was 'oracle'"),
        (["simulate", "--sed", "1"], "Did you mean --seed? See: rhec simulate --help"),
        (["simulate", "--seed"], "--seed requires an argument"),
        (["simulat"], 'Did you mean "simulate"?'),
    ],
)
def test_a_mistake_gets_one_sentence(capsys, tmp_path, monkeypatch, words, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("rhec: ") and sentence in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda file: file.touch(), []),
        (lambda file: file.symlink_to("nowhere.csv"), ["--overwrite"]),
        (os.mkfifo, ["--overwrite"]),
    ],
    ids=["file", "link to overwrite", "pipe to overwrite"],
)
def test_what_exists_is_kept(capsys, tmp_path, make, words):
    file = tmp_path / "log.csv"
    make(file)
    before = file.lstat()
    assert main(["simulate", *SHORT, "--log", str(file), *words]) == 2
    assert "exists; give another name" in capsys.readouterr().err
    after = file.lstat()
    for name in ("st_ino", "st_mode", "st_size", "st_mtime_ns"):  # it may have been read
        assert getattr(after, name) == getattr(before, name)
    assert [*tmp_path.iterdir()] == [file]


def test_the_notebooks_of_another_checkout_are_not_opened(capsys, tmp_path, monkeypatch):
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks/00_start.ipynb").touch()
    monkeypatch.chdir(tmp_path)
    assert main(["lab"]) == 2
    assert f"not of the checkout {tmp_path}" in capsys.readouterr().err


def test_help_needs_no_utf_8_and_no_reader_that_reads_it_all(tmp_path):
    environment = os.environ | dict(PYTHONIOENCODING="latin-1")
    command = f"{sys.executable} -m rhec simulate --help | head -2"
    options = dict(shell=True, capture_output=True, cwd=tmp_path, env=environment)
    ended = subprocess.run(command, **options)
    assert not ended.stderr and b"Usage: rhec simulate" in ended.stdout


def test_help_has_every_field_that_a_command_takes(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    text = {}
    for name in ("", "simulate", "export"):
        assert main([*filter(None, [name]), "--help"]) == 0
        text[name] = capsys.readouterr().out
    by_use = ["lab", "log", "simulate", "campaign", "export"]
    assert re.findall("^│ ([a-z]+) ", text[""], re.MULTILINE) == by_use
    for field in dataclasses.fields(rhec.Scenario):
        is_object = field.name in ("terrain", "path", "faults", "controller")
        assert (f" --{field.name.replace('_', '-')} " in text["simulate"]) != is_object
    # Of an export, what changes its code alone.
    for option in ("estimator", "q", "turns", "sensors"):
        assert f" --{option} " in text["export"]
    for option in ("mu-mean", "gnss-sigma-m", "seed"):
        assert f" --{option} " not in text["export"]
