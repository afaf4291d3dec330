"""The campaign's command: what it refuses, and a table that is whole or stays the old one."""

import pandas as pd

from rhec.cli import main
from rhec.simulation.campaigns import campaign


def run(*arguments):
    """The exit code of the command."""
    return main(["campaign", *map(str, arguments)])


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
