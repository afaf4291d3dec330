"""Files of a replay and of `rhec log`: tables, paths for the tool `evo`, YAML, a picture."""

import numpy as np

from rhec.files import replacing
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS

# What write_estimates writes, and write_summary besides.
FILES = ("estimates.csv", "estimates.parquet", "estimated.tum", "measured.tum")
FILES += ("summary.txt", "summary.json", "robot.yaml", "log.png")


def write_estimates(estimates, folder):
    """Write estimates.csv, estimates.parquet, estimated.tum and measured.tum.

    Args:
        estimates: DataFrame, as `rhec.replay` returns it.
        folder: Path of the folder, which is created if needed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / "estimates.csv") as unfinished:
        estimates.to_csv(unfinished, index=False)
    with replacing(folder / "estimates.parquet") as unfinished:
        estimates.to_parquet(unfinished)
    yaw_rad = estimates[ESTIMATE[2]]
    _write_path(folder / "estimated.tum", estimates, ESTIMATE[:2], yaw_rad)
    # No sensor measures a direction.
    _write_path(folder / "measured.tum", estimates, MEASUREMENTS[:2], 0.0)


def _write_path(file, estimates, place, yaw_rad):
    """Write a line `t x y z qx qy qz qw` for each row with a position in the two columns."""
    path = estimates[["t_s", *place]].assign(
        z=0.0, qx=0.0, qy=0.0, qz=np.sin(yaw_rad / 2), qw=np.cos(yaw_rad / 2)
    )
    path = path.dropna(subset=place).drop_duplicates("t_s")
    with replacing(file) as unfinished:
        np.savetxt(unfinished, path, fmt="%.9f")


def write_summary(summary, folder):
    """Write summary.txt, summary.json, robot.yaml for ROS, log.png, and the estimates.

    Args:
        summary: Summary with estimates, as `rhec.log` returns it.
        folder: Path of the folder, which is created if needed.
    """
    write_estimates(summary.estimates, folder)
    _write_text(folder / "summary.txt", f"{summary}\n\n{summary.details}\n")
    _write_text(folder / "summary.json", f"{summary.to_json()}\n")
    _write_text(folder / "robot.yaml", summary.yaml)
    with replacing(folder / "log.png") as unfinished:
        summary.plot().savefig(unfinished, format="png")


def _write_text(file, text):
    with replacing(file) as unfinished:
        unfinished.write(text.encode())
