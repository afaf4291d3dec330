"""Reads recorded logs (CSV, Parquet, ROS bags) into the columns that `rhec.replay` takes.

No content of a file is executed. `log.attrs["inferred"]` lists what the reader inferred.
"""

import codecs
import itertools
import re
import warnings
from pathlib import Path
from textwrap import shorten
from typing import Any
from unicodedata import category

import numpy as np
import pandas as pd

from rhec import paper
from rhec.core._casadi.validation import Positive, checked, shown
from rhec.logs.bag_files import SUFFIXES, files_of
from rhec.logs.bags import MOST_VALUES, read_bag
from rhec.logs.column_names import OTHER_NAMES
from rhec.logs.recording import MAX_PERIOD, SECONDS, time_unit

_SEPARATORS = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", " ": "space"}
_LONGEST_PROBLEM = 1000  # characters of an error message of another library
_DECIMALS = {",": "comma", ".": "point"}
_NUMBER_WITH_COMMA = re.compile(r"\d,\d")
_TIME = re.compile(r"(?:t|time|stamp|timestamp|date_?time)(?:_(s|ms|us|ns))?", re.IGNORECASE)
_MAX_PERIOD_S = MAX_PERIOD * paper.DT_S
_MOST_BYTES = 16 * MOST_VALUES  # of a Parquet file's columns, unpacked
_LATITUDE = ("latitude", "lat")
_LONGITUDE = ("longitude", "lon", "lng")
_ALTITUDE = ("altitude", "alt")
# The ellipsoid WGS 84
_AXIS_M = 6378137.0
_ECCENTRICITY_2 = 6.69437999014e-3
_STEPS_ON_SPHERE = 8  # each leaves about a hundredth of the distance


