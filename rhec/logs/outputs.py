"""Files of a replay and of `rhec log`: tables, paths for the tool `evo`, a map, YAML, a picture."""

import json
from pathlib import Path

import numpy as np

from rhec.files import replacing
from rhec.logs.reader import degrees_at
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, SIGMA

# What write_estimates may write, and write_summary besides.
FILES_OF_ESTIMATES = (
    "estimates.csv", "estimates.parquet", "estimated.tum", "measured.tum", "traction.geojson"
)  # fmt: skip
FILES = (*FILES_OF_ESTIMATES, "summary.txt", "summary.json", "robot.yaml", "log.png")
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
    yaw_rad = estimates[ESTIMATE[2]]
    _write_path(folder / "estimated.tum", estimates, ESTIMATE[:2], yaw_rad)
    # No sensor measures a direction.
    _write_path(folder / "measured.tum", estimates, MEASUREMENTS[:2], 0.0)
    if "origin" in estimates.attrs:
        write_traction(estimates, folder / "traction.geojson")


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
    places = degrees_at(*labels[_TRACTION[1:3]].to_numpy().T, estimates.attrs["origin"])
    properties = labels.drop(columns=_TRACTION[1:3]).to_json(orient="records", double_precision=15)
    features = [
        dict(type="Feature", geometry=dict(type="Point", coordinates=place), properties=row)
        for place, row in zip(np.column_stack(places).tolist(), json.loads(properties))
    ]
    _write_text(Path(file), json.dumps(dict(type="FeatureCollection", features=features)))


def _write_text(file, text):
    with replacing(file) as unfinished:
        unfinished.write(text.encode())
