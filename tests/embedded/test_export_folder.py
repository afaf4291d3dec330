"""Where an export may go."""

import re
import resource

import pytest

from rhec import embedded


@pytest.fixture
def texts(monkeypatch):
    """An export takes a moment: only its files matter here."""
    texts = {embedded._MARK: "mark", "rhec.c": "code", "README.txt": "text"}
    monkeypatch.setattr(embedded, "_check", lambda *_: None)
    monkeypatch.setattr(embedded, "_of_scenario", lambda *_: texts)
    return texts


def test_nothing_is_written_but_an_earlier_export(tmp_path, texts):
    """The folder may be the root of another file system."""
    folder = tmp_path / "mounted"
    folder.mkdir()
    (folder / "lost+found").mkdir()
    for text in ("code", "newer"):
        texts["rhec.c"] = text
        assert embedded.export(None, str(folder)) == folder
        assert (folder / "rhec.c").read_text() == text
    assert {file.name for file in folder.iterdir()} == {*texts, "lost+found"}
    assert [*tmp_path.iterdir()] == [folder]


def test_an_interrupted_export_can_be_repeated(tmp_path, texts):
    (tmp_path / ".unfinished-abc").touch()
    embedded.export(None, tmp_path)
    assert (tmp_path / "rhec.c").read_text() == "code"


def test_a_disk_that_is_full_leaves_an_earlier_export_as_it_was(tmp_path, texts):
    """It is full at a file behind the first one."""
    embedded.export(None, tmp_path)
    texts |= {embedded._MARK: "newer", "rhec.c": 100 * "newer"}
    largest = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, largest[1]))
    try:
        with pytest.raises(OSError):
            embedded.export(None, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, largest)
    assert (tmp_path / embedded._MARK).read_text() == "mark"
    assert {file.name for file in tmp_path.iterdir()} == {*texts}


def test_a_folder_called_like_a_file_is_refused_before_anything_is_replaced(tmp_path, texts):
    embedded.export(None, tmp_path)
    (tmp_path / "README.txt").unlink()
    (tmp_path / "README.txt").mkdir()
    texts["rhec.c"] = "newer"
    sentence = f"folder was {str(tmp_path)!r}, in which README.txt is a folder"
    with pytest.raises(ValueError, match=re.escape(sentence)):
        embedded.export(None, tmp_path)
    assert (tmp_path / "rhec.c").read_text() == "code"
