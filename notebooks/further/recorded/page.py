"""The tables of docs/recorded_robots.md, and how the page shows them.

    python data/fetch_recordings.py             # four published logs, by their digests
    python -m notebooks.further.recorded.page   # what `rhec log` says of them

`python -m notebooks.further.transfer` makes the table of many noise seeds, and
`python -m notebooks.further.recorded.verdicts` those of simulated drives. All of them go into
figures/, where `python -m docs.site.check_figures` compares them with data/results/.
"""

import sys

import numpy as np
import pandas as pd

from notebooks.further.recorded import verdicts
from notebooks.further.recorded.scores import mounting_angle_rad, save, straight_angles
from notebooks.studies.answer import RESULTS
from notebooks.studies.tables import to_markdown
from rhec import style

FOLDER = style.ROOT / "data" / "recordings"
# {name of a log: words of the page}, in its order
LOGS = {
    "warthog_grass_2024-07-29_14h46": "Warthog on grass",
    "warthog_asphalt_2024-09-20": "Warthog on asphalt",
    "husky_tile_deflated_2023-12-12": "Husky",
    "marmotte_tracked_boreal_2024-01-25": "tracked robot",
}
_TUNED = {"shipped": "default", "itself": "itself", "others": "others"}


def read_logs():
    """{name: DataFrame} of the four published logs, those of them that are there."""
    files = {name: FOLDER / f"{name}.csv" for name in LOGS}
    return {name: pd.read_csv(file) for name, file in files.items() if file.exists()}


def aligned(log):
    """A log whose true yaw is the direction in which its robot drives."""
    return log.assign(yaw_true_rad=log["yaw_true_rad"] + mounting_angle_rad(log))


def mounting(logs):
    """By how much the yaw of each reference is off the way on straights, a DataFrame [rad, s]."""
    rows = []
    for name, log in logs.items():
        angles, speeds = straight_angles(log)
        row = dict(log=name, angle_rad=np.median(angles))
        for way, counts in (("forwards", speeds > 0), ("backwards", speeds < 0)):
            row |= {f"{way}_rad": np.median(angles[counts]), f"{way}_n": int(counts.sum())}
        rows.append(row)
    return pd.DataFrame(rows)


def said(logs):
    """What `rhec.log` says of each log with a truth, and what is true, a DataFrame."""
    return pd.DataFrame(
        [dict(log=name) | verdicts.judged(aligned(log)) for name, log in logs.items()]
    )


# The page


def _table(name):
    return pd.read_csv(RESULTS / f"table_recorded_{name}.csv")


def _of_logs(table):
    """The rows of a table by log, as columns of the page."""
    by_log = table.set_index("log")
    return {words: by_log.loc[name] for name, words in LOGS.items() if name in by_log.index}


def _plus_minus(value, low, high, shown=2):
    """A value with half of its interval, of which this many digits are shown."""
    half = (high - low) / 2
    if not np.isfinite(half) or half <= 0:
        return f"{value:.3g}"
    digits = max(0, shown - 1 - int(np.floor(np.log10(half))))
    return f"{value:.{digits}f} ± {half:.{digits}f}"


def readable_mounting():
    rows = []
    for robot, row in _of_logs(_table("mounting")).items():
        ways = [
            f"{row[f'{way}_rad']:.3f} ({row[f'{way}_n']:.0f})" for way in ("forwards", "backwards")
        ]
        rows.append([robot, f"{row['angle_rad']:.3f}", *ways])
    columns = ["", "median [rad]", "forwards (seconds)", "backwards (seconds)"]
    return to_markdown(pd.DataFrame(rows, columns=columns))


