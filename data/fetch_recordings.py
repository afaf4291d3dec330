"""Fetch the recordings of data/recordings.toml into data/recordings/, and convert them to logs.

`python data/fetch_recordings.py [HOST]` fetches the files that are missing and writes a .csv beside
each. They are pickled pandas frames, and a pickle can run code when it is loaded. Therefore a file
with another digest is refused, and only the classes of a frame of numbers may be unpickled.
"""

import hashlib
import re
import sys
import tomllib
from pathlib import Path
from urllib.parse import quote

import pandas as pd
import requests
from convert_recordings import convert
from pandas.compat.pickle_compat import Unpickler

__all__ = ["FOLDER", "RECORDINGS", "fetch", "main", "read_frame"]

FOLDER = Path(__file__).with_name("recordings")
RECORDINGS = tomllib.loads(Path(__file__).with_name("recordings.toml").read_text("utf-8"))
_NEEDED = {"repository", "commit", "path", "sha256"}
_MOST_BYTES = 200_000_000  # the largest recording has a few tens of megabytes
_HOST = "https://raw.githubusercontent.com"
# What a pickled frame of numbers consists of, also one by an older pandas: {module: names}.
_ADMITTED = {
    "builtins": ["slice"],
    "functools": ["partial"],
    "numpy": ["ndarray", "dtype"],
    "numpy.core.multiarray": ["_reconstruct", "scalar"],
    "numpy._core.multiarray": ["_reconstruct", "scalar"],
    "numpy.core.numeric": ["_frombuffer"],
    "numpy._core.numeric": ["_frombuffer"],
    "pandas": ["DataFrame", "Index", "RangeIndex", "Series"],
    "pandas._libs.internals": ["_unpickle_block"],
    "pandas.core.frame": ["DataFrame"],
    "pandas.core.indexes.base": ["_new_Index", "Index"],
    "pandas.core.indexes.numeric": ["Int64Index", "Float64Index"],
    "pandas.core.indexes.range": ["RangeIndex"],
    "pandas.core.internals.blocks": ["new_block"],
    "pandas.core.internals.managers": ["BlockManager"],
    "pandas.core.series": ["Series"],
}


class _OnlyFrames(Unpickler):
    """Unpickles frames of numbers and nothing else."""

    def find_class(self, module, name):
        if name not in _ADMITTED.get(module, []):
            raise ValueError(f"the pickle asks for {module}.{name}; a frame of numbers has none")
        return super().find_class(module, name)


def fetch(name, folder=FOLDER, host=_HOST, recordings=RECORDINGS):
    """Fetch a recording's file if it is not there.

    Args:
        name: Of the recording.
        folder: Path of the folder for the file.
        host: Address from which files of repositories are fetched.
        recordings: {name: its table in recordings.toml}.

    Returns:
        Path of the file.

    Raises:
        ValueError: If its digest is not that of recordings.toml, if it is larger than any
            recording, or if its table lacks an entry.
    """
    source = recordings[name]
    if not source.keys() >= _NEEDED or not re.fullmatch(r"[\w-]+", name):
        raise ValueError(f"its table should have a plain name and {', '.join(sorted(_NEEDED))}")
    # A commit, not a branch: the file cannot change under this address.
    url = f"{host}/{source['repository']}/{source['commit']}/{quote(source['path'])}"
    file = Path(folder, f"{name}.pkl")
    file.parent.mkdir(parents=True, exist_ok=True)
    if file.exists() and _digest(file.read_bytes()) == source["sha256"]:
        return file
    content = _downloaded(url)
    if _digest(content) != source["sha256"]:
        raise ValueError(f"{url} has the hash {_digest(content)}; it should be {source['sha256']}")
    file.write_bytes(content)
    return file


def _digest(content):
    return hashlib.sha256(content).hexdigest()


def _downloaded(url):
    """What is there, but no more than a recording has."""
    content = bytearray()
    with requests.get(url, stream=True, timeout=30) as answer:
        answer.raise_for_status()
        for piece in answer.iter_content(1 << 16):
            content += piece
            if len(content) > _MOST_BYTES:
                raise ValueError(f"{url} has more than {_MOST_BYTES} bytes")
    return content


def read_frame(file):
    """The pandas frame of numbers in a pickle.

    Raises:
        ValueError: If the pickle has anything else in it.
    """
    try:
        with open(file, "rb") as opened:
            frame = _OnlyFrames(opened).load()
    except (OSError, ValueError):
        raise
    except Exception as error:  # any error that a broken pickle may raise
        raise ValueError(f"{Path(file).name} is no pickle ({type(error).__name__})") from None
    if not isinstance(frame, pd.DataFrame):
        raise ValueError(f"{Path(file).name} has a {type(frame).__name__}; it should have a frame")
    return frame


def main(host=_HOST, folder=FOLDER, recordings=RECORDINGS):
    """Fetch and convert every recording but those with not_run; the arguments are `fetch`'s.

    Raises:
        SystemExit: With a sentence, if a recording cannot be fetched or converted.
    """
    for name, source in recordings.items():
        if "not_run" in source:
            print(f"{name}: not fetched, {source['not_run']}")
            continue
        try:
            file = fetch(name, folder, host, recordings)
            log = convert(read_frame(file), source)
        except (OSError, ValueError) as error:
            sys.exit(f"{name}: {error}")
        log.to_csv(file.with_suffix(".csv"), index=False)
        print(f"{file.with_suffix('.csv')}: {len(log)} rows, {source['citation']}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
