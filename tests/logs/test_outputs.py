"""Files that a replay leaves behind."""

import json

import make_example_log
import numpy as np
import pandas as pd
import pytest

import rhec
from rhec import paper
from rhec.logs.outputs import write_estimates, write_traction


def test_a_replay_leaves_tables_and_paths(tmp_path):
    log = rhec.logs.read(make_example_log.FILE)[:300]
    log.attrs["origin"] = (48.2, 16.4, 170.0)
    estimates = rhec.replay(
        log,
        first_yaw_rad=0.4,
        process_noise="prediction",
        sigma_v=paper.SIGMA_V,
        speed_model="input",
    )
    write_estimates(estimates, tmp_path / "new")
    assert (tmp_path / "new" / "traction.geojson").is_file()
    for table in (
        pd.read_csv(tmp_path / "new" / "estimates.csv"),
        pd.read_parquet(tmp_path / "new" / "estimates.parquet"),
    ):
        np.testing.assert_allclose(table["theta_hat_rad"], estimates["theta_hat_rad"])
    t, x, y, *nothing, qz, qw = np.loadtxt(tmp_path / "new" / "estimated.tum").T
    said = estimates.dropna(subset="x_hat_m")
    np.testing.assert_allclose([t, x, y], said[["t_s", "x_hat_m", "y_hat_m"]].T, atol=1e-8)
    turn = 2 * np.arctan2(qz, qw) - said["theta_hat_rad"]
    np.testing.assert_allclose(np.cos(turn), 1.0, atol=1e-9)
    assert not np.any(nothing)
    measured = np.loadtxt(tmp_path / "new" / "measured.tum")
    assert (
        len(measured) == estimates["x_meas_m"].notna().sum() and (np.diff(measured[:, 0]) > 0).all()
    )


def labels_of(n=50, **attrs):
    """Estimates as of a replay, with a first row that has none and a standard deviation lacking."""
    names = "x_hat_m y_hat_m mu_hat kappa_hat sigma_x_m sigma_y_m sigma_mu sigma_kappa yaw"
    random = np.random.default_rng(2)
    estimates = pd.DataFrame({name: random.uniform(0.1, 0.9, n) for name in names.split()})
    estimates.insert(0, "t_s", 0.2 * np.arange(n))
    estimates.loc[0, ["x_hat_m", "y_hat_m"]] = np.nan
    estimates.loc[3, "sigma_kappa"] = np.nan
    estimates.attrs |= attrs
    return estimates


@pytest.mark.parametrize("latitude, altitude_m", [(48.2, 0.0), (-33.9, 1600.0), (0.0, 400.0)])
def test_traction_lies_where_the_receiver_was(tmp_path, latitude, altitude_m):
    """What the reader makes metres, GeoJSON makes the receiver's own degrees again."""
    way = np.linspace(0, 0.02, 50)  # about 2 km
    degrees = pd.DataFrame(dict(t_s=0.2 * np.arange(50), latitude=latitude + way))
    degrees = degrees.assign(longitude=16.37 - way[::-1] ** 2, altitude=altitude_m)
    degrees.to_csv(tmp_path / "log.csv", index=False)
    log = rhec.logs.read(tmp_path / "log.csv")
    estimates = labels_of(**log.attrs)
    estimates[["x_hat_m", "y_hat_m"]] = log[["x_m", "y_m"]]
    write_estimates(
        estimates.assign(theta_hat_rad=0.0, x_meas_m=0.0, y_meas_m=0.0), tmp_path / "new"
    )
    collection = json.loads((tmp_path / "new" / "traction.geojson").read_text("utf-8"))
    assert collection["type"] == "FeatureCollection"
    features = collection["features"]
    assert {feature["geometry"]["type"] for feature in features} == {"Point"}
    places = [feature["geometry"]["coordinates"] for feature in features]
    expected = degrees[["longitude", "latitude"]].to_numpy()
    np.testing.assert_allclose(places, expected, rtol=0, atol=2e-9)  # 0.2 mm
    told = [feature["properties"]["mu_hat"] for feature in features]
    np.testing.assert_allclose(told, estimates["mu_hat"], atol=1e-14)
    assert features[3]["properties"]["sigma_kappa"] is None


def test_a_log_in_metres_has_no_geojson(tmp_path):
    with pytest.raises(ValueError, match="^estimates had no origin; .* latitude and longitude"):
        write_traction(labels_of(), tmp_path / "traction.geojson")
    assert not (tmp_path / "traction.geojson").exists()
