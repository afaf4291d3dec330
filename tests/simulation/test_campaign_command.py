"""The campaign's command: what it refuses, and a table that is whole or stays the old one."""

import pandas as pd
import pytest

from rhec.cli import main
from rhec.simulation.campaigns import campaign, workers


def run(*arguments):
    """The exit code of the command."""
    return main(["campaign", *map(str, arguments)])


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (["--seeds", -5], "--seeds was -5; it should be at least 1"),
        (["-p", "q"], "-p q had no value; it should have at least one"),
        (["-p", "q", "[" * 100_000], "q"),
    ],
)
def test_what_gives_no_run_is_refused(capsys, tmp_path, arguments, sentence):
    assert run("--folder", tmp_path, *arguments) == 2
    message = capsys.readouterr().err
    assert sentence in message and message.count("\n") == 1


def test_a_full_disk_leaves_the_old_table(monkeypatch, capsys, tmp_path):
    table = tmp_path / "campaign.parquet"
    table.write_text("the old table")

    def full(frame, file):
        file.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(campaign, "campaign", lambda *arguments: pd.DataFrame(dict(error=[""])))
    monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
    assert run("--folder", tmp_path) == 1
    assert capsys.readouterr().err == "rhec: [Errno 28] No space left on device\n"
    assert table.read_text() == "the old table"
    assert [file.name for file in tmp_path.iterdir()] == ["campaign.parquet"]


@pytest.mark.parametrize("wanted", ["0", "²", "-1", "many", ""])
def test_a_count_of_cores_that_is_none_takes_all(monkeypatch, wanted):
    import loky

    monkeypatch.setenv("PYTHON_CPU_COUNT", wanted)
    assert workers._count_cores() == loky.cpu_count()
