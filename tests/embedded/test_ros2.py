"""The ROS 2 package of an export: its node, compiled against stand-ins for rclcpp and the messages,
answers like Python's live objects, and no message stops it.
"""

import io
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import no_compiler

import rhec
from rhec import paper
from rhec.core._casadi import compiled
from rhec.logs.reader import degrees_at
from rhec.simulation import closed_loop
from rhec.simulation.columns import MEASUREMENTS, SENSORS
from rhec.workbench.command_line import main

STAND_INS = Path(__file__).with_name("ros2")
SCENARIO = rhec.Scenario(duration_s=40.0, seed=1)
STRAIGHT = rhec.Path.from_segments([(4.0, 0.0)])
OTHERS = {
    "open": dict(path=STRAIGHT, estimator="ekf", process_noise="calibrated"),
    "cautious": dict(estimator="bounded_ekf", cautious=True, backwards=True),
    "sensors": dict(
        speed_model="input", process_noise="consistent", sensors=("gyro", "heading"), seed=3
    ),
}
compilers = pytest.mark.skipif(
    not (compiled.compiler() and shutil.which("g++")), reason="there is no compiler for C and C++"
)


@pytest.fixture(scope="module")
def packaged(tmp_path_factory):
    """name of a scenario -> its ROS 2 package, made once."""
    made = {}

    def package(name):
        if name not in made:
            changed = dict(duration_s=20.0) | OTHERS[name] if name != "default" else {}
            scenario = rhec.Scenario(**changed) if changed else SCENARIO
            folder = tmp_path_factory.mktemp("ros2") / name
            made[name] = rhec.export(scenario, folder, ros2=True)
        return made[name]

    return package


@pytest.fixture(scope="module")
def nodes(packaged, tmp_path_factory):
    """name of a scenario -> the program that drives its node, compiled once."""
    made = {}

    def node(name):
        if name not in made:
            package = packaged(name)
            folder = tmp_path_factory.mktemp("node")
            objects = [folder / "rhec.o", folder / "rhec_scenario.o"]
            for file in objects:
                source = package / "c" / f"{file.stem}.c"
                command = [compiled.compiler(), "-std=c99", "-ffp-contract=off"]
                subprocess.run([*command, "-c", source, "-o", file], check=True)
            strict = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
            includes = [f"-I{STAND_INS}/include", f"-I{package}/src", "-isystem", package / "c"]
            made[name] = folder / "drive"
            sources = [STAND_INS / "drive.cpp", *objects]
            command = ["g++", *strict, *includes, *sources, "-o", made[name], "-lm"]
            subprocess.run(command, check=True)
        return made[name]

    return node


