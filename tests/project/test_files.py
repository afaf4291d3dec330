"""Every file that is written is whole or not there, whoever else writes to the same folder."""

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from rhec import style
from rhec.files import replacing
from rhec.simulation.campaigns import store

ROOT = Path(__file__).parents[2]
# Writes its letter into a file, again and again.
WRITER = """
import sys
from rhec.files import replacing

for _ in range(100):
    with replacing(sys.argv[1]) as file:
        file.write(sys.argv[2].encode() * 100_000)
        file.write(sys.argv[2].encode() * 100_000)
"""


def test_a_file_is_replaced_once_it_is_whole(tmp_path):
    file = tmp_path / "log.csv"
    file.write_bytes(b"old")
    with replacing(file) as unfinished:
        unfinished.write(b"new")
        unfinished.flush()
        assert file.read_bytes() == b"old"
    assert file.read_bytes() == b"new" and list(tmp_path.iterdir()) == [file]
    # Others may read it where they may read what the user writes.
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(file.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


TABLE = pd.DataFrame(dict(a=[1.0]))
# What is written: the library's function that fails in the middle of it, and the call.
WRITTEN = {
    "figure": (Figure, "savefig", lambda folder: style.save(Figure(), "one", folder=folder)),
    "table": (pd.DataFrame, "to_csv", lambda folder: style.save_table(TABLE, "one", "One", folder)),
    "rows": (pq, "write_table", lambda folder: store.save_rows(folder, {"a": dict(error="")})),
}


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("what", WRITTEN)
def test_whatever_is_written_leaves_the_old_one_if_it_fails(what, error, tmp_path, monkeypatch):
    owner, writer, save = WRITTEN[what]
    save(tmp_path)
    whole = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def failing(*given, **options):
        (file,) = [each for each in given if hasattr(each, "write")]
        file.write(b"half")
        raise error

    monkeypatch.setattr(owner, writer, failing)
    with pytest.raises(error):
        save(tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == whole != {}


def test_an_error_names_the_file(tmp_path):
    file = tmp_path / "log.csv"
    full = f"[Errno {errno.ENOSPC}] {os.strerror(errno.ENOSPC)}: {str(file)!r}"
    with pytest.raises(OSError) as refusal, replacing(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert str(refusal.value) == full
    with pytest.raises(FileNotFoundError) as refusal, replacing(tmp_path / "none/log.csv"):
        pass
    assert refusal.value.filename == str(tmp_path / "none/log.csv")
    file.mkdir()
    with pytest.raises(IsADirectoryError) as refusal, replacing(file) as unfinished:
        unfinished.write(b"a file")
    assert refusal.value.filename == str(file)


def test_nothing_that_others_put_beside_it_is_written_to(tmp_path):
    """A link of the name that rhec once used, and one in place of the unfinished file."""
    precious = tmp_path / "precious"
    precious.write_bytes(b"precious")
    folder = tmp_path / "shared"
    folder.mkdir()
    file = folder / "log.csv"
    (folder / "log.csv.unfinished").symlink_to(precious)
    file.symlink_to(precious)
    with replacing(file) as unfinished:
        (name,) = {*folder.iterdir()} - {file, folder / "log.csv.unfinished"}
        name.unlink()
        name.symlink_to(precious)
        unfinished.write(b"estimates")
    assert precious.read_bytes() == b"precious"


def test_what_several_processes_write_to_one_file_is_whole(tmp_path):
    file = tmp_path / "log.csv"
    file.write_bytes(bytes(200_000))
    commands = [[sys.executable, "-c", WRITER, str(file), letter] for letter in "abc"]
    writers = [subprocess.Popen(command, cwd=ROOT) for command in commands]
    reads = 0
    while any(writer.poll() is None for writer in writers):
        content = file.read_bytes()
        assert len(content) == 200_000 and len({*content}) == 1
        reads += 1
    assert reads > 3 and [writer.returncode for writer in writers] == [0, 0, 0]
    assert list(tmp_path.iterdir()) == [file]
