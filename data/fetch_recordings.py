"""Fetch the recordings of data/recordings.toml into data/recordings/, and make logs of them.

They are pickled pandas frames, and a pickle can run code when it is loaded: a file with another
digest is refused, and reading admits a list of classes and nothing else. `python
data/fetch_recordings.py [HOST]` fetches what is not there and writes a .csv beside each file.
"""

import sys
import tomllib
from pathlib import Path
from urllib.parse import quote

import pandas as pd
import pooch
from convert_recordings import convert
from pandas.compat.pickle_compat import Unpickler

__all__ = ["FOLDER", "RECORDINGS", "fetch", "main", "read_frame"]

FOLDER = Path(__file__).with_name("recordings")
RECORDINGS = tomllib.loads(Path(__file__).with_name("recordings.toml").read_text("utf-8"))
_HOST = "https://raw.githubusercontent.com"
_ADMITTED = {
    "builtins": "slice",
    "functools": "partial",
    "numpy": "ndarray dtype",
    "numpy.core.multiarray": "_reconstruct scalar",
    "numpy._core.multiarray": "_reconstruct scalar",
    "numpy.core.numeric": "_frombuffer",
    "numpy._core.numeric": "_frombuffer",
    "pandas": "DataFrame Index RangeIndex Series",
    "pandas._libs.internals": "_unpickle_block",
    "pandas.core.frame": "DataFrame",
    "pandas.core.indexes.base": "_new_Index Index",
    "pandas.core.indexes.numeric": "Int64Index Float64Index",
    "pandas.core.indexes.range": "RangeIndex",
    "pandas.core.internals.blocks": "new_block",
    "pandas.core.internals.managers": "BlockManager",
    "pandas.core.series": "Series",
}


class _OnlyFrames(Unpickler):
    """Reads frames of numbers, also of older pandas."""

    def find_class(self, module, name):
        if name not in _ADMITTED.get(module, "").split():
            raise ValueError(f"the pickle asks for {module}.{name}; a frame of numbers has none")
        return super().find_class(module, name)


def fetch(name, folder=FOLDER, host=_HOST, recordings=RECORDINGS):
    """Path of a recording's file, fetched if it is not there.

    Raises:
        ValueError: where its digest is not the one of recordings.toml; nothing is kept.
    """
    source = recordings[name]
    url = f"{host}/{source['repository']}/{source['commit']}/{quote(source['path'])}"
    known = f"sha256:{source['sha256']}"
    return Path(pooch.retrieve(url, known, fname=f"{name}.pkl", path=folder))


def read_frame(file):
    """The pandas frame in a pickle that has nothing else in it."""
    with open(file, "rb") as opened:
        frame = _OnlyFrames(opened).load()
    if not isinstance(frame, pd.DataFrame):
        raise ValueError(f"{Path(file).name} has a {type(frame).__name__}; it should have a frame")
    return frame


def main(host=_HOST, folder=FOLDER, recordings=RECORDINGS):
    """Fetch and convert every recording.

    Raises:
        SystemExit: with a sentence, for one that cannot be fetched or is not what it should be.
    """
    for name, source in recordings.items():
        try:
            file = fetch(name, folder, host, recordings)
            log = convert(read_frame(file), source)
        except (OSError, ValueError) as error:
            sys.exit(f"{name}: {error}")
        log.to_csv(file.with_suffix(".csv"), index=False)
        print(f"{file.with_suffix('.csv')}: {len(log)} rows, {source['citation']}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
