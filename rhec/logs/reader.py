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
from rhec.logs.column_names import OTHER_NAMES, column_of, unit_of
from rhec.logs.finding import passed
from rhec.logs.recording import MAX_PERIOD, SECONDS, time_unit

_SEPARATORS = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", " ": "space"}
_LONGEST_PROBLEM = 1000  # characters of an error message of another library
_DECIMALS = {",": "comma", ".": "point"}
_TEXTS = (".csv", ".txt", ".dat", ".tsv")  # suffixes of tables as text
_BEGIN = 1024  # bytes, of which one is 0 in a picture, an archive or a table of another kind
_NUMBER_WITH_COMMA = re.compile(r"\d,\d")
_QUOTED_NUMBER = re.compile(r'"([-+\d.,]+)"')
# A mark of thousands, then a mark of decimals, such as 1,234.5 and 1.234,5.
_THOUSANDS = {
    ",": re.compile(r"(?<![\d.,])\d{1,3}(,\d{3})+\.\d"),
    ".": re.compile(r"(?<![\d.,])\d{1,3}(\.\d{3})+,\d"),
}
_MAX_PERIOD_S = MAX_PERIOD * paper.DT_S
# The ellipsoid WGS 84
_AXIS_M = 6378137.0
_ECCENTRICITY_2 = 6.69437999014e-3


@checked
def read(
    path: Any,
    *,
    columns: dict[str, str] | None = None,
    topics: tuple[str, ...] | None = None,
    wheel_radius_m: Positive | None = None,
    wheel_separation_multiplier: Positive | None = None,
) -> pd.DataFrame:
    """Read a recorded log from a file into the columns that `rhec.replay` takes.

    Args:
        path: A .csv, .txt, .dat, .tsv or .parquet file; or a bag: .bag (ROS 1), or a folder, .db3
            or .mcap (ROS 2); or a list of several files of one drive, such as one of positions and
            one of wheels, by one clock. The reader infers the separator of a table as text (tab, ;
            | , or space) and the marks of decimals and thousands, and leaves out lines that begin
            with #. The time (column `t_s`, `time`, `timestamp` …) may be in s, ms, us, ns or
            ISO 8601. `latitude`, `longitude` [deg] may replace `x_m`, `y_m`, and `sec`, `nanosec`
            the time. Without a line of names, as of `ros2 topic echo --csv`, they are "0", "1" …
        columns: {column of a recording: name in the file} where the names differ, such as
            {"x_m": "east"}. In a bag a name may be the path of a field of any message whose type
            is defined there: the topic, then fields and places in arrays, such as
            {"x_m": "/odom.pose.pose.position.x", "v_left_mps": "/wheels.velocity[0]"}. A time
            becomes seconds, and a quaternion its yaw [rad]. What such columns fill needs no topic.
            A minus before a name turns the sign.
        topics: Topics of a bag with the positions and with the encoder speeds. By default each is
            the only topic of its type: NavSatFix, PoseStamped or Odometry for positions;
            JointState, TwistStamped or the twist of an Odometry for speeds. A third one, of type
            Imu, gives `gyro_radps`, about its z axis.
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
        10 km. `.attrs["inferred"]` lists what was inferred.

    Raises:
        ValueError: If the file cannot be read, or if it lacks the topics or columns. For a bag that
            was cut off it names the command that may repair it.
    """
    given = (columns or {}, topics, wheel_radius_m)
    if isinstance(path, list | tuple):
        if not path:
            raise ValueError(f"log was {path!r}; it should be a path, or a list of several")
        log = _together([_read_file(each, *given, is_whole=False) for each in path])
        absent = [name for name in columns or {} if name not in log]
        if absent:
            raise ValueError(
                f"{passed(f'columns[{absent[0]!r}]')} was {columns[absent[0]]!r}; no file has it, "
                f"together they have {', '.join(log)}"
            )
    else:
        log = _read_file(path, *given)
    inferred = log.attrs["inferred"]
    log = _in_metres(log, inferred)
    if wheel_separation_multiplier is not None:
        log = _without_multiplier(log, wheel_separation_multiplier, inferred)
    log.attrs = dict(inferred=inferred)
    return log


