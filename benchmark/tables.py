"""What `make bench` has found, as README.md and docs/performance.md show it.

Every function returns Markdown, made of the tables in data/results/benchmark/.
"""

from pathlib import Path

import pandas as pd

from notebooks.studies.tables import to_markdown

FOLDER = Path(__file__).resolve().parents[1] / "data/results/benchmark"
WHOLE = ("RHE + RHC", "closed loop")
SAMPLES = 1200  # of a drive
DRIVES = 1000
NAMES = {  # {contestant: how a page calls it}, in the order of the tables
    "rhec, in C": "rhec, in C",
    "rhec, closed loop": "rhec, in C: whole sample with robot, sensors, path, log",
    "rhec, one iteration": "rhec, from Python",
    "rhec, to convergence": "rhec, from Python, to convergence",
    "acados in C, step by step": "acados, in C, on one workspace",
    "acados in C": "acados, in C, as it comes",
    "FATROP": "FATROP (CasADi), to convergence",
    "Opti + IPOPT": "IPOPT (CasADi), to convergence",
    "do-mpc": "do-mpc with IPOPT, to convergence",
}
FROM_PYTHON = "rhec, one iteration"
BEST_OF_ACADOS = "acados in C, step by step"
_NONE = "–"


def read(name):
    """A table of `make bench`."""
    return pd.read_csv(FOLDER / f"{name}.csv")