@checked
def read(
    path: Any,
    *,
    columns: dict[str, str] | None = None,
    topics: tuple[str, ...] | None = None,
    frames: tuple[str, str] | None = None,
    wheel_radius_m: Positive | None = None,
    wheel_separation_multiplier: Positive | None = None,
) -> pd.DataFrame:
    """Read a recorded log from a file into the columns that `rhec.replay` takes.

    Args:
        path: A .csv or .parquet file; or a bag: .bag (ROS 1), or a folder, .db3 or .mcap (ROS 2).
            The reader infers the separator of a .csv (tab, ; | , or space) and its decimal comma.
            The time (column `t_s`, `time`, `timestamp` …) may be in s, ms, us, ns or ISO 8601.
            `latitude`, `longitude` [deg] may replace `x_m`, `y_m`, and `sec`, `nanosec` the time.
            Without a line of names, as of `ros2 topic echo --csv`, they are "0", "1", "2" …
        columns: {column of a recording: name in the file} where the names differ, such as
            {"x_m": "east"}. In a bag a name may be the path of a field of any message whose type
            is defined there: the topic, then fields and places in arrays, such as
            {"x_m": "/odom.pose.pose.position.x", "v_left_mps": "/wheels.velocity[0]"}. A time
            becomes seconds, and a quaternion its yaw [rad]. What such columns fill needs no topic.
        topics: Topics of a bag with the positions and with the encoder speeds. By default each is
            the only topic of its type: NavSatFix, PoseStamped or Odometry for positions;
            JointState, TwistStamped or the twist of an Odometry for speeds. A third one, of type
            Imu, gives `gyro_radps`, about the vertical by /tf_static or as gravity shows it.
        frames: Of a bag whose positions are in /tf: the frame in which the robot is, and that of
            the robot, such as ("map", "base_link"). There is a position at each transform from the
            first one. Others on the way, such as those of odometry, are taken as they are then.
        wheel_radius_m: Radius of the wheels [m], needed for the speeds [rad/s] of a JointState. It
            also multiplies v_left_mps and v_right_mps where these are fields.
        wheel_separation_multiplier: By which the robot's driver has multiplied its track width. The
            yaw rate is multiplied by it, which undoes that: κ is at most 1.

    Returns:
        DataFrame. A bag has one row for each time stamp, in order, with the measurements of that
        time, so that no row depends on later ones. Its columns are x_m, y_m, speed_mps and
        yaw_rate_radps. A JointState gives v_left_mps and v_right_mps instead, for which
        `rhec.replay` takes a track_width_m. Latitude and longitude become metres east and north of
        the first position, in the plane tangent to WGS 84 there; lengths are 4 mm too short in
        10 km. `.attrs["inferred"]` lists what was inferred. `.attrs["origin"]` has the latitude,
        longitude [deg] and altitude [m] of the first position, if the log has them.
        `.attrs["lever_arm_m"]` has the place of the antenna ahead and left of base_link [m], if
        /tf_static in the bag tells it.

    Raises:
        ValueError: If the file cannot be read, or if it lacks the topics or columns. For a bag that
            was cut off it names the command that may repair it.
    """
    file = _checked_path(path)
    is_bag = file.suffix in SUFFIXES or file.is_dir()
    for name, given in (("topics", topics), ("frames", frames)):
        if given is not None and not is_bag:
            raise ValueError(
                f"{name} was {given!r}; only a bag has {name}, and log was {str(file)!r}"
            )
    try:
        if is_bag:
            log, inferred = read_bag(file, topics, frames, wheel_radius_m, columns or {})
        elif file.suffix == ".csv":
            log, inferred = _read_csv(file)
        else:
            log, inferred = _read_parquet(file, columns or {})
    except Exception as error:  # any error that a reader raises for a broken file
        problem = _printable(shorten(str(error), _LONGEST_PROBLEM, placeholder=" …"))
        raise ValueError(f"log was {str(file)!r}, which cannot be read: {problem}") from None
    # What a file says is shown to people, on terminals that would obey it.
    log.columns = [_printable(str(name)) for name in log]
    inferred = {name: _printable(value) for name, value in inferred.items()}
    read = log.attrs.pop("fields", [])
    for name, column in (columns or {}).items():
        if name in read:
            continue
        if column not in log:
            raise ValueError(f"columns[{name!r}] was {column!r}; the log has {', '.join(log)}")
        log[name] = log[column]
    log = _in_metres(_in_seconds(log, inferred), inferred)
    if wheel_separation_multiplier is not None:
        log = _without_multiplier(log, wheel_separation_multiplier, inferred)
    log.attrs["inferred"] = inferred
    return log


def _checked_path(path):
    """The Path of a file or folder that may be a log."""
    if not isinstance(path, str | Path):
        raise ValueError(f"log was {shown(path)}; it should be a path")
    file = Path(path)
    try:
        is_log = file.suffix in (".csv", ".parquet", *SUFFIXES) and file.is_file()
        is_log = is_log or file.is_dir() and bool(files_of(file))
    except (OSError, ValueError):  # thousands of letters, or a NUL
        raise ValueError(f"log was {shown(path)}; it cannot be a path") from None
    if not is_log:
        raise ValueError(
            f"log was {shown(str(file))}; it should be an existing .csv, .parquet, "
            f"{', '.join(SUFFIXES)} file or a ROS 2 bag's folder"
        )
    return file


def _without_multiplier(log, multiplier, inferred):
    """The log with the yaw rate of the tracks themselves, not that of a driver."""
    column = "yaw_rate_radps"
    if column not in log:
        raise ValueError(
            f"wheel_separation_multiplier was {multiplier!r}; it is of {column}, and the log has "
            f"{', '.join(map(str, log))}"
        )
    inferred["yaw rate"] = f"times {multiplier:g}, by which the driver had multiplied the width"
    return log.assign(**{column: multiplier * pd.to_numeric(log[column], errors="coerce")})


def read_if_path(log: Any) -> Any:
    """A log that may be the path of a file, which is read as `read` does."""
    return read(log) if isinstance(log, str | Path) else log


