"""Rows of finished runs in Parquet files, keyed by scenario.

Rows are valid only for the code, versions and machine that computed them, their provenance. Each
provenance therefore has a separate folder, named by a digest.
"""

import functools
import hashlib
import importlib.metadata
import json
import platform
import warnings
from array import array
from dataclasses import fields, is_dataclass

import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.validation import shown
from rhec.core.own_step import OwnStep
from rhec.files import replacing
from rhec.simulation.campaigns.optional import optional
from rhec.simulation.metrics import METRICS
from rhec.tracked_robot import terrain

# Types of nearly all parameters of a scenario; their repr is exact to the last bit.
PLAIN = {bool, int, float, str, tuple, type(None)}
# {name of a metric: its type}
TYPES = {name: int if unit == "samples" else float for name, (unit, _) in METRICS.items()}
TYPES |= dict(solver_ok=bool)


def provenance():
    """Return {name: value} of everything that affects the numbers of a run except the scenario."""
    return _installed() | {
        "C compiler": bool(compiled.compiler()),
        "machine": platform.machine(),
        "C library": " ".join(platform.libc_ver()),
        "vector instructions": " ".join(sorted(compiled.vector_instructions())),
    }


@functools.cache
def _installed():
    versions = {name: importlib.metadata.version(name) for name in ("casadi", "numpy", "scipy")}
    return versions | {
        "source of rhec": compiled.source_digest(),
        "data of rhec": hashlib.sha256(terrain.STANDARD_FIELDS.read_bytes()).hexdigest(),
    }


def scenario_key(scenario):
    """Return a digest of the scenario, including every bit of its terrain."""
    return hashlib.sha256(_canonical_text(scenario).encode()).hexdigest()[:32]


def _canonical_text(value):
    """Return a text that is unique for a value."""
    if isinstance(value, OwnStep):
        return _digest_of_step(value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if is_dataclass(value):
        texts = {}
        for field in fields(value):
            entry = getattr(value, field.name)
            texts[field.name] = entry if type(entry) in PLAIN else _canonical_text(entry)
        return repr(texts)
    return repr(value)


@functools.lru_cache  # scenarios share it, and the text of a Function has up to a megabyte
def _digest_of_step(own_step):
    """Return a digest of all that tells an OwnStep from others."""
    return hashlib.sha256(repr(own_step.identity).encode()).hexdigest()


def failed_row(error):
    """Return the row of a failed run: its metrics are NaN or False."""
    row = {name: False if kind is bool else np.nan for name, kind in TYPES.items()}
    return row | dict(error=error)


class Rows:
    """Rows of runs by key, in an array: 0.3 kB a run, where a dict for each would take 2 kB.

    A campaign of 100,000 runs keeps all of them until it returns its table.
    """

    def __init__(self, readings=()):
        self._types = TYPES | dict.fromkeys(readings, float)
        self._places = {}  # {key: place of its row}
        self._metrics = array("d")  # row after row
        self._errors = {}  # {place: reason} of failed runs

    def __contains__(self, key):
        return key in self._places

    def add(self, rows):
        """Add {key: row}; a row that is there already is replaced.

        Such a row is from a folder, in which there are only rows without errors.
        """
        for key, row in rows.items():
            place = self._places.setdefault(key, len(self._places))
            if row["error"]:
                self._errors[place] = row["error"]
            begin = place * len(self._types)  # the end of the array, if the row is new
            values = array("d", [row.get(name, np.nan) for name in self._types])
            self._metrics[begin : begin + len(values)] = values

    def places(self, keys):
        """Return where the rows of these keys are, (n,), and forget all keys."""
        places = np.fromiter((self._places[key] for key in keys), dtype=int, count=len(keys))
        self._places = {}
        return places

    def take(self, places):
        """Return {name: values (n,)} at these places: metrics with their types, readings, and
        `error`.

        A whole number of a failed run is NaN, which makes its column one of floats. The rows are
        gone after that, so that no campaign holds all of them twice.
        """
        columns = {}
        table = np.frombuffer(self._metrics).reshape(-1, len(self._types))[places]
        self._metrics = array("d")
        for values, (name, kind) in zip(table.T, self._types.items()):
            columns[name] = values.astype(kind, copy=False) if np.isfinite(values).all() else values
        return columns | dict(error=[self._errors.get(place, "") for place in places])


def open_folder(folder):
    """Create and return the folder of this provenance.

    Raises:
        ValueError: If the path is a file.
        ImportError: If pyarrow is not installed.
    """
    optional("pyarrow", f"folder={str(folder)!r}")
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder was {str(folder)!r}; that is a file, it should be a folder")
    folder = folder / hashlib.sha256(json.dumps(provenance()).encode()).hexdigest()
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@functools.cache
def _schema():
    """Return the schema of a file: the key, and the metrics with their types."""
    import pyarrow as pa

    types = {bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
    columns = dict(key=pa.string()) | {name: types[kind] for name, kind in TYPES.items()}
    return pa.schema([pa.field(name, of, nullable=False) for name, of in columns.items()])


def save_rows(folder, rows):
    """Write the rows without errors to a new file, which is complete or does not exist."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = {key: row for key, row in rows.items() if not row["error"]}
    if not rows:
        return
    table = pa.Table.from_pylist([dict(key=key) | row for key, row in rows.items()], _schema())
    name = hashlib.sha256("".join(rows).encode()).hexdigest()
    with replacing(folder / f"{name}.parquet") as unfinished:
        pq.write_table(table, unfinished, write_page_checksum=True)


def load_rows(folder, wanted=None):
    """Yield {key: row} of each file in the folder; warn about damaged files and skip them.

    wanted: Set of keys; other rows are left out, and files without any of these are hardly read.
    """
    import pyarrow as pa

    for file in sorted(folder.glob("*.parquet")):
        try:
            table = _read_table(file, wanted)
        except (pa.ArrowException, OSError, ValueError) as error:
            reason = f"{type(error).__name__}: {shown(str(error))}"
            warnings.warn(
                f"{file} cannot be read ({reason}), so its runs are repeated", stacklevel=3
            )
            continue
        yield {row.pop("key"): row | dict(error="") for row in table.to_pylist()}


def _read_table(file, wanted):
    """Return the Arrow table of a file, with the rows of these keys or, for None, with all rows."""
    import pyarrow.parquet as pq

    if not file.is_file():  # reading a pipe would wait for ever
        raise OSError("it is no file")
    with pq.ParquetFile(file, page_checksum_verification=True) as parquet:
        names = _schema().names
        if wanted is None:
            return parquet.read(names).cast(_schema())
        chosen = [key in wanted for key in parquet.read(["key"])["key"].to_pylist()]
        if not any(chosen):
            return _schema().empty_table()
        return parquet.read(names).cast(_schema()).filter(chosen)
