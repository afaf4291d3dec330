"""What a log says at a glance: the traction with its interval, and when not to trust it."""

import json
import re
import textwrap
from pathlib import Path

import make_example_log
import numpy as np
import pandas as pd
import pytest
import yaml
from helpers import KAPPA, MU, recorded_log
from spoilt_logs import four_headings

import rhec
from rhec.cli import main
from rhec.logs import terms
from rhec.logs.course import SIGMA_BY_COURSE
from rhec.logs.judge import hidden_errors, inflation, judge
from rhec.logs.outputs import FILES
from rhec.logs.recording import prepare
from rhec.logs.summary import _inflated
from rhec.simulation.columns import ESTIMATE, LEVER_ARM, MEASUREMENTS, SIGMA

LOG = recorded_log(5.0, 75.0, noise_m=0.02, seed=3)
PAGE = Path(__file__).parents[2] / "docs" / "your_log.md"


@pytest.fixture(scope="module", autouse=True)
def quickly():
    with four_headings():
        yield


@pytest.fixture(scope="module")
def summary():
    return rhec.log(LOG)


def test_a_good_log_is_to_be_trusted_on_one_page(summary):
    page = str(summary).splitlines()
    assert len(page) <= 8
    assert page[0].startswith("75 s, ") and "encoders at 5 Hz" in page[0]
    assert "from x_m, y_m; speed_mps, yaw_rate_radps" in page[1]
    assert page[2].startswith("μ 0.89") and "→ wheel_separation_multiplier 1.3" in page[2]
    n = summary.numbers["hidden"]
    assert page[4].startswith(f"{n} of {n} hidden positions were within their 95 %") and n > 4
    assert page[5].startswith("Trust it.") and "Next: judge it with calibrate=True" in page[5]
    assert page[6] == "Warnings: none."
    assert "x_true_m" in summary.taken["truth, unseen"]
    value, low, high = (summary.parameters[name].astype(float) for name in ("value", "low", "high"))
    assert ((low < value) & (value < high)).all()
    assert "position_sigma_m: at most 0.03, the least that is assumed" in summary.details
    told = json.loads(summary.to_json())
    assert told["verdict"] == summary.verdict and told["numbers"]["hidden"] == n
    assert told["traction"]["κ"]["low"] == pytest.approx(summary.traction.loc["κ", "low"])


def assert_told(text, where, rel):
    """A text is as the docs show it behind these words, and so are its numbers, to `rel`."""
    documented = re.search(rf"{where}:\n\n((?:    .*\n)+)", PAGE.read_text("utf-8"))[1]
    documented = textwrap.dedent(documented).strip()
    number = r"\d+(?:\.\d+)?"
    assert re.sub(number, "0", text) == re.sub(number, "0", documented)
    said, expected = ([*map(float, re.findall(number, each))] for each in (text, documented))
    assert said == pytest.approx(expected, rel=rel)


def test_the_command_prints_the_page_of_the_docs_and_writes_all(capsys, tmp_path):
    """Its words are those of the docs, and its numbers to a tenth: processors round otherwise."""
    out = tmp_path / "out"
    words = ["log", str(make_example_log.FILE), "--output", str(out)]
    assert main(words) == 0
    page, written = capsys.readouterr().out.strip().split("\nWritten: ")
    assert_told(page, "the page is", rel=0.1)
    driver, _ = (out / "robot.yaml").read_text("utf-8").split("\n\nekf_filter_node:")
    assert_told(driver, "it begins", rel=0.01)
    assert all((out / name).is_file() and name in written for name in (*FILES, "C/README.txt"))
    assert len(pd.read_csv(out / "estimates.csv")) == len(rhec.logs.read(make_example_log.FILE))
    LOG.assign(x_m=1.0, y_m=1.0).to_csv(tmp_path / "frozen.csv", index=False)
    assert main(["log", str(tmp_path / "frozen.csv")]) == 1
    assert "No estimate" in capsys.readouterr().out


def test_a_robot_that_drifts_has_its_kappa_nevertheless():
    """With unlike tracks it turns by 0.05 rad in each metre, beside what κ says."""
    log = recorded_log(5.0, 90.0, noise_m=0.01, seed=3)
    rate = log["yaw_rate_radps"] - 0.05 / KAPPA * log["speed_mps"] * MU
    summary = rhec.log(log.assign(yaw_rate_radps=rate))
    traction = summary.traction
    for name, truth in (("κ", KAPPA), ("drift", 0.05 * MU)):
        assert traction.loc[name, "low"] < truth < traction.loc[name, "high"]
    assert traction.loc["drift", "low"] > 0.03
    assert not any("κ is above 1" in each for each in summary.doubts)