def _read_file(path, columns, topics, wheel_radius_m, is_whole=True):
    """The log of one file, with its time in seconds.

    Args:
        path, columns, topics, wheel_radius_m: As in `read`.
        is_whole: Whether it has to have all of the columns.
    """
    file = _checked_path(path)
    is_bag = file.suffix in SUFFIXES or file.is_dir()
    if topics is not None and not is_bag:
        raise ValueError(
            f"{passed('topics')} was {topics!r}; only a bag has topics, and log was {str(file)!r}"
        )
    try:
        if is_bag:
            log, inferred = read_bag(file, topics, wheel_radius_m, columns)
        elif file.suffix in _TEXTS:
            log, inferred = _read_text(file)
        else:
            log, inferred = _read_parquet(file, columns)
    except Exception as error:  # any error that a reader raises for a broken file
        problem = _printable(shorten(str(error), _LONGEST_PROBLEM, placeholder=" …"))
        raise ValueError(f"log was {str(file)!r}, which cannot be read: {problem}") from None
    # What a file says is shown to people, on terminals that would obey it.
    log.columns = [_printable(str(name)) for name in log]
    inferred = {name: _printable(value) for name, value in inferred.items()}
    read = log.attrs.pop("fields", [])
    for name, column in columns.items():
        if name in read:
            continue
        if column in log:
            log[name] = log[column]
        elif column.startswith("-") and column[1:] in log:
            log[name] = -pd.to_numeric(log[column[1:]], errors="coerce")
        elif is_whole:
            named = passed(f"columns[{name!r}]")
            raise ValueError(f"{named} was {column!r}; the log has {', '.join(log)}")
    log = _in_seconds(log, inferred)
    log.attrs["inferred"] = inferred
    return log


def _together(logs):
    """Several logs of one drive as one, in the order of time.

    What an earlier log has, later ones do not bring again. All times begin with the first one.
    """
    begins = [log.attrs.get("begin_s", 0.0) for log in logs]
    parts = []
    names = set()
    inferred = {}
    for number, (log, begin_s) in enumerate(zip(logs, begins), 1):
        if "t_s" not in log:
            raise ValueError(
                f"file {number} of the log had no column of its time, by which it could be put "
                f"beside the others; it has {', '.join(map(str, log))}"
            )
        part = log[["t_s", *(name for name in log if name not in {*names, "t_s"})]]
        parts.append(part.assign(t_s=part["t_s"] + begin_s - min(begins)))
        names |= {*log}
        inferred |= {f"file {number}, {role}": told for role, told in log.attrs["inferred"].items()}
    merged = pd.concat(parts).sort_values("t_s", kind="stable", ignore_index=True)
    merged.attrs["inferred"] = inferred
    return merged


def _checked_path(path):
    """The Path of a file or folder that may be a log."""
    if not isinstance(path, str | Path):
        raise ValueError(f"log was {shown(path)}; it should be a path")
    file = Path(path)
    try:
        is_log = file.suffix in (*_TEXTS, ".parquet", *SUFFIXES) and file.is_file()
        is_log = is_log or file.is_dir() and bool(files_of(file))
    except (OSError, ValueError):  # thousands of letters, or a NUL
        raise ValueError(f"log was {shown(path)}; it cannot be a path") from None
    if not is_log:
        raise ValueError(
            f"log was {shown(str(file))}; it should be an existing {', '.join(_TEXTS)}, .parquet, "
            f"{', '.join(SUFFIXES)} file or a ROS 2 bag's folder"
        )
    return file


def _without_multiplier(log, multiplier, inferred):
    """The log with the yaw rate of the tracks themselves, not that of a driver."""
    column = "yaw_rate_radps"
    if column not in log:
        raise ValueError(
            f"{passed('wheel_separation_multiplier')} was {multiplier!r}; it is of {column}, and "
            f"the log has {', '.join(map(str, log))}"
        )
    inferred["yaw rate"] = f"times {multiplier:g}, by which the driver had multiplied the width"
    return log.assign(**{column: multiplier * pd.to_numeric(log[column], errors="coerce")})


def read_if_path(log: Any) -> Any:
    """A log that may be the path of a file, or paths, which are read as `read` does."""
    is_paths = isinstance(log, list | tuple) and all(isinstance(each, str | Path) for each in log)
    return read(log) if is_paths or isinstance(log, str | Path) else log


