"""What a replay leaves behind: its estimates as tables, and paths for `evo`."""

import numpy as np

from rhec.simulation.columns import ESTIMATE, MEASUREMENTS

__all__ = ["write_estimates", "write_scores"]


def write_estimates(estimates, folder):
    """Write what `rhec.replay` returned: estimates.csv, .parquet, estimated.tum, measured.tum."""
    folder.mkdir(parents=True, exist_ok=True)
    estimates.to_csv(folder / "estimates.csv", index=False)
    estimates.to_parquet(folder / "estimates.parquet")
    for name, (x, y) in dict(estimated=ESTIMATE[:2], measured=MEASUREMENTS[:2]).items():
        path = estimates.dropna(subset=[x, y]).drop_duplicates("t_s")
        half = path[ESTIMATE[2]] / 2 * (name == "estimated")  # no sensor measures a direction
        path = path.assign(no=0.0, qz=np.sin(half), qw=np.cos(half))
        columns = ["t_s", x, y, "no", "no", "no", "qz", "qw"]  # t x y z qx qy qz qw
        np.savetxt(folder / f"{name}.tum", path[columns], fmt="%.9f")


def write_scores(table, remarks, folder):
    """Write scores.txt: the RHE's means of `replay_table`, then what a replay remarked."""
    rows = table[table["estimator"] == "RHE"]
    lines = [
        f"{row.quantity}: {row.mean:.4g} [{row.low:.4g}, {row.high:.4g}]"
        for row in rows.itertuples()
    ]
    title = f"RHE, mean and 95 % interval over {rows['n'].max()} noise seeds:"
    (folder / "scores.txt").write_text("\n".join([title, *lines, *remarks, ""]), encoding="utf-8")
