"""Files of a replay: tables of the estimates, paths for the tool `evo`, and scores as text."""

import numpy as np

from rhec.simulation.columns import ESTIMATE, MEASUREMENTS


def write_estimates(estimates, folder):
    """Write estimates.csv, estimates.parquet, estimated.tum and measured.tum.

    Args:
        estimates: DataFrame, as `rhec.replay` returns it.
        folder: Path of the folder, which is created if needed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    estimates.to_csv(folder / "estimates.csv", index=False)
    estimates.to_parquet(folder / "estimates.parquet")
    x, y, yaw = ESTIMATE[:3]
    _write_path(folder / "estimated.tum", estimates, x, y, estimates[yaw])
    x, y = MEASUREMENTS[:2]
    _write_path(folder / "measured.tum", estimates, x, y, 0.0)  # no sensor measures a direction


def _write_path(file, estimates, x, y, yaw_rad):
    """Write a line `t x y z qx qy qz qw` for each row with a position in the columns x, y."""
    path = estimates[["t_s", x, y]].assign(
        z=0.0, qx=0.0, qy=0.0, qz=np.sin(yaw_rad / 2), qw=np.cos(yaw_rad / 2)
    )
    path = path.dropna(subset=[x, y]).drop_duplicates("t_s")
    np.savetxt(file, path, fmt="%.9f")


def write_scores(table, remarks, folder):
    """Write scores.txt: the RHE's means of `replay_table`, then the remarks of a replay."""
    rows = table[table["estimator"] == "RHE"]
    lines = [
        f"{row.quantity}: {row.mean:.4g} [{row.low:.4g}, {row.high:.4g}]"
        for row in rows.itertuples()
    ]
    title = f"RHE, mean and 95 % interval over {rows['n'].max()} noise seeds:"
    (folder / "scores.txt").write_text("\n".join([title, *lines, *remarks, ""]), encoding="utf-8")