def _printable(text):
    r"""Text in which control characters, and those that turn its direction, are as \x1b."""
    return "".join(
        letter.encode("unicode_escape").decode() if category(letter).startswith("C") else letter
        for letter in text
    )


def _read_text(file):
    """The table in a file of text, and its separators as {property: inferred value}."""
    with file.open("rb") as content:
        begin = content.read(_BEGIN)
    is_wide = begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if b"\0" in begin and not is_wide:
        raise ValueError(f"it is no text, which a {file.suffix} file should be")
    # Letters of another encoding stand in names and remarks, which are not read.
    encoding, errors = ("utf-16", "strict") if is_wide else ("utf-8-sig", "replace")
    with file.open(encoding=encoding, errors=errors) as lines:
        head = list(itertools.islice(lines, 50))
        is_remark = [line.startswith("#") for line in itertools.chain(head, lines)]
    names, remarks = _names_among(head, is_remark)
    head = [line for line in head if not line.startswith("#")]
    first = names or (head[0] if head else "")
    # The space is tried last, because a column name may contain one.
    separator = next((mark for mark in _SEPARATORS if mark in first.strip()), ",")
    decimal, thousands = _marks(head[1:], separator)
    fields = pd.to_numeric(pd.Series(first.split(separator)), errors="coerce")
    has_header = not names and fields.isna().any()
    n_columns = max((line.count(separator) for line in head), default=0) + 1
    most_rows = MOST_VALUES // n_columns
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                file,
                sep=r"\s+" if separator == " " else separator,
                decimal=decimal,
                thousands=thousands,
                encoding=encoding,
                encoding_errors=errors,
                skipinitialspace=True,
                skiprows=remarks,
                header=0 if has_header else None,
                index_col=False,  # else the first column of rows that are too long is no column
                nrows=most_rows + 1,
                low_memory=False,  # else the types of a column may change from part to part
            )
    except pd.errors.EmptyDataError:
        raise ValueError("the file is empty") from None
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
    if names:
        table.columns = _split(names.lstrip("#"), separator)
    # `rostopic echo -p` begins the line of names with %.
    table.columns = [str(name).strip().lstrip("%# ") for name in table]
    inferred = dict(separator=_SEPARATORS[separator], decimal=_DECIMALS[decimal])
    if thousands:
        inferred["thousands"] = _DECIMALS[thousands]
    if is_wide:
        inferred["encoding"] = "UTF-16"
    if not (has_header or names):
        inferred["header"] = "none, the names of the columns are 0, 1, 2 …"
    return table, inferred


def _split(line, separator):
    """The entries of a line."""
    return line.split() if separator == " " else line.strip().split(separator)


def _names_among(head, is_remark):
    """The line of names if that is a remark, else "", and the places of all remarks.

    The last remark before the first other line names the columns if it has as many entries as that
    line, which is one of numbers.

    Args:
        head: The first lines.
        is_remark: Whether each line of the file begins with #.
    """
    remarks = [place for place, remark in enumerate(is_remark) if remark]
    begin = next((place for place, remark in enumerate(is_remark) if not remark), 0)
    if not 0 < begin < len(head):
        return "", remarks
    separator = next((mark for mark in _SEPARATORS if mark in head[begin].strip()), ",")
    names = _split(head[begin - 1].lstrip("#").strip(), separator)
    entries = _split(head[begin], separator)
    numbers = pd.to_numeric(pd.Series(entries), errors="coerce")
    is_header = len(names) == len(entries) > 1 and numbers.notna().any()
    return head[begin - 1] if is_header else "", remarks


def _marks(lines, separator):
    """The marks of decimals and of thousands, or None, in lines with this separator."""
    if separator == ",":  # numbers with a comma are in quotes then
        lines = [entry for line in lines for entry in _QUOTED_NUMBER.findall(line)]
    for mark, pattern in _THOUSANDS.items():
        if any(pattern.search(line) for line in lines):
            return "," if mark == "." else ".", mark
    has_commas = any(_NUMBER_WITH_COMMA.search(line) for line in lines)
    return "," if has_commas else ".", None