def _printable(text):
    r"""Text in which control characters, and those that turn its direction, are as \x1b."""
    return "".join(
        letter.encode("unicode_escape").decode() if category(letter).startswith("C") else letter
        for letter in text
    )


def _read_csv(file):
    """The table in a .csv file, and its separators as {property: inferred value}."""
    with file.open("rb") as begin:
        is_wide = begin.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    # Letters of another encoding stand in names and remarks, which are not read.
    encoding, errors = ("utf-16", "strict") if is_wide else ("utf-8-sig", "replace")
    with file.open(encoding=encoding, errors=errors) as lines:
        head = list(itertools.islice(lines, 50))
    # The space is tried last, because a column name may contain one.
    names = head[0].strip() if head else ""
    separator = next((mark for mark in _SEPARATORS if mark in names), ",")
    has_commas = any(_NUMBER_WITH_COMMA.search(line) for line in head[1:])
    decimal = "," if separator != "," and has_commas else "."
    first = pd.to_numeric(pd.Series(names.split(separator)), errors="coerce")
    has_header = first.isna().any()
    n_columns = max((line.count(separator) for line in head), default=0) + 1
    most_rows = MOST_VALUES // n_columns
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                file,
                sep=r"\s+" if separator == " " else separator,
                decimal=decimal,
                encoding=encoding,
                encoding_errors=errors,
                skipinitialspace=True,
                header=0 if has_header else None,
                index_col=False,  # else the first column of rows that are too long is no column
                nrows=most_rows + 1,
                low_memory=False,  # else the types of a column may change from part to part
            )
    except pd.errors.ParserWarning:
        raise ValueError(
            "its rows have more entries than its line of names; an entry may contain the "
            f"separator ({_SEPARATORS[separator]}), or a name may be missing"
        ) from None
    if len(table) > most_rows:
        raise ValueError(
            f"it has more than {most_rows} rows of {n_columns} columns, and should have at most "
            f"{MOST_VALUES} values"
        )
    # `rostopic echo -p` begins the line of names with %, other loggers begin it with #.
    table.columns = [str(name).strip().lstrip("%# ") for name in table]
    inferred = dict(separator=_SEPARATORS[separator], decimal=_DECIMALS[decimal])
    if is_wide:
        inferred["encoding"] = "UTF-16"
    if not has_header:
        inferred["header"] = "none, the names of the columns are 0, 1, 2 …"
    return table, inferred


def _read_parquet(file, columns):
    """The table in a .parquet file, unless unpacking it would fill the memory, and {}.

    Of its columns those of numbers and times are read, and those of text that may be a time or a
    measurement, or that `columns` names. Lists and other nests, whose size no schema tells, are
    not.
    """
    import pyarrow.parquet as pq  # only some have it

    with pq.ParquetFile(file) as parquet:
        schema = parquet.schema_arrow
        numbers = [field.name for field in schema if _is_number(field.type)]
        wanted = {*columns.values(), *OTHER_NAMES, *_LATITUDE, *_LONGITUDE, *_ALTITUDE}
        texts = [
            field.name
            for field in schema
            if _is_text(field.type) and (field.name in wanted or _TIME.fullmatch(field.name))
        ]
        _refuse_large(parquet.metadata, {*numbers, *texts})
    # Of equal texts a dictionary has one: they may be long, and many, in a small file.
    with pq.ParquetFile(file, read_dictionary=texts) as parquet:
        table = parquet.read([name for name in schema.names if name in {*numbers, *texts}])
    for name in texts:
        table = _with_plain_text(table, name)
    table = table.to_pandas()
    table.attrs.clear()  # of a replay, which the file may bring along
    return table, {}