def drive(program, table, **parameters):
    """The answers of a node to a table of measurements, (samples, up to 6)."""
    given = dict(enabled="true", start="scenario") | parameters
    words = [f"{name}={value}" for name, value in given.items()]
    text = pd.DataFrame(table).to_csv(header=False, index=False, na_rep="nan")
    done = subprocess.run([program, *words], input=text, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return pd.read_csv(io.StringIO(done.stdout))


@pytest.fixture(scope="module")
def measured(packaged):
    """The measurements of the default package's log, some of them missing."""
    z = pd.read_csv(packaged("default") / "c/log.csv")[MEASUREMENTS].to_numpy()
    z[60:75, :2] = np.nan
    return z


def angle(yaw):
    return (yaw + np.pi) % (2 * np.pi) - np.pi


# What the node computes


@compilers
def test_it_answers_like_the_live_objects(nodes, measured):
    setup = closed_loop.set_up(SCENARIO)
    rhe, rhc = rhec.RHE(guess=tuple(setup.guess)), rhec.RHC()
    tracker = rhec.PathTracker(setup.path)
    expected = []
    for z in measured:
        rhe.prepare()
        rhc.prepare()
        estimate = rhe.feedback(z)
        xi_ref, omega_ref = tracker.references(estimate, z[3])
        omega = rhc.feedback(estimate.pose, estimate.p, xi_ref, omega_ref)
        P = estimate.covariance
        expected.append([*estimate.pose, P[0, 0], P[2, 2], omega, estimate.mu])
    expected = np.array(expected)
    expected[:, 2] = angle(expected[:, 2])
    found = drive(nodes("default"), measured, stop_after_s=5.0)
    names = ["x", "y", "yaw", "variance_x", "variance_yaw", "omega"]
    np.testing.assert_allclose(found[names], expected[:, :6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["mu"], expected[:, 6], rtol=0, atol=1e-6)  # as text
    assert (found["nu"] == SCENARIO.speed_mps).all()


@compilers
@pytest.mark.parametrize("name", ["cautious", "sensors"])
def test_other_exports_answer_like_simulate(name, packaged, nodes):
    log = pd.read_csv(packaged(name) / "c/log.csv")
    table = pd.DataFrame(np.nan, index=log.index, columns=[*MEASUREMENTS, "gyro", "heading"])
    table[MEASUREMENTS] = log[MEASUREMENTS]
    for sensor, column in SENSORS.items():
        if column in log:
            table[sensor] = log[column]
    found = drive(nodes(name), table)
    expected = log[["x_hat_m", "y_hat_m", "omega_cmd_radps"]]
    tolerance = 1e-9 if name == "cautious" else 1e-7  # the heading travels as a quaternion
    np.testing.assert_allclose(found[["x", "y", "omega"]], expected, rtol=0, atol=tolerance)
    if name == "cautious":
        assert found["nu"].between(-0.5, 0).all() and found["nu"].nunique() > 2


@compilers
def test_other_messages_give_the_same_drive(nodes, measured):
    expected = drive(nodes("default"), measured)
    origin = (40.07, -88.21, 0.0)
    degrees = measured.copy()
    degrees[:, 1], degrees[:, 0] = degrees_at(measured[:, 0], measured[:, 1], origin)
    sent = dict(position="fix", origin_latitude_deg=origin[0], origin_longitude_deg=origin[1])
    sent |= dict(encoders="joint_states", wheel_radius_m=0.08, track_width_m=0.33, repeat=3)
    found = drive(nodes("default"), degrees, **sent)
    # Out of the plane, the robot is lower than the origin by the earth's curvature.
    np.testing.assert_allclose(found[["x", "y"]], expected[["x", "y"]], rtol=0, atol=2e-3)
    np.testing.assert_allclose(found["omega"], expected["omega"], rtol=0, atol=1e-2)


# What it does where something is missing or absurd


@compilers
def test_no_message_stops_it(nodes, measured):
    rng = np.random.default_rng(0)
    absurd = np.array([np.nan, np.inf, -np.inf, 1e300, -1e9, 0.0])
    broken = np.where(
        rng.random(measured.shape) < 0.4, rng.choice(absurd, measured.shape), measured
    )
    for sent in (dict(), dict(position="fix"), dict(encoders="joint_states", wheel_radius_m=0.1)):
        given = sent | dict(nonsense=1, track_width_m=0.4)
        found = drive(nodes("default"), broken, **given)
        assert len(found) == len(measured) and (found["published"] == 1).all()
        assert np.isfinite(found.drop(columns=["variance_x", "variance_yaw"])).all(axis=None)
        assert found["omega"].abs().max() <= paper.OMEGA_MAX_RADPS
        assert set(found["nu"]) <= {0.0, SCENARIO.speed_mps}


@compilers
def test_it_finds_back_after_nonsense(nodes, measured):
    broken = measured.copy()
    broken[100:110] = 1e300
    tail = slice(160, None)
    both = [drive(nodes("default"), z, nonsense=1)[["x", "y"]][tail] for z in (measured, broken)]
    np.testing.assert_allclose(*both, rtol=0, atol=0.1)


@compilers
def test_it_stands_without_positions_and_drives_again(nodes, measured):
    blind = measured.copy()
    blind[100:130, :2] = np.nan
    found = drive(nodes("default"), blind, stop_after_s=2.0)
    stands = found["nu"] == 0
    np.testing.assert_array_equal(np.flatnonzero(stands), np.r_[70:75, 110:130])
    assert (found.loc[stands, "omega"] == 0).all()
    assert (drive(nodes("default"), blind, enabled="false")[["nu", "omega"]] == 0).all(axis=None)


@compilers
def test_it_starts_at_the_first_position(nodes, measured):
    late = measured.copy()
    late[:7, :2] = np.nan
    late[:, 0] += 500.0
    found = drive(nodes("default"), late, start="first_position", initial_yaw_rad=0.1)
    assert (found["published"][:7] == 0).all() and (found["published"][7:] == 1).all()
    np.testing.assert_allclose(found[["x", "y"]].iloc[7], late[7, :2], rtol=0, atol=0.01)
    assert abs(found["yaw"][7] - 0.1) < 0.05


@compilers
def test_it_stands_at_the_end_of_an_open_path(packaged, nodes):
    x = 0.1 * np.arange(80)
    table = np.column_stack([x, 0 * x, np.full(80, 0.5), 0 * x])
    found = drive(nodes("open"), table)
    speeds = found["nu"].to_numpy()
    assert speeds[x < 3.5].min() == 0.5 and speeds[x > 4.5].max() == 0


@compilers
@pytest.mark.parametrize(
    "name, value, sentence",
    [
        ("position", "gps", "position was 'gps'; it should be 'odometry' or 'fix'"),
        ("start", "", "start was ''; it should be 'first_position' or 'scenario'"),
        ("wheel_radius_m", "-1", "wheel_radius_m was -1.000000; it should be above 0"),
        ("speed_mps", "nan", "speed_mps was nan; it should be finite"),
    ],
)
def test_a_wrong_parameter_is_named(name, value, sentence, nodes):
    program = [nodes("default"), f"{name}={value}"]
    done = subprocess.run(program, input="", capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr == f"{sentence}\n"


# The package


def test_the_manifest_names_what_the_node_includes(packaged):
    package = packaged("default")
    manifest = ElementTree.parse(package / "package.xml").getroot()
    named = {element.text for element in manifest.findall("depend")}
    node = (package / "src/rhec_node.hpp").read_text()
    assert named == set(re.findall(r"#include <(\w+)/", node))
    assert manifest.find("version").text == rhec.__version__
    built = (package / "CMakeLists.txt").read_text()
    assert all(name in built for name in named)
    assert not any("@" in file.read_text() for file in (package / "config").iterdir())


def test_the_parameters_of_the_file_are_those_of_the_node_and_of_the_readme(packaged):
    package = packaged("default")
    in_file = set(re.findall(r"^    (\w+):", (package / "config/rhec.yaml").read_text(), re.M))
    node = (package / "src/rhec_node.hpp").read_text()
    declared = r'(?:number|is_second|positive|finite|parameter<[\w:]+>)\(\s*"(\w+)"'
    readme = (package / "README.md").read_text().split("| parameter |")[1]
    described = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\| (`.*?) \|", readme, re.M))))
    assert in_file == set(re.findall(declared, node)) == described


@compilers
def test_ament_builds_it(packaged, tmp_path):
    python = "/usr/bin/python3"
    probe = [python, "-c", "import ament_package"]
    if not Path(python).exists() or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("there is no ament_cmake (Debian: ament-cmake)")
    stubs = [
        f"-D{file.name.removesuffix('Config.cmake')}_DIR={file.parent}"
        for file in (STAND_INS / "cmake").glob("*Config.cmake")
    ]
    options = ["-DCMAKE_BUILD_TYPE=Debug", f"-DPython3_EXECUTABLE={python}"]
    installed = tmp_path / "installed"
    for command in (
        ["-S", packaged("default"), "-B", tmp_path / "built", *options, *stubs],
        ["--build", tmp_path / "built"],
        ["--install", tmp_path / "built", "--prefix", installed],
    ):
        done = subprocess.run(["cmake", *command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    names = {str(path.relative_to(installed)) for path in installed.rglob("*")}
    share = "share/rhec_ros2"
    wanted = {"package.xml", "config/rhec.yaml", "launch/rhec.launch.xml"}
    assert names >= {f"{share}/{name}" for name in wanted} | {"lib/rhec_ros2/rhec_node"}


def test_an_earlier_package_is_replaced_and_nothing_else(packaged, tmp_path):
    folder = shutil.copytree(packaged("default"), tmp_path / "mine")
    (folder / "src/rhec_node.hpp").write_text("broken")
    with no_compiler():
        assert main(["export", "--ros2", str(folder), "--duration-s", "2"]) == 0
    same = (folder / "src/rhec_node.hpp", packaged("default") / "src/rhec_node.hpp")
    assert same[0].read_text() == same[1].read_text()
    with pytest.raises(ValueError, match="which contains other files"):
        rhec.export(SCENARIO, folder)
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(ValueError, match="which contains other files"):
        rhec.export(SCENARIO, tmp_path, ros2=True)


def test_what_no_package_can_be_made_of_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"^ros2 was 1; it should be True or False$"):
        rhec.export(SCENARIO, tmp_path, ros2=1)
    model = rhec.Model(
        states=("x_m",), inputs=("v_mps",), parameters={}, outputs=("x_m",), f=lambda x, u, p: u
    )
    rhe = rhec.RHE(
        model=model, dt=0.2, horizon=5, sigma_v=(0.1,), sigma_w=(0.1,), guess=(0,), sigma_guess=(1,)
    )
    with pytest.raises(ValueError, match=r"^ros2 was True, which needs a rhec.Scenario"):
        rhec.export(rhe, tmp_path, ros2=True)