def readable_said():
    rows = {}
    for robot, row in _of_logs(_table("said")).items():
        low, high = row["κ_low"], row["κ_high"]
        rows[robot] = {
            "10 s hidden, within their 95 %": f"{row['hidden_covered']} of {row['hidden']}",
            "factor of σ": f"{row['inflation']:.3g}",
            "true yaw within 1.96 σ, on the way": f"{row['way_in_95']:.2f}",
            "true yaw within 1.96 σ, smoothed": f"{row['smoothed_in_95']:.2f}",
            "yaw RMS, on the way and smoothed [rad]": (
                f"{row['way_rms_rad']:.3f}, {row['smoothed_rms_rad']:.3f}"
            ),
            "μ": _plus_minus((row["μ_low"] + row["μ_high"]) / 2, row["μ_low"], row["μ_high"]),
            "μ of the true path": f"{row['μ_path']:.3f}",
            "κ": _plus_minus((low + high) / 2, low, high),
            "κ of the true path": f"{row['κ_path']:.4f}",
            "drift [rad/m]": f"{(row['drift_low'] + row['drift_high']) / 2:.3f}",
            "drift of the true path": f"{row['drift_path']:.3f}",
            "verdict": "trust it" if row["is_trusted"] else "do not trust it",
        }
    return to_markdown(pd.DataFrame(rows).rename_axis("").reset_index())


def readable_yaw():
    """The RMS error of the yaw, and the share of the errors within 1.96 σ."""
    table = _table("yaw").set_index(["estimator", "tuned", "log"])
    rows = []
    for estimator, tuned in dict.fromkeys(key[:2] for key in table.index):
        cells = []
        for name in LOGS:
            if (estimator, tuned, name) not in table.index:
                cells.append("defaults kept")
                continue
            row = table.loc[(estimator, tuned, name)]
            error = _plus_minus(*row[["yaw_rms_rad", "low", "high"]], shown=1)
            cells.append(f"{error}, {row['inside_95']:.2f}")
        rows.append([f"{estimator}, {_TUNED[tuned]}", *cells])
    return to_markdown(pd.DataFrame(rows, columns=["estimator, tuned on", *LOGS.values()]))


def readable_unsure():
    """Which share of the bad and of the good yaws is unsure, of the RHE with its defaults."""
    table = _table("yaw").query("tuned == 'shipped' and estimator in ('RHE', 'RHE, gyro')")
    rows = []
    for _, row in table.iterrows():
        if np.isnan(row["good_unsure"]):
            continue
        gyro = ", with gyro" if "gyro" in row["estimator"] else ""
        bad = "none bad" if np.isnan(row["bad_unsure"]) else f"{row['bad_unsure']:.3g}"
        rows.append([f"{LOGS[row['log']]}{gyro}", bad, f"{row['good_unsure']:.3g}"])
    return to_markdown(pd.DataFrame(rows, columns=["", "bad, unsure", "good, unsure"]))


def readable_verdicts():
    rows = []
    for (drives, n), of in _table("verdicts").groupby(["drives", "seeds"]):
        by_rate = of.set_index("rate")
        rates = ["false trust", "false alarm"]
        row = [f"{by_rate.loc[rates, 'n'].sum()} in {drives}", n]
        for rate in rates:
            one = by_rate.loc[rate]
            interval = f" [{one['low']:.2f}, {one['high']:.2f}]" if one["n"] else ""
            row += [one["n"], f"{one['k']}{interval}"]
        rows.append([*row, by_rate.loc["untold", "k"]])
    columns = ["drives", "seeds of a kind", "wrong", "false trust", "not wrong", "false alarm"]
    columns += ["cannot tell"]
    return to_markdown(pd.DataFrame(rows, columns=columns))


def readable_coverage():
    table = _table("coverage")
    numbers = table.columns[2:]
    texts = {name: table[name].map("{:.2f}".format).replace("nan", "–") for name in numbers}
    shown = table.assign(**texts)
    shown["loop"] += " loop: " + shown["kind"]
    return to_markdown(shown.drop(columns="kind").rename(columns=dict(loop="")))


BLOCKS = {
    "mounting": readable_mounting,
    "yaw": readable_yaw,
    "unsure": readable_unsure,
    "said": readable_said,
    "verdicts": readable_verdicts,
    "coverage": readable_coverage,
}


if __name__ == "__main__":
    logs = read_logs()
    if len(logs) < len(LOGS):
        sys.exit(f"{FOLDER} has {len(logs)} of {len(LOGS)} logs: python data/fetch_recordings.py")
    save("mounting", mounting(logs), "Angle of the references")
    save("said", said(logs), "What is said of four logs")