def test_a_log_without_turns_does_not_tell_kappa():
    rng = np.random.default_rng(0)
    t = np.arange(0, 60, 0.2)
    log = pd.DataFrame(dict(t_s=t, x_m=0.45 * t, y_m=0.0, speed_mps=0.5, yaw_rate_radps=0.0))
    log[["x_m", "y_m"]] += 0.02 * rng.standard_normal((len(t), 2))
    summary = rhec.log(log)
    assert [*summary.taken] == ["positions", "encoders", "track width"]
    verdict = summary.verdict
    assert verdict.startswith("Cannot tell yet: κ is not excited: drive two figures of eight")


def test_what_the_course_adds_to_the_yaws_deviation_stays_when_the_rest_is_widened():
    """5² = 4² + 3², and 8² + 3² where the noise is twice as large as it says."""
    samples = pd.DataFrame({name: [5.0] for name in SIGMA}).assign(**{SIGMA_BY_COURSE: 3.0})
    wider = _inflated(samples, 2.0)
    assert wider[SIGMA[2]].tolist() == pytest.approx([np.hypot(8.0, 3.0)])
    assert wider.drop(columns=[SIGMA[2], SIGMA_BY_COURSE]).eq(10.0).all(axis=None)


def test_a_log_that_is_refused_has_no_estimate_and_the_reason():
    refused = rhec.log(LOG.assign(speed_mps=3.6 * LOG["speed_mps"]))
    assert refused.traction is None and "km/h" in refused.verdict
    with pytest.raises(ValueError, match="no estimates to draw.*km/h"):
        refused.plot()
    assert rhec.log(LOG.drop(columns="x_m")).verdict.startswith("No estimate: The log had no col")


# For ROS

# Types of the parameters, and lengths of the arrays, by diff_drive_controller_parameter.yaml of
# ros-controls/ros2_controllers (commit 0193629) and params/ekf.yaml of
# cra-ros-pkg/robot_localization (commit 0439976).
OF_ROS = dict(
    diff_drive_controller=dict(
        wheel_separation=float,
        wheel_separation_multiplier=float,
        left_wheel_radius_multiplier=float,
        right_wheel_radius_multiplier=float,
        twist_covariance_diagonal=6,
    ),
    ekf_filter_node=dict(two_d_mode=bool, process_noise_covariance=15 * 15),
)

STATE_OF_ROS = "x y z roll pitch yaw vx vy vz vroll vpitch vyaw ax ay az"


def read_as_ros(text):
    """{node: parameters}, as rcl_yaml_param_parser and rclcpp read them.

    Each key is a node with nothing but ros__parameters, a number without a point is an integer,
    which no double parameter takes, and an array has one type.
    """
    nodes = {}
    for node, content in yaml.safe_load(text).items():
        assert list(content) == ["ros__parameters"]
        nodes[node] = content["ros__parameters"]
        for name, value in nodes[node].items():
            kind = OF_ROS[node][name]
            if isinstance(kind, int):
                assert len(value) == kind and {*map(type, value)} == {float}
            else:
                assert type(value) is kind
    return nodes


def test_its_yaml_is_what_ros_reads(summary):
    told = read_as_ros(summary.yaml)
    assert {node: {*of_node} for node, of_node in told.items()} == {
        node: {*of_node} for node, of_node in OF_ROS.items()
    }
    driver = told["diff_drive_controller"]
    assert driver["wheel_separation_multiplier"] == pytest.approx(MU / KAPPA, rel=0.05)
    assert driver["left_wheel_radius_multiplier"] == pytest.approx(MU, rel=0.05)
    process = told["ekf_filter_node"]["process_noise_covariance"]
    matrix = np.reshape(process, (15, 15))
    assert (matrix == np.diag(np.diag(matrix))).all() and (np.diag(matrix) > 0).all()
    assert "antenna ahead" in summary.parameters.index
    for name, (value, low, high, unit) in summary.parameters.iterrows():
        assert f"# {name}: {value:.4g} {unit} ({low:.4g} to {high:.4g})" in summary.yaml


