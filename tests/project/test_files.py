"""Every file that is written is whole or not there, whoever else writes to the same folder."""

import contextlib
import errno
import io
import os
import shutil
import stat
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import rhec
from rhec import embedded, files, style
from rhec.cli import main
from rhec.files import replacing
from rhec.logs.outputs import write_estimates


def test_a_file_is_replaced_once_it_is_whole(tmp_path):
    file = tmp_path / "log.csv"
    file.write_bytes(b"old")
    with replacing(file) as unfinished, replacing(file) as other:  # of another process
        unfinished.write(b"new")
        other.write(b"newer")
        other.flush()
        assert file.read_bytes() == b"old"
    assert file.read_bytes() == b"new" and list(tmp_path.iterdir()) == [file]
    # Others may read it where they may read what the user writes.
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(file.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
TABLE = pd.DataFrame(
    dict.fromkeys("t_s x_hat_m y_hat_m theta_hat_rad x_meas_m y_meas_m".split(), [1.0])
)
CAMPAIGN = "campaign -p duration_s 2 --seeds 1 --workers 1 --folder".split()


def by_command(*words):
    """Raise what `rhec` was ended by, of which it says one line."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        code = main([*map(str, words)])
    if code:
        assert said.getvalue().startswith("rhec: ") and said.getvalue().count("\n") == 1
        raise {1: FULL, 130: KeyboardInterrupt}[code]


# What writes files, given a folder and which version of them.
WRITERS = {
    "figure": lambda to, n: style.save(Figure(figsize=(n, 1)), "one", folder=to),
    "table": lambda to, n: style.save_table(n * TABLE, "one", "One", folder=to),
    "soil": lambda to, n: rhec.Terrain.uniform(0.9, 0.8 / n).save(to / "soil.npz"),
    "export": lambda to, n: embedded._write(to, {"a.h": 20_000 * f"{n}", "a.c": f"{n}"}),
    "estimates": lambda to, n: write_estimates(n * TABLE, to),
    "run": lambda to, n: by_command(
        *f"simulate --duration-s 2 --seed {n} --overwrite".split(),
        *("--log", to / "run.csv", "--plot", to / "run.png"),
    ),
    "campaign": lambda to, n: by_command(*CAMPAIGN, to, "-p", "r", n),
}


@contextlib.contextmanager
def disk(fails_at=np.inf, error=None):
    """A context with a disk whose operation of this number fails, and on a full one all later."""
    done = []

    def operate(file=None):
        done.append(file)
        if len(done) == fails_at or len(done) > fails_at and error is FULL:
            raise error

    class Raw(io.FileIO):
        def write(self, content):
            operate()
            return super().write(content)

    def opened(file, mode):
        operate()
        return io.BufferedWriter(Raw(file, mode))

    def replace(self, file, replaced=Path.replace):
        operate(file)
        return replaced(self, file)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "open", opened, raising=False)
        patch.setattr(Path, "replace", replace)
        yield done


def contents(folder):
    return {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.*")}


@pytest.mark.parametrize("what", WRITERS)
def test_where_writing_fails_each_file_is_the_old_or_the_new_one(what, tmp_path, monkeypatch):
    """Whichever operation it is, on a full disk or by Ctrl-C; the next call writes all of it."""
    monkeypatch.setattr(rhec.Run, "plot", lambda run: Figure(figsize=(run.scenario.seed, 1)))
    write, versions = WRITERS[what], []
    for n in (1, 2):
        folder = tmp_path / f"{n}"
        folder.mkdir()
        with disk() as done:
            write(folder, n)
        versions.append(contents(folder))
    old, new = versions
    assert {folder / file for file in new} <= {*done}  # nothing is written in another way
    assert all(old.get(file) != content for file, content in new.items())
    for place, fails_at in enumerate({*np.linspace(1, len(done), 4).astype(int)}):
        folder = tmp_path / f"fails at {fails_at}"
        shutil.copytree(tmp_path / "1", folder)
        error = (FULL, KeyboardInterrupt)[place % 2]
        with disk(fails_at, error), pytest.raises((OSError, KeyboardInterrupt)):
            write(folder, 2)
        found = contents(folder)
        assert not [file for file in found if file.name.startswith(files.UNFINISHED)]
        for file in old | new:
            assert found.get(file) in (old.get(file), new.get(file)), (file, fails_at)
        write(folder, 2)
        assert contents(folder).items() >= new.items()


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
