"""How `make calibrate` and the doctor are told to read a log: as `make replay` is."""

import argparse
import json
from collections.abc import Sequence

import pandas as pd

from rhec.logs.reader import read

# Parameters of the replay's notebook.
_NUMBERS = ("wheel_radius_m", "track_width_m", "position_delay_s")
_LISTS = ("columns", "topics")


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the log, and how it is read, to a parser."""
    parser.add_argument("log", help="a .csv, .parquet or bag")
    parser.add_argument(
        "--columns", nargs="+", default=[], metavar="OURS=THEIRS", help="such as x_m=east"
    )
    parser.add_argument("--topics", nargs="+", default=[], help="of the positions and the speeds")
    parser.add_argument("--wheel-radius-m", type=float)
    parser.add_argument("--track-width-m", type=float)
    parser.add_argument(
        "-p",
        nargs=2,
        action="append",
        default=[],
        dest="parameters",
        metavar=("NAME", "VALUE"),
        help='any of these as make replay takes it, such as -p topics \'["/fix", "/odom"]\'',
    )


def parsed(parser: argparse.ArgumentParser, words: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, with the values of -p in their places."""
    given = parser.parse_args(words)
    names = [name for name in (*_LISTS, *_NUMBERS, "trust_log") if hasattr(given, name)]
    for name, text in given.parameters:
        if name not in names:
            parser.error(f"-p {name}: it should be one of {', '.join(names)}")
        setattr(given, name, _value(parser, name, text))
    return given


def _value(parser, name, text):
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = text
    if name in _LISTS and (isinstance(value, str) or _is_texts(value)):
        return [value] if isinstance(value, str) else value
    if name in _NUMBERS and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) or (0.0 if name == "position_delay_s" else None)
    if name == "trust_log" and isinstance(value, bool):
        return value
    kind = (
        "a list of texts" if name in _LISTS else "a number" if name in _NUMBERS else "true, false"
    )
    return parser.error(f"-p {name} was {text}; it should be {kind}")


def _is_texts(value):
    return isinstance(value, list) and all(isinstance(entry, str) for entry in value)


def read_given(given: argparse.Namespace) -> pd.DataFrame:
    """The log of a command line.

    Raises:
        ValueError: As `rhec.logs.read`.
    """
    names = dict(pair.partition("=")[::2] for pair in given.columns)
    topics = tuple(given.topics) or None
    radius_m = given.wheel_radius_m
    return read(given.log, columns=names or None, topics=topics, wheel_radius_m=radius_m)


def found_lines(log: pd.DataFrame) -> list[str]:
    """What the reader inferred, such as topics, unit of time and origin, as lines of text."""
    inferred = log.attrs.get("inferred", {})
    return [f"found {name}: {value}" for name, value in inferred.items()]
