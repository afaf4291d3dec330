"""Files of recorded logs as the columns that `rhec.replay` takes: CSV, Parquet, and ROS bags.

A file is data: nothing in it is executed. What was not written in it but found is told, in
`log.attrs["found"]`.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rhec import paper
from rhec.core._casadi.validation import Positive, checked
from rhec.logs.bags import SUFFIXES, read_bag
from rhec.logs.recording import MAX_PERIOD, SECONDS, time_unit

__all__ = ["read"]

_SEPARATORS = dict(zip("\t;|, ", ("tab", "semicolon", "bar", "comma", "space")))
_DIGITS = re.compile(r"\d,\d")
_TIME = re.compile(r"(?:t|time|stamp|timestamp|date_?time)(?:_(s|ms|us|ns))?", re.IGNORECASE)
_MAX_PERIOD_S = MAX_PERIOD * paper.DT_S
_DEGREES = [("latitude", "lat"), ("longitude", "lon", "lng"), ("altitude", "alt")]
# of the ellipsoid, WGS 84
_AXIS_M = 6378137.0
_ECCENTRICITY_2 = 6.69437999014e-3


@checked
def read(
    path: Any,
    *,
    columns: dict[str, str] | None = None,
    topics: tuple[str, ...] | None = None,
    wheel_radius_m: Positive | None = None,
) -> pd.DataFrame:
    """A recorded log from a file, with the columns that `rhec.replay` takes.

    Args:
        path: A .csv or .parquet file, or a bag: .bag (ROS 1), a folder, .db3 or .mcap (ROS 2).
            Found from the data: the separator of a .csv (tab, ; | , or space) and its decimal
            comma; whether the time (column `t_s`, `time`, `timestamp` …) is in s, ms, us, ns or ISO
            8601; `latitude`, `longitude` [deg] in place of `x_m`, `y_m`.
        columns: What a table's columns are called in the file where they have other names, such as
            dict(x_m="east").
        topics: Of a bag: where the position and the speeds of the encoders come from. By default
            each is found by its type: NavSatFix, PoseStamped or Odometry; JointState, TwistStamped
            or (the twist of) Odometry.
        wheel_radius_m: Radius of the wheels [m], which a JointState's speeds [rad/s] need.

    Returns:
        DataFrame. Of a bag: one row for each time stamp in it, sorted, with what was measured then,
        so that nothing is looked ahead at; x_m, y_m and speed_mps, yaw_rate_radps or (JointState)
        v_left_mps, v_right_mps, for which `rhec.replay` takes a track_width_m. Latitude and
        longitude become metres east and north of the first position in the plane that touches WGS
        84 there: lengths are short by 4 mm in 10 km. `.attrs["found"]` says what was found.

    Raises:
        ValueError: For a file that cannot be read, or topics or columns that are not there.
    """
    file = Path(path)
    is_bag = file.suffix in SUFFIXES or (file / "metadata.yaml").is_file()
    if not (is_bag and file.exists() or file.suffix in (".csv", ".parquet") and file.is_file()):
        raise ValueError(
            f"log was {str(file)!r}; it should be an existing .csv, .parquet, "
            f"{', '.join(SUFFIXES)} file or a ROS 2 bag's folder"
        )
    if topics is not None and not is_bag:
        raise ValueError(f"topics was {topics!r}; only a bag has topics, and log was {str(file)!r}")
    try:
        if is_bag:
            log, found = read_bag(file, topics, wheel_radius_m)
        elif file.suffix == ".csv":
            log, found = _read_csv(file)
        else:
            log = pd.read_parquet(file, engine="pyarrow")
            found = {}
    except Exception as error:  # whatever the readers make of a file that is not what its name says
        raise ValueError(f"log was {str(file)!r}, which cannot be read: {error}") from None
    for name, column in (columns or {}).items():
        if column not in log:
            raise ValueError(
                f"columns[{name!r}] was {column!r}; the log has {', '.join(map(str, log))}"
            )
        log[name] = log[column]
    log = _in_metres(_in_seconds(log, found), found)
    log.attrs["found"] = found
    return log


def _read_csv(file):
    """The table in a .csv file, and which separators it has."""
    with file.open(encoding="utf-8-sig") as lines:
        head = [line for line, _ in zip(lines, range(50))]
    separator = next((each for each in _SEPARATORS if head and each in head[0].strip()), ",")
    decimal = "," if separator != "," and any(map(_DIGITS.search, head[1:])) else "."
    table = pd.read_csv(
        file,
        sep=r"\s+" if separator == " " else separator,
        decimal=decimal,
        encoding="utf-8-sig",
        skipinitialspace=True,
    )
    table.columns = [str(name).strip() for name in table]
    return table, dict(
        separator=_SEPARATORS[separator], decimal={",": "comma", ".": "point"}[decimal]
    )


def _in_seconds(log, found):
    """The log with its time in a column t_s [s]; a time in another unit counts from its first."""
    names = sorted((name for name in log if _TIME.fullmatch(str(name))), key=lambda n: n != "t_s")
    if not names:
        return log  # a replay says which columns it lacks
    name = names[0]
    time = log[names[0]]
    numbers = pd.to_numeric(time, errors="coerce")
    if pd.api.types.is_datetime64_any_dtype(time) or numbers.isna().all():
        stamps = pd.to_datetime(time, format="ISO8601", utc=True, errors="coerce")
        t_s = (stamps - stamps.min()).dt.total_seconds()
        unit = "ISO 8601"
    else:
        named = (_TIME.fullmatch(name)[1] or "").lower()
        t = numbers.to_numpy(dtype=float, na_value=np.nan)
        unit, period = time_unit(t, _MAX_PERIOD_S)
        if named and (unit is None or period * SECONDS[named] <= _MAX_PERIOD_S):
            unit = named  # if it can be
        unit = unit or "s"
        # Nanoseconds since 1970 are too many digits for a float: their difference is not.
        t_s = numbers if unit == "s" else (numbers - numbers.min()) * SECONDS[unit]
    found["time"] = f"{unit}, column {name}"
    return log.assign(t_s=t_s)


def _in_metres(log, found):
    """The log with latitude and longitude [deg], where it has no x_m, as x_m east and y_m north of
    the first: geocentric coordinates, turned into the plane that touches the ellipsoid there.
    """
    named = [next((name for name in log if str(name).lower() in names), None) for names in _DEGREES]
    if "x_m" in log or None in named[:2]:
        return log
    phi, turned, height = (
        pd.to_numeric(log[name], errors="coerce").to_numpy(dtype=float) if name else 0 * log.index
        for name in named
    )
    first = np.argmax(np.isfinite(phi + turned))
    found["position"] = (
        f"metres east and north of latitude {phi[first]:.7f}, longitude {turned[first]:.7f}"
    )
    phi = np.deg2rad(phi)
    turned = np.deg2rad(turned - turned[first])
    height = np.nan_to_num(height)
    normal = _AXIS_M / np.sqrt(1 - _ECCENTRICITY_2 * np.sin(phi) ** 2)
    out = (normal + height) * np.cos(phi)  # of the axis of the earth
    up = (normal * (1 - _ECCENTRICITY_2) + height) * np.sin(phi)
    along = out * np.cos(turned) - out[first]  # in the meridian of the first
    north = (up - up[first]) * np.cos(phi[first]) - along * np.sin(phi[first])
    return log.assign(x_m=out * np.sin(turned), y_m=north)
