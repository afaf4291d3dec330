"""Rows on disk: Parquet files in a folder for each provenance, keyed by scenario."""

import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import warnings
from dataclasses import fields, is_dataclass

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.validation import optional, shown
from rhec.simulation import closed_loop
from rhec.tracked_robot import terrain

__all__ = [
    "PLAIN",
    "cache_folder",
    "failed_row",
    "load_rows",
    "provenance",
    "save_rows",
    "scenario_key",
]

PLAIN = {bool, int, float, str, tuple, type(None)}  # nearly all of a scenario: repr says it whole


def provenance():
    """Return what decides a run's numbers beside its scenario, as {name: value}."""
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
        "source of rhec": compiled.source_digest()[:16],
        "data of rhec": hashlib.sha256(terrain.STANDARD_FIELDS.read_bytes()).hexdigest()[:16],
    }


def scenario_key(scenario):
    """A digest of the scenario, down to the last bit of its terrain."""
    return hashlib.sha256(_canonical_text(scenario).encode()).hexdigest()[:32]


def _canonical_text(value):
    """A value as text that no other value has."""
    if isinstance(value, ca.Function):
        return value.serialize()
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if is_dataclass(value):
        named = ((name, getattr(value, name)) for name in _field_names(type(value)))
        return repr({k: v if type(v) in PLAIN else _canonical_text(v) for k, v in named})
    return repr(value)


@functools.cache
def _field_names(kind):
    return [field.name for field in fields(kind)]


@functools.cache
def _metrics():
    """Some run's metrics: their names and types."""
    numbers = dict.fromkeys((*closed_loop.COLUMNS, "t_s", "error_m", "error_true_m"), np.zeros(1))
    flags = dict.fromkeys(("ok", "on_straight"), np.zeros(1, bool))
    return closed_loop.metrics(numbers | flags, np.zeros((1, 3)))


def failed_row(error):
    """The row of a run that failed for this reason: each metric is NaN, or False."""
    some = _metrics().items()
    none = {name: False if isinstance(each, bool) else np.nan for name, each in some}
    return none | dict(error=error)


def cache_folder(folder):
    """Make and return the folder for rows of this provenance."""
    optional("pyarrow", f"folder={str(folder)!r}")
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder was {str(folder)!r}; that is a file, it should be a folder")
    folder = folder / hashlib.sha256(json.dumps(provenance()).encode()).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@functools.cache
def _schema():
    import pyarrow as pa

    types = {bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
    return pa.schema(
        dict(key=pa.string()) | {name: types[type(each)] for name, each in _metrics().items()}
    )


def _seal(table):
    """Metadata that a file of these rows must have: what made them, and a digest of both."""
    made_by = json.dumps(provenance())
    rows = json.dumps([table.column_names, table.to_pylist()])
    digest = hashlib.sha256(f"{made_by}{rows}".encode()).hexdigest()
    return dict(made_by=made_by, digest=digest)


def save_rows(folder, rows):
    """Write the rows without error as one more file, which is there as a whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = {key: row for key, row in rows.items() if not row["error"]}
    if not rows:
        return
    table = pa.Table.from_pylist([dict(key=key) | row for key, row in rows.items()], _schema())
    table = table.replace_schema_metadata(_seal(table))
    name = hashlib.sha256("".join(rows).encode()).hexdigest()[:32]
    unfinished = folder / f"{name}.{os.getpid()}.unfinished"
    try:
        pq.write_table(table, unfinished, write_page_checksum=True)
        os.replace(unfinished, folder / f"{name}.parquet")
    finally:
        unfinished.unlink(missing_ok=True)


def load_rows(folder):
    """Read {key: row} from all files in the folder that are sound, with a warning for others.

    Sound is what `save_rows` wrote with this provenance and nobody changed, unless to deceive.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = _schema().names
    rows = {}
    for file in sorted(folder.glob("*.parquet")):
        try:
            with pq.ParquetFile(file, page_checksum_verification=True) as parquet:
                table = parquet.read(names).select(names).cast(_schema())
                metadata = parquet.schema_arrow.metadata or {}
            if any(
                metadata.get(name.encode()) != seal.encode() for name, seal in _seal(table).items()
            ):
                raise ValueError("not as it was written here")
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            why = f"{file} cannot be read ({type(error).__name__}: {shown(str(error))})"
            warnings.warn(f"{why}, so its runs are done again", stacklevel=3)
            continue
        rows |= {row.pop("key"): row | dict(error="") for row in table.to_pylist()}
    return rows