def parameters(slope):
    """Those of a robot whose traction is the same in all directions."""
    samples = pd.DataFrame([dict.fromkeys(ESTIMATE, 0.0)])
    return terms.of_log((slope, slope, slope), samples, 1.0)


def test_round_numbers_and_unknown_ones_are_what_ros_reads():
    """A track 1 m wide, and a traction that is not known; each noise is of its own velocity."""
    noise = terms.Noise((0.0, 1 / 3, 2.0), (1e-9, 1.0, 10.0))
    round_one = terms.Slope(1.0, 0.0)
    table = parameters(round_one)
    told = read_as_ros(terms.as_yaml(table, 1.0, noise, 10.0))
    driver, node = told["diff_drive_controller"], told["ekf_filter_node"]
    assert driver["wheel_separation"] == 1.0
    assert np.take(driver["twist_covariance_diagonal"], [0, 1, 5]).tolist() == [0.0, 3.3333, 20.0]
    variances = dict(zip(STATE_OF_ROS.split(), node["process_noise_covariance"][::16]))
    assert [variances[name] for name in ("vx", "vy", "vyaw")] == [1e-9, 1.0, 10.0]
    assert max(variances[name] for name in ("x", "y", "yaw")) < 1e-5
    unknown = terms.Slope(np.nan, np.nan)
    text = terms.as_yaml(parameters(unknown), 1.0, noise, 10.0)
    assert yaml.safe_load(text) is None and "too short" in text


def test_the_noise_of_an_odometry_is_that_of_its_slip():
    """White slip speeds of deviation σ in intervals of 0.2 s let it drift by 0.2 σ² a second.

    It is that of the centre of turning, wherever the antenna is.
    """
    n = 50_000
    rng = np.random.default_rng(1)
    sigma = np.array([0.1, 0.05, 0.02])
    ahead, left, turning = sigma[:, None] * rng.standard_normal((3, n))
    t = 0.2 * np.arange(n)
    nu, omega = 1.0 + 0.5 * np.sin(t / 100), 0.3 * np.sin(t / 70)
    yaw = np.append(0, np.cumsum(0.2 * (KAPPA * omega + turning))[:-1])
    middle = (yaw + np.append(yaw[1:], yaw[-1])) / 2
    step = 0.2 * (MU * nu + ahead + 1j * left) * np.exp(1j * middle)
    z = np.append(0, np.cumsum(step)[:-1]) + (0.6 - 0.2j) * np.exp(1j * yaw)
    samples = pd.DataFrame(0.0, range(n), ["segment", *ESTIMATE, *LEVER_ARM, *MEASUREMENTS])
    samples[LEVER_ARM] = 0.6, -0.2
    samples[ESTIMATE[:3]] = np.column_stack([z.real, z.imag, yaw])
    # The encoders' mean over the interval that ends at a sample.
    samples[MEASUREMENTS[2:]] = np.column_stack([np.append(0, nu[:-1]), np.append(0, omega[:-1])])
    found = terms.noise(samples)
    np.testing.assert_allclose(found.drift, 0.2 * sigma**2, rtol=0.1)
    # A slope has an interval from five blocks of 10 s on.
    for seconds, is_told in ((39, False), (49, True)):
        slopes = terms.slopes(samples[: 5 * seconds + 1])
        assert np.isfinite(slopes).all() == is_told


def test_a_velocity_does_not_change_between_two_segments():
    parts = []
    for segment, speed_mps in enumerate((0.5, 1.5)):
        part = pd.DataFrame(0.0, range(500), ["segment", *ESTIMATE, *LEVER_ARM, *MEASUREMENTS])
        part["segment"] = segment
        part[ESTIMATE[0]] = 0.2 * speed_mps * np.arange(500)
        part[MEASUREMENTS[2]] = speed_mps
        parts.append(part)
    np.testing.assert_allclose(terms.noise(pd.concat(parts)).changes, 0, atol=1e-12)


# How it was tested


def test_the_factor_covers_what_is_too_often_outside():
    """Errors of a normal distribution with twice the deviation that is said."""
    rng = np.random.default_rng(0)
    ratios = np.abs(2 * rng.standard_normal(4000)) / 1.96
    assert inflation(ratios) == pytest.approx(2, rel=0.05)
    assert inflation(ratios / 2 * 0.9) == 1 and inflation([]) == 1
    assert inflation(ratios / 4, [0.5, 1.5, 3.0]) == 3  # the larger one counts
    assert inflation([*np.full(17, 0.5), 9.0]) == 1  # of 18, one may be outside


