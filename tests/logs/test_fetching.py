"""Recordings from a hostile host, or by a wrong list."""

import fetch_recordings
import pytest
from test_recordings import FRAME, published


def test_no_more_is_downloaded_than_a_recording_has(tmp_path, monkeypatch):
    monkeypatch.setattr(fetch_recordings, "_MOST_BYTES", 100)
    refused = pytest.raises(ValueError, match="more than 100 bytes")
    with published(FRAME, tmp_path) as (host, table), refused:
        fetch_recordings.fetch("small", tmp_path / "here", host, table)
    assert not list((tmp_path / "here").iterdir())


@pytest.mark.parametrize("name", ["../outside", "/tmp/outside"])
def test_a_name_is_no_path(tmp_path, name):
    table = {name: dict.fromkeys(fetch_recordings._NEEDED, "x")}
    with pytest.raises(ValueError, match="plain name"):
        fetch_recordings.fetch(name, tmp_path, "http://127.0.0.1:1", table)


def test_a_list_without_a_digest_ends_in_a_sentence(tmp_path):
    table = dict(small=dict(repository="r", commit="c", path="p", citation="by hand"))
    with pytest.raises(SystemExit, match="small: its table should have"):
        fetch_recordings.main("http://127.0.0.1:1", tmp_path, table)


def test_what_is_no_pickle_ends_in_a_sentence(tmp_path, monkeypatch):
    file = tmp_path / "small.pkl"
    file.write_bytes(b"no pickle")
    monkeypatch.setattr(fetch_recordings, "fetch", lambda *arguments: file)
    with pytest.raises(SystemExit, match="small: "):
        fetch_recordings.main(recordings=dict(small={}))