def in_units(seconds):
    """A time with three digits or fewer, in the unit that suits it."""
    for unit, size in (("µs", 1e-6), ("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0)):
        number = seconds / size
        if number < (100 if unit in ("s", "min") else 1000) or unit == "h":
            digits = 3 if number >= 100 else 2
            text = f"{number:.{digits}g}"
            return f"{float(text):g} {unit}"


def _ratio(number):
    return f"{number:.2g}" if number < 100 else f"{number:.0f}"


def _whole(table):
    """The rows of whole steps, in the order of NAMES."""
    rows = table[table["problem"].isin(WHOLE)].set_index("contestant")
    return rows.loc[[name for name in NAMES if name in rows.index]]


def _quartiles(row):
    parts = ("median_us", "lower_quartile_us", "upper_quartile_us")
    median, low, high = (in_units(1e-6 * row[part]) for part in parts)
    return f"{median} [{low}, {high}]"


def measured_on(*names):
    """On which machine, when, and how busy it was."""
    rows = pd.concat([read(name)[["machine", "load", "day"]] for name in names]).drop_duplicates()
    where = " and ".join(dict.fromkeys(rows["machine"]))
    loads = [float(part) for text in rows["load"] for part in text.split(" to ")]
    days = " and ".join(dict.fromkeys(rows["day"]))
    return (
        f"Measured on {where}, on {days}, while {min(loads):.0f} to {max(loads):.0f} processes "
        "wanted to run (load)."
    )


def step():
    """One step at the paper's size."""
    rows = []
    table = read("step")
    for name, row in _whole(table).iterrows():
        parts = table[(table["contestant"] == name) & (table["phase"] == "overall")]
        parts = parts.set_index("problem")["median_us"]
        shown = {
            "": NAMES[name],
            "RHE": in_units(1e-6 * parts["RHE"]) if "RHE" in parts else _NONE,
            "RHC": in_units(1e-6 * parts["RHC"]) if "RHC" in parts else _NONE,
            "both, median [quartiles]": _quartiles(row),
            "over rhec from Python": _ratio(row["ratio"]),
        }
        rows.append(shown)
    return f"{measured_on('step')}\n\n{to_markdown(pd.DataFrame(rows))}"


def agreement():
    """How far the answers are from the optimum."""
    rows = [
        {
            "": row["contestant"],
            "RHE, largest difference": f"{row['rhe_maximum']:.1e}",
            "RHC, largest difference": f"{row['rhc_maximum']:.1e}",
        }
        for row in read("agreement").to_dict("records")
    ]
    return to_markdown(pd.DataFrame(rows))


def _by(name, size, unit):
    table = read(name)
    columns = {}
    for number, rows in table.groupby(size):
        whole = _whole(rows)
        columns[f"{number} {unit}"] = {
            NAMES[who]: f"{in_units(1e-6 * row['median_us'])} ({_ratio(row['ratio'])})"
            for who, row in whole.iterrows()
            if row["problem"] == WHOLE[0]
        }
    frame = pd.DataFrame(columns)
    order = [each for each in NAMES.values() if each in frame.index]
    frame = frame.loc[order].fillna(_NONE).reset_index(names="")
    return f"{measured_on(name)}\n\n{to_markdown(frame)}"


def horizons():
    """One step by horizon."""
    return _by("horizons", "intervals", "intervals")


def states():
    """One step by the number of states."""
    return _by("states", "states", "states")


def _drives():
    """{contestant: (seconds of a drive, seconds of DRIVES drives, where they are measured)}."""
    found = {
        name: (1e-6 * SAMPLES * us, 1e-6 * SAMPLES * DRIVES * us)
        for name, us in _whole(read("step"))["median_us"].items()
    }
    campaign = read("campaigns").query("runs == @DRIVES and workers == 1").iloc[0]
    simulate = read("drive").iloc[0]
    found["rhec, one iteration"] = 1e-3 * simulate["median_ms"], campaign["cpu_s_median"]
    return found


def drives():
    """A drive and many drives: rhec's with all that belongs to them, the others' steps alone."""
    rows = []
    for name, (one, many) in _drives().items():
        if name in ("rhec, to convergence", "rhec, in C"):
            continue
        label = "rhec.simulate, rhec.campaign" if name == FROM_PYTHON else NAMES[name]
        rows.append({"": label, "a drive": in_units(one), f"{DRIVES:,} drives": in_units(many)})
    return f"{measured_on('drive', 'campaigns', 'step')}\n\n{to_markdown(pd.DataFrame(rows))}"


def campaigns():
    """Campaigns by runs and workers."""
    rows = []
    for row in read("campaigns").to_dict("records"):
        rows.append(
            {
                "drives": f"{row['runs']:,}",
                "workers": row["workers"],
                "time on the wall, median [range]": _range(row, "wall_s"),
                "time of the processor": _range(row, "cpu_s"),
                "processor, each drive": in_units(row["cpu_s_median"] / row["runs"]),
            }
        )
    return f"{measured_on('campaigns')}\n\n{to_markdown(pd.DataFrame(rows))}"


def _range(row, name):
    parts = (in_units(row[f"{name}_{part}"]) for part in ("median", "low", "high"))
    return "{} [{}, {}]".format(*parts)


def first():
    """The time to the first result."""
    rows = [
        {
            "": row["contestant"],
            "compiled code": {"cold": "compiled anew", "warm": "from the cache"}[row["cache"]]
            if row["contestant"].startswith("rhec")
            else "none",
            "processor": in_units(row["cpu_s"]),
            "wall": in_units(row["wall_s"]),
        }
        for row in read("first").to_dict("records")
    ]
    return f"{measured_on('first')}\n\n{to_markdown(pd.DataFrame(rows))}"


def floor():
    """How near to the floor the compiled step is."""
    table = read("floor")
    rows = [
        {
            "": f"{row['problem']}, {row['phase']}",
            "operations": f"{row['operations']:,.0f}",
            "floor": in_units(1e-6 * row["floor_us"]),
            "measured": in_units(1e-6 * row["median_us"]),
            "measured over floor": f"{row['over_floor']:.2g}",
        }
        for row in table.to_dict("records")
    ]
    total = table[["operations", "floor_us", "median_us"]].sum()
    rows.append(
        {
            "": "both",
            "operations": f"{total['operations']:,.0f}",
            "floor": in_units(1e-6 * total["floor_us"]),
            "measured": in_units(1e-6 * total["median_us"]),
            "measured over floor": f"{total['median_us'] / total['floor_us']:.2g}",
        }
    )
    speed = f"Here scalars are added and multiplied {table['gflops'].iloc[0]:g}·10⁹ times a second."
    return f"{measured_on('floor')} {speed}\n\n{to_markdown(pd.DataFrame(rows))}"


def explorer():
    """From a key to the picture of the explorer."""
    rows = [
        {
            "": f"{row['drives']:.0f} drives" if row["drives"] > 1 else "1 drive",
            "from the key to the picture, median [5 %, 95 %]": _range(row, "picture_s"),
            "of this the drives": in_units(row["kernel_s_median"]),
            "moves": f"{row['moves']:.0f}",
        }
        for row in read("explorer").to_dict("records")
    ]
    return f"{measured_on('explorer')}\n\n{to_markdown(pd.DataFrame(rows))}"


def lines():
    """The lines that a user writes."""
    table = read("lines").pivot(index="task", columns="contestant", values="lines")
    return to_markdown(table.reset_index(names="lines of code"))


def beside_peers():
    """README's table: a step, a drive, many drives, and the lines that a user writes."""
    whole = _whole(read("step"))["median_us"]
    both = (
        read("lines")
        .groupby("contestant", sort=False)["lines"]
        .apply(lambda each: " / ".join(map(str, each)))
    )
    found = _drives()
    rows = []
    for name, label in {
        FROM_PYTHON: "rhec, from Python",
        BEST_OF_ACADOS: "acados, in C",
        "FATROP": "FATROP",
        "Opti + IPOPT": "IPOPT",
        "do-mpc": "do-mpc",
    }.items():
        if name not in whole.index:
            continue
        one, many = found[name]
        rows.append(
            {
                "": label,
                "a step": in_units(1e-6 * whole[name]),
                "a drive": in_units(one),
                f"{DRIVES:,} drives": in_units(many),
                "lines: control / estimation": both.get(
                    "rhec" if name == FROM_PYTHON else name, _NONE
                ),
            }
        )
    return to_markdown(pd.DataFrame(rows))


def or_missing(function):
    """The text of a function, or a sentence in its place while its table is missing."""

    def text():
        try:
            return function()
        except FileNotFoundError as error:
            return f"`{Path(error.filename).name}` is missing: `make bench` measures it."

    return text


def packages():
    """What each extra adds, see `docs.site.packages`."""
    rows = [
        {
            "": f"`pip install '.[{row['extra']}]'` adds" if row["extra"] else "`pip install .`",
            "packages": row["packages"],
            "MB": f"{row['megabytes']:.0f}",
        }
        for row in read("packages").fillna({"extra": ""}).to_dict("records")
    ]
    return to_markdown(pd.DataFrame(rows))


_TABLES = {
    "packages": packages,
    "peers": beside_peers,
    "bench_step": step,
    "bench_agreement": agreement,
    "bench_horizons": horizons,
    "bench_states": states,
    "bench_drives": drives,
    "bench_campaigns": campaigns,
    "bench_first": first,
    "bench_floor": floor,
    "bench_explorer": explorer,
    "bench_lines": lines,
}
BLOCKS = {name: or_missing(function) for name, function in _TABLES.items()}