def stays(recording):
    """An estimator that stays where the last position was."""
    (samples,) = recording.samples()
    place = samples[MEASUREMENTS[:2]].ffill().set_axis(ESTIMATE[:2], axis=1)
    return samples.join(place).assign(sigma_x_m=3.0, sigma_y_m=3.0)


def test_hidden_positions_show_how_far_off_an_estimate_is():
    """One that stays where the last position was is 2 m and 10 m off at 1 m/s."""
    t = np.arange(0, 100, 0.2)
    log = pd.DataFrame(dict(t_s=t, x_m=t, y_m=0.0, speed_mps=1.0, yaw_rate_radps=0.0))
    hidden = hidden_errors(prepare(log), stays)
    # All tens of seconds but the first.
    np.testing.assert_allclose(hidden["error_m"], [10.0] * 9, atol=1e-6)
    np.testing.assert_allclose(hidden["after_s"], 10.0)
    np.testing.assert_allclose(hidden["ratio"], 10.0 / (2.236 * 3.0))


def test_a_yaw_counts_where_a_robot_has_driven_eight_metres():
    """Of one whose σ is as many rad as it has driven metres, until 20 m, the median is 14 rad."""
    t = np.arange(0, 20, 0.2)
    log = pd.DataFrame(dict(t_s=t, x_m=t, y_m=0.0, speed_mps=1.0, yaw_rate_radps=0.0))

    def estimator(recording):
        return stays(recording).assign(theta_hat_rad=0.0, sigma_theta_rad=t)

    recording = prepare(log)
    _, numbers = judge(recording, estimator, estimator(recording), (0.0, 0.0))
    assert numbers["yaw_sigma_rad"] / numbers["inflation"] == pytest.approx(14, abs=0.2)


@pytest.mark.parametrize("offset", [0, 1, 2, 3, 4])
def test_gnss_of_1_hz_is_tested_whatever_its_phase(offset):
    log = LOG.copy()
    log.loc[log.index % 5 != offset, ["x_m", "y_m"]] = np.nan
    assert len(hidden_errors(prepare(log), stays)) >= 5


def test_what_a_check_warns_of_is_not_trusted():
    page = str(rhec.log(LOG.assign(x_m=LOG["x_m"] + 420e3 * (LOG["t_s"] > 36)))).splitlines()
    assert page[-2].startswith("Do not trust it yet: the log's x_m, y_m jump by 420 km")
    assert page[-1].startswith("Warnings: The log's x_m, y_m jump by 420 km")


def at_mu(mu):
    """The log of a robot whose μ is so large."""
    return LOG.assign(speed_mps=MU / mu * LOG["speed_mps"])


WORDS = "is no traction", "times too small", "could be hidden", "κ is above 1"
# {a log: (it, the doubts that are said of it)}
DOUBTS = {
    "μ of 1.3": (at_mu(1.3), []),
    "μ of 1.45": (at_mu(1.45), ["times too small"]),
    "μ of 1.55": (at_mu(1.55), ["is no traction", "times too small"]),
    "κ of 1.25": (LOG.assign(yaw_rate_radps=0.8 * LOG["yaw_rate_true_radps"]), ["κ is above 1"]),
    "36 s": (recorded_log(5.0, 36.0, noise_m=0.02, seed=3), []),
    "33 s": (recorded_log(5.0, 33.0, noise_m=0.02, seed=3), ["could be hidden"]),
    "κ of 1.003": (LOG.assign(yaw_rate_radps=0.997 * LOG["yaw_rate_true_radps"]), []),
}


@pytest.mark.nightly(keep=6)
@pytest.mark.parametrize("what", DOUBTS)
def test_a_doubt_begins_at_an_amount(what):
    log, doubts = DOUBTS[what]
    summary = rhec.log(log, trust_log=True)
    assert [words for words in WORDS if any(words in each for each in summary.doubts)] == doubts
    too_short = "Cannot tell yet: the log is too short to tell μ: drive for a minute"
    assert summary.verdict.startswith(too_short) == what.endswith(" s")


def test_a_note_is_no_warning():
    page = str(rhec.log(LOG.assign(x_m=LOG["x_m"] + 4.0 * (LOG.index == 200)))).splitlines()
    assert page[-3].startswith("Trust it.") and page[-2] == "Warnings: none."
    assert page[-1].startswith("Notes: 2 of ") and "than the robot drives" in page[-1]
