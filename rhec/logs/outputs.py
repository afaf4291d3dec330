"""Files of a replay: tables of the estimates, and paths for the tool `evo`."""

import json
from pathlib import Path

import numpy as np

from rhec.logs.reader import degrees_at
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, SIGMA
from rhec.style import replacing

# What write_estimates may write.
FILES = ("estimates.csv", "estimates.parquet", "estimated.tum", "measured.tum", "traction.geojson")
# What write_summary writes besides.
FILES_OF_SUMMARY = ("summary.txt", "comparison.csv", "robot.yaml", "log.png")
_TRACTION = ["t_s", *ESTIMATE[:2], *ESTIMATE[4:], *SIGMA[:2], *SIGMA[4:6]]


def write_estimates(estimates, folder):
    """Write estimates.csv, estimates.parquet, estimated.tum, measured.tum, and traction.geojson.

    The last one only if the log had latitude and longitude.

    Args:
        estimates: DataFrame, as `rhec.replay` returns it.
        folder: Path of the folder, which is created if needed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / "estimates.csv") as unfinished:
        estimates.to_csv(unfinished, index=False)
    with replacing(folder / "estimates.parquet") as unfinished:
        estimates.to_parquet(unfinished)
    x, y, yaw = ESTIMATE[:3]
    _write_path(folder / "estimated.tum", estimates, x, y, estimates[yaw])
    x, y = MEASUREMENTS[:2]
    _write_path(folder / "measured.tum", estimates, x, y, 0.0)  # no sensor measures a direction
    if "origin" in estimates.attrs:
        write_traction(estimates, folder / "traction.geojson")


def write_summary(summary, folder):
    """Write summary.txt, comparison.csv, robot.yaml for ROS, and the picture log.png.

    Args:
        summary: Summary with estimates, as `rhec.log` returns it.
        folder: Path of the folder, which is created if needed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / "summary.txt") as unfinished:
        unfinished.write_text(f"{summary}\n", encoding="utf-8")
    with replacing(folder / "comparison.csv") as unfinished:
        summary.comparison.table.to_csv(unfinished, index_label="estimator")
    with replacing(folder / "robot.yaml") as unfinished:
        unfinished.write_text(summary.yaml, encoding="utf-8")
    with replacing(folder / "log.png") as unfinished:
        summary.plot().savefig(unfinished, format="png")


def write_traction(estimates, file):
    """Write the traction at each place as GeoJSON (RFC 7946), for a map.

    It has a Point (longitude, latitude) [deg] for each row with numbers for t_s, place, mu_hat and
    kappa_hat. Its properties are t_s, mu_hat, kappa_hat, sigma_x_m, sigma_y_m, sigma_mu and
    sigma_kappa; what is not finite becomes null.

    Args:
        estimates: DataFrame, as `rhec.replay` returns it.
        file: Path of the file.

    Raises:
        ValueError: For estimates of a log without latitude and longitude.
    """
    if "origin" not in estimates.attrs:
        raise ValueError(
            "estimates had no origin; the log should have latitude and longitude and be read by "
            "rhec.logs.read"
        )
    labels = estimates[_TRACTION].dropna(subset=_TRACTION[:5])
    x, y = labels[_TRACTION[1:3]].to_numpy().T
    places = np.column_stack(degrees_at(x, y, estimates.attrs["origin"])).tolist()
    properties = labels.drop(columns=_TRACTION[1:3]).astype(object)
    properties = properties.where(np.isfinite(properties.astype(float)), None)
    features = [
        dict(type="Feature", geometry=dict(type="Point", coordinates=place), properties=row)
        for place, row in zip(places, properties.to_dict("records"))
    ]
    text = json.dumps(dict(type="FeatureCollection", features=features), allow_nan=False)
    with replacing(Path(file)) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def _write_path(file, estimates, x, y, yaw_rad):
    """Write a line `t x y z qx qy qz qw` for each row with a position in the columns x, y."""
    path = estimates[["t_s", x, y]].assign(
        z=0.0, qx=0.0, qy=0.0, qz=np.sin(yaw_rad / 2), qw=np.cos(yaw_rad / 2)
    )
    path = path.dropna(subset=[x, y]).drop_duplicates("t_s")
    with replacing(file) as unfinished:
        np.savetxt(unfinished, path, fmt="%.9f")