def _read_parquet(file, columns):
    """The table in a .parquet file, unless unpacking it would fill the memory, and {}.

    Its columns of numbers and times are read. Texts, lists and other nests, whose size no schema
    tells, are not.
    """
    import pyarrow.parquet as pq  # only some have it

    with pq.ParquetFile(file) as parquet:
        schema = parquet.schema_arrow
        names = [each.name for each in schema if _is_number(each.type)]
        wanted = {name.removeprefix("-") for name in columns.values()} | {*OTHER_NAMES}
        left_out = [name for name in schema.names if name in wanted and name not in names]
        if left_out:
            raise ValueError(
                f"its column {left_out[0]} is of type {schema.field(left_out[0]).type}; it should "
                "be numbers or times"
            )
        n_values = parquet.metadata.num_rows * len(names)
        if n_values > MOST_VALUES:
            raise ValueError(f"it has {n_values} values, and should have at most {MOST_VALUES}")
        table = parquet.read(names).to_pandas()
    table.attrs.clear()  # of a replay, which the file may bring along
    return table, {}


def _is_number(kind):
    """Whether a type of Arrow is that of numbers, times or truth values."""
    import pyarrow.types as types

    tests = types.is_integer, types.is_floating, types.is_decimal, types.is_temporal
    return types.is_boolean(kind) or any(test(kind) for test in tests)


def _in_seconds(log, inferred):
    """The log with its time in a column t_s [s], which starts at 0 unless it was in seconds.

    `.attrs["begin_s"]` is where its 0 is by the clock of the file.
    """
    name = "t_s" if "t_s" in log else column_of(log, "t_s")
    if name is None:
        return _from_sec_and_nanosec(log, inferred)
    time = log[name]
    numbers = pd.to_numeric(time, errors="coerce")
    begin_s = 0.0
    if pd.api.types.is_datetime64_any_dtype(time) or numbers.isna().all():
        stamps = pd.to_datetime(time, format="ISO8601", utc=True, errors="coerce")
        if stamps.isna().all():  # of which a replay says what it has instead
            return log.assign(t_s=time)
        t_s = (stamps - stamps.min()).dt.total_seconds()
        begin_s = stamps.min().timestamp()
        unit = "ISO 8601"
    else:
        unit = _unit(name, numbers)
        t_s = numbers
        if unit != "s":
            # Nanoseconds since 1970 have too many digits for a float; their difference does not.
            t_s = (numbers - numbers.min()) * SECONDS[unit]
            begin_s = float(numbers.min()) * SECONDS[unit]
    inferred.setdefault("time", f"{unit}, column {name}")
    log = log.assign(t_s=t_s)
    log.attrs["begin_s"] = begin_s
    return log


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
    log = log.assign(t_s=sec - sec.min() + 1e-9 * nanosec)
    log.attrs["begin_s"] = float(sec.min())
    return log


def _unit(name, times):
    """The unit in the name of a time column or, if rows would then be too far apart, by values."""
    t = times.to_numpy(dtype=float, na_value=np.nan)
    unit, period = time_unit(t, _MAX_PERIOD_S)
    of_name = unit_of(name)
    if of_name in SECONDS and (unit is None or period * SECONDS[of_name] <= _MAX_PERIOD_S):
        return of_name
    return unit or "s"


def _angle(log, name, largest):
    """The column of an angle [deg], as an array; None without such a column."""
    column = column_of(log, name)
    if column is None:
        return None
    angle = pd.to_numeric(log[column], errors="coerce").to_numpy(dtype=float)
    size = pd.Series(angle).abs().median()
    if size > largest:
        raise ValueError(
            f"the log's {name} is {size:.7g} (median); it may be in degrees and minutes or in "
            f"1e-7 degrees and should be in degrees, at most {largest}"
        )
    return angle


def _in_metres(log, inferred):
    """The log with x_m east and y_m north of the first position, from latitude and longitude.

    A log with x_m, or without latitude and longitude, is returned unchanged.
    """
    if "x_m" in log:
        return log
    latitude = _angle(log, "latitude", 90)
    longitude = _angle(log, "longitude", 180)
    if latitude is None or longitude is None:
        return log
    # A receiver without a fix sends 0, 0.
    latitude = np.where((latitude == 0) & (longitude == 0), np.nan, latitude)
    altitude = _angle(log, "altitude", np.inf)
    height_m = np.zeros(len(log)) if altitude is None else np.nan_to_num(altitude)
    places = np.stack([latitude, longitude, height_m])
    origin = places[:, np.argmax(np.isfinite(latitude + longitude))]
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
