"""Recordings are fetched from where they are published, as they were, and read as data."""

import functools
import hashlib
import http.server
import pickle
import re
import threading

import fetch_recordings
import numpy as np
import pandas as pd
import pytest

FRAME = pd.DataFrame(dict(t_ns=np.arange(5) * 50_000_000, left=np.linspace(0, 1, 5)))
FRAME.columns = pd.Index(["t_ns", "left"], dtype=object)  # as older pandas wrote names


@pytest.fixture
def server(tmp_path):
    """A host that publishes a small frame, and the table that says so."""
    file = tmp_path / "served" / "someone" / "robots" / "c0ffee" / "to add" / "frame.pkl"
    file.parent.mkdir(parents=True)
    FRAME.to_pickle(file)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    source = dict(repository="someone/robots", commit="c0ffee", path="to add/frame.pkl")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=tmp_path / "served")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}", dict(small=source | dict(sha256=digest))
        running.shutdown()


def test_a_recording_is_fetched_once_and_read(server, tmp_path):
    host, table = server
    file = fetch_recordings.fetch("small", tmp_path / "here", host, table)
    pd.testing.assert_frame_equal(fetch_recordings.read_frame(file), FRAME)
    again = fetch_recordings.fetch("small", tmp_path / "here", "http://127.0.0.1:1", table)
    assert again == file


def test_a_wrong_digest_is_refused(server, tmp_path):
    host, table = server
    table["small"]["sha256"] = "0" * 64
    with pytest.raises(ValueError, match="hash"):
        fetch_recordings.fetch("small", tmp_path / "here", host, table)
    assert not list((tmp_path / "here").iterdir())


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was run",))


@pytest.mark.parametrize("bad", [Bomb(), pd.DataFrame(dict(a=[Bomb()])), [print], re.compile("a")])
def test_nothing_but_a_frame_of_numbers_is_unpickled(tmp_path, bad):
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps(bad))
    with pytest.raises(ValueError, match="the pickle asks for"):
        fetch_recordings.read_frame(tmp_path / "bad.pkl")


def test_a_pickle_of_something_else_is_refused(tmp_path):
    (tmp_path / "list.pkl").write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(ValueError, match="has a list"):
        fetch_recordings.read_frame(tmp_path / "list.pkl")


def test_each_source_is_whole():
    wanted = {"repository", "commit", "path", "sha256", "licence", "citation", "robot"}
    for source in fetch_recordings.RECORDINGS.values():
        assert set(source) == wanted
        assert re.fullmatch("[0-9a-f]{40}", source["commit"])
        assert re.fullmatch("[0-9a-f]{64}", source["sha256"])