def _is_number(kind):
    """Whether a type of Arrow is that of numbers, times or truth values."""
    import pyarrow.types as types

    if types.is_dictionary(kind):
        return _is_number(kind.value_type)
    tests = types.is_integer, types.is_floating, types.is_decimal, types.is_temporal
    return types.is_boolean(kind) or any(test(kind) for test in tests)


def _is_text(kind):
    """Whether a type of Arrow is that of text, which may stand in a dictionary."""
    import pyarrow.types as types

    if types.is_dictionary(kind):
        return _is_text(kind.value_type)
    return types.is_string(kind) or types.is_large_string(kind)


def _refuse_large(metadata, names):
    """Refuse a Parquet file whose columns of these names have too many values or bytes."""
    n_values = metadata.num_rows * len(names)
    if n_values > MOST_VALUES:
        raise ValueError(f"it has {n_values} values, and should have at most {MOST_VALUES}")
    groups = [metadata.row_group(place) for place in range(metadata.num_row_groups)]
    parts = [group.column(place) for group in groups for place in range(group.num_columns)]
    unpacked = sum(part.total_uncompressed_size for part in parts if part.path_in_schema in names)
    if unpacked > _MOST_BYTES:
        raise ValueError(f"it unpacks to {unpacked} bytes, and should to at most {_MOST_BYTES}")


def _with_plain_text(table, name):
    """An Arrow table whose dictionary of texts is a column of texts, unless that is too large."""
    import pyarrow as pa
    import pyarrow.compute as pc

    column = table[name].unify_dictionaries()
    longest = max(
        (pc.max(pc.binary_length(chunk.dictionary)).as_py() or 0 for chunk in column.chunks),
        default=0,
    )
    if longest * len(column) > _MOST_BYTES:
        raise ValueError(
            f"{name} has {len(column)} texts of up to {longest} bytes, and they should be at most "
            f"{_MOST_BYTES} bytes"
        )
    return table.set_column(table.column_names.index(name), name, column.cast(pa.string()))


def _in_seconds(log, inferred):
    """The log with its time in a column t_s [s], which starts at 0 unless it was in seconds."""
    names = [name for name in log if _TIME.fullmatch(str(name))]
    if not names:
        return _from_sec_and_nanosec(log, inferred)
    name = "t_s" if "t_s" in names else names[0]
    time = log[name]
    numbers = pd.to_numeric(time, errors="coerce")
    if pd.api.types.is_datetime64_any_dtype(time) or numbers.isna().all():
        stamps = pd.to_datetime(time, format="ISO8601", utc=True, errors="coerce")
        t_s = (stamps - stamps.min()).dt.total_seconds()
        unit = "ISO 8601"
    else:
        unit = _unit(name, numbers)
        # Nanoseconds since 1970 have too many digits for a float; their difference does not.
        t_s = numbers if unit == "s" else (numbers - numbers.min()) * SECONDS[unit]
    inferred["time"] = f"{unit}, column {name}"
    return log.assign(t_s=t_s)


def _from_sec_and_nanosec(log, inferred):
    """The log with t_s from the two columns of a ROS stamp; unchanged if it lacks them."""
    pairs = [
        (name, f"{str(name)[:-3]}nanosec") for name in log if re.search(r"(^|\W|_)sec$", str(name))
    ]
    pair = next((pair for pair in pairs if pair[1] in log), None)
    if pair is None:
        return log  # `rhec.replay` reports the missing columns
    sec, nanosec = (pd.to_numeric(log[name], errors="coerce") for name in pair)
    inferred["time"] = f"columns {pair[0]}, {pair[1]}"
    return log.assign(t_s=sec - sec.min() + 1e-9 * nanosec)


def _unit(name, times):
    """The unit in the name of a time column or, if rows would then be too far apart, by values."""
    t = times.to_numpy(dtype=float, na_value=np.nan)
    unit, period = time_unit(t, _MAX_PERIOD_S)
    of_name = (_TIME.fullmatch(name)[1] or "").lower()
    if of_name and (unit is None or period * SECONDS[of_name] <= _MAX_PERIOD_S):
        return of_name
    return unit or "s"


def _angle(log, names, largest):
    """The first column with one of these names [deg], as an array; None without such a column."""
    column = next((column for column in log if str(column).lower() in names), None)
    if column is None:
        return None
    angle = pd.to_numeric(log[column], errors="coerce").to_numpy(dtype=float)
    size = pd.Series(angle).abs().median()
    if size > largest:
        raise ValueError(
            f"the log's {names[0]} is {size:.7g} (median); it may be in degrees and minutes or in "
            f"1e-7 degrees and should be in degrees, at most {largest}"
        )
    return angle


def _in_metres(log, inferred):
    """The log with x_m east and y_m north of the first position, from latitude and longitude.

    A log with x_m, or without latitude and longitude, is returned unchanged.
    """
    if "x_m" in log:
        return log
    latitude = _angle(log, _LATITUDE, 90)
    longitude = _angle(log, _LONGITUDE, 180)
    if latitude is None or longitude is None:
        return log
    # A receiver without a fix sends 0, 0.
    latitude = np.where((latitude == 0) & (longitude == 0), np.nan, latitude)
    altitude = _angle(log, _ALTITUDE, np.inf)
    height_m = np.zeros(len(log)) if altitude is None else np.nan_to_num(altitude)
    places = np.stack([latitude, longitude, height_m])
    origin = places[:, np.argmax(np.isfinite(latitude + longitude))]
    if np.isfinite(origin).all():
        log.attrs["origin"] = tuple(origin.tolist())
    inferred["position"] = (
        f"metres east and north of latitude {origin[0]:.7f}, longitude {origin[1]:.7f}, on WGS 84"
    )
    east_m, north_m = _metres_at(*places, origin)
    return log.assign(x_m=east_m, y_m=north_m)


def _metres_at(latitude, longitude, height_m, origin):
    """Places east and north of an origin, in the plane tangent to the ellipsoid there (n,) [m].

    Args:
        latitude, longitude: [deg], arrays (n,).
        height_m: Altitudes [m], array (n,).
        origin: Latitude, longitude [deg] and altitude [m].
    """
    phi = np.deg2rad(np.append(origin[0], latitude))
    turned = np.deg2rad(longitude - origin[1])
    height_m = np.append(origin[2], height_m)
    normal = _AXIS_M / np.sqrt(1 - _ECCENTRICITY_2 * np.sin(phi) ** 2)
    from_axis = (normal + height_m) * np.cos(phi)
    above_equator = (normal * (1 - _ECCENTRICITY_2) + height_m) * np.sin(phi)
    # In the meridian of the origin, away from the earth's axis.
    out = from_axis[1:] * np.cos(turned) - from_axis[0]
    up = above_equator[1:] - above_equator[0]
    return from_axis[1:] * np.sin(turned), up * np.cos(phi[0]) - out * np.sin(phi[0])


def degrees_at(x_m, y_m, origin):
    """Longitudes and latitudes of places at the height of the origin: the inverse of `_metres_at`.

    What is left of the distance moves the place as on a sphere, again and again.

    Args:
        x_m, y_m: Places east and north of the origin [m], arrays (n,).
        origin: Latitude, longitude [deg] and altitude [m], as in `log.attrs["origin"]`.

    Returns:
        Longitudes and latitudes [deg], two arrays (n,).
    """
    latitude = np.full(len(x_m), origin[0])
    longitude = np.full(len(x_m), origin[1])
    for _ in range(_STEPS_ON_SPHERE):
        east_m, north_m = _metres_at(latitude, longitude, np.full(len(x_m), origin[2]), origin)
        latitude += np.rad2deg((y_m - north_m) / _AXIS_M)
        longitude += np.rad2deg((x_m - east_m) / (_AXIS_M * np.cos(np.deg2rad(latitude))))
    return longitude, latitude
