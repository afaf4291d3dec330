"""The live page without a browser: what it is built from equals what `rhec.simulate` uses."""

import base64
import ctypes
import gzip
import json
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from bs4 import BeautifulSoup

import rhec
from docs.live import functions, page, wasm, window
from docs.live.plants import plants_of
from docs.site import report
from rhec import paper
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE, MEASUREMENTS
from rhec.tracked_robot import tuning
from rhec.tracked_robot.references import padded_segments

START = dict(start_offset_m=-0.8, start_yaw_rad=0.5, guess_yaw_rad=0.1, speed_mps=0.6)


def unpack(text, kind):
    """An array that the page loads as text."""
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), dtype=kind)


def compiled_text(text, folder):
    """The library of a C text, and a function from an array's name and length to its numbers."""
    (folder / "code.c").write_text(text, encoding="utf-8")
    options = ["-shared", "-fPIC", "-w", "-ffp-contract=off", "code.c", "-lm", "-o", "code.so"]
    subprocess.run([compiled.compiler(), *options], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "code.so"))

    def array(name, length):
        return np.ctypeslib.as_array((ctypes.c_double * length).in_dll(library, f"at_{name}"))

    return library, array


def soil_of(world, data, scenario, kind):
    """The slip field (2, grid) as the loop reads it, beyond its edge as on it, and its corner."""
    n_x, n_y = world["soil_shape"]
    apart = unpack(data["soils"][kind], np.uint16).reshape(2, n_x, n_y)
    steps = apart.cumsum(axis=1, dtype=np.uint16).cumsum(axis=2, dtype=np.uint16)
    field = world["fields"][scenario.turns]
    beyond_m = field["margin_m"] + abs(scenario.start_offset_m)
    corner = np.subtract(field["lowest"], beyond_m)
    end = np.add(field["highest"], beyond_m)
    rows, columns = np.ceil((end - corner) / world["cell_m"]).astype(int) + 1
    own = world["traction_step"] * steps[:, :rows, :columns]
    return np.pad(own, ((0, 0), (0, n_x - rows), (0, n_y - columns)), "edge"), corner


@pytest.mark.parametrize(
    "name, kind, turns, seed, fault",
    [
        ("rhe_faulty", "soft", "left", 4, "positions 2 m off for 10 s"),
        ("ekf_faulty", "default", "alternate", 9, "no GNSS for 5 s"),
    ],
)
def test_what_the_page_loads_drives_as_simulate_does(
    name, kind, turns, seed, fault, monkeypatch, tmp_path
):
    """To what 16 bits of noise and soil leave; here Python fills the arrays, as scripts do."""
    monkeypatch.setattr(wasm, "module_of", str.encode)
    world = page._world()
    data = page.seed_data(seed)
    made = json.loads(json.dumps(page._module(page.STRUCTURES[name]), allow_nan=False))
    rule = "consistent"
    own = made["line"] | START | page.SOILS[kind] | dict(turns=turns, seed=seed)
    faults = eval(world["faults"][fault], dict(rhec=rhec))
    scenario = rhec.Scenario(**own, faults=faults, process_noise=rule, duration_s=60.0)
    run = rhec.simulate(scenario)
    n = len(run.log)
    field = world["fields"][turns]
    noise = world["noise"]["step"] * unpack(data["noise"], np.int16)
    stream = unpack(data["faults"][fault], float).reshape(-1, world["n_fault"])
    noise = np.hstack([noise.reshape(-1, world["noise"]["n"]), stream])
    slip, corner = soil_of(world, data, scenario, kind)
    slopes = [START[of] * np.array(slope) for of, slope in made["directions"].items()]
    given = made["settings"] | {of: own[of] for of in made["settings"] if of in own}
    given |= dict(noise=noise[:n], slip=slip.T, origin_m=corner)
    given |= dict(memory=np.array(made["memory"], float) + sum(slopes), cell_m=world["cell_m"])
    given |= {of: np.square(made["noises"][rule][f"sigma_{of.lower()}"]) for of in "WV"}
    given |= dict(padded_segments=field["segments"])
    given |= {of: field[of] for of in ("period_m", "length_m")}
    text = unpack(made["wasm"], np.uint8).tobytes().decode()
    library, array = compiled_text(text, tmp_path)
    for of, values in given.items():
        array(of, np.size(values))[:] = np.ravel(values)
    assert library.run(n) == 0
    found = dict(zip(COLUMNS, array("row", len(COLUMNS) * n).reshape(n, -1).T))
    found |= dict(zip(functions.ERRORS, array("errors", 4 * n).reshape(n, 4).T))
    left = found.pop("left_m")
    np.testing.assert_allclose(np.abs(left), found["error_true_m"], atol=1e-12)
    assert left[0] == START["start_offset_m"]
    for of, values in found.items():
        expected = run.columns[of].astype(float)
        np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-3, err_msg=of)
    # What pictures show of the memory is where it is said to be.
    setup = closed_loop.set_up(scenario)
    pieces = setup.unpack(setup.memory)
    pieces = pieces["estimator"] | dict(plan=pieces["controller"]["s"])
    for of, places in made["places"].items():
        np.testing.assert_array_equal(setup.memory[places], np.atleast_2d(pieces[of].T), of)
    assert len(made["places"]) == (1 if scenario.estimator == "ekf" else 4)
    assert made["faulty"] and {*made["noises"]} == {*page.RULES}
    assert len(made["states"]) == len(setup.settings["W"])
    # There is room for the longest run; the memory has one entry more, the first.
    room = dict(re.findall(r"^double at_(\w+)\[(\d+)\];", text, re.M))
    longest = world["max_samples"]
    assert int(room["memory"]) == (longest + 1) * len(made["memory"])
    assert int(room["row"]) >= longest * len(COLUMNS) and room["length_m"] == "1"


@pytest.mark.parametrize("turns", page.TURNS.values())
def test_the_closest_point_of_the_whole_path_is_that_of_the_path(turns):
    """Anywhere on the field, and to the left of a row and of both kinds of turns."""
    path = rhec.Path.rows(paper.ROW_LENGTH_M, paper.HEADLAND_RADIUS_M, turns)
    segments = ca.DM(padded_segments(path).T)
    place = ca.SX.sym("place", 2)
    found = functions.closest(*ca.vertsplit(place), segments, path.length_m)
    closest = ca.Function("closest", [place], [ca.vertcat(*found)])
    xy = np.random.default_rng(0).uniform(-20, 60, (400, 2))
    distances, _ = path.project(xy)
    np.testing.assert_allclose(closest(xy.T).full()[0], distances, atol=1e-12)
    s = np.linspace(0, path.length_m, 60, endpoint=False) + 0.1
    poses, curvatures = path.poses(s)
    x, y, theta = poses.T
    beside = closest(np.array([x - 0.2 * np.sin(theta), y + 0.2 * np.cos(theta)])).full()
    # Where an eight crosses itself, or another row is as near, there is no side.
    has_side = beside[0] > 0.2 - 1e-9
    assert has_side.mean() > 0.8
    np.testing.assert_allclose(beside[1][has_side], 0.2)
    np.testing.assert_allclose(beside[2][has_side], curvatures[has_side])


@pytest.mark.parametrize("turns", page.TURNS.values())
def test_the_line_that_is_drawn_is_the_path_in_equal_steps(turns):
    path = rhec.Path.rows(paper.ROW_LENGTH_M, paper.HEADLAND_RADIUS_M, turns)
    field = page.fields_of_turns()[turns]
    line = np.array(field["path"])
    distances, _ = path.project(line)
    assert distances.max() < 1e-3  # it is rounded to a millimetre
    ends = line.min(axis=0), line.max(axis=0)
    np.testing.assert_allclose([field["lowest"], field["highest"]], ends, atol=0.02)
    steps = np.hypot(*np.diff(line, axis=0, append=line[:1]).T)
    assert 0.97 * field["path_step_m"] < steps.min() and steps.max() < 1.003 * field["path_step_m"]
    assert len(line) * field["path_step_m"] == pytest.approx(path.length_m)


def test_every_parameter_that_moves_has_a_slider_around_its_first_value():
    world = page._world()
    sliders = [slider for group in world["groups"].values() for slider in group]
    assert {slider["field"] for slider in sliders} == page._FIELDS | {"patch"}
    for scene in world["scenes"].values():
        values = scene["values"] | dict(patch=world["new_patch"])
        for slider in sliders:
            value = np.atleast_1d(values[slider["field"]])[slider["place"] or 0]
            place = np.log10(value) if slider["kind"] == "log" else value
            assert slider["low"] <= place <= slider["high"], slider


def test_what_is_written_arrives_under_its_name(monkeypatch, tmp_path):
    """Beside the page are the scripts and styles that it loads."""
    monkeypatch.setattr(page, "ProcessPoolExecutor", lambda mp_context: ThreadPoolExecutor())
    monkeypatch.setattr(page, "_module", lambda own: dict(of=sorted(own)))
    monkeypatch.setattr(page, "_tools", lambda: dict(order=["shift"]))
    monkeypatch.setattr(page, "SEEDS", range(1))
    page.write(tmp_path)
    arrived = {}
    for file in (tmp_path / "live").glob("*.js"):
        if data := re.fullmatch(r"live\.arrived\('(\w+)', (.*)\)\n", file.read_text("utf-8")):
            arrived[file.stem] = json.loads(data[2])
            assert data[1] == file.stem
    world = arrived.pop("world")
    assert len(world["seeds"]) == 1 and world["windows"] == [5, 10, 15, 30]
    assert arrived.pop("seed_0") == page.seed_data(0)
    assert arrived.pop("tools") == dict(order=["shift"])
    assert arrived == {name: dict(of=sorted(own)) for name, own in page.STRUCTURES.items()}
    html = BeautifulSoup((tmp_path / "live.html").read_text("utf-8"), "html.parser")
    linked = html.select("script, link[rel=stylesheet]")
    loaded = [each.get("src") or each["href"] for each in linked]
    assert loaded and all((tmp_path / file).exists() for file in loaded)
    # With the quotes that stand in them.
    tooltips = [slider["tooltip"] for group in world["groups"].values() for slider in group]
    assert [label["title"] for label in html.select("#sliders label[title]")] == tooltips


def test_the_scenes_are_those_of_their_words():
    """Weights by their names, the sensor that fails when it is said, and what has no slider."""
    world = page._world()
    scenes = world["scenes"]
    weights = [dict(q=paper.Q1), dict(q=paper.Q2), dict(q=paper.Q3)]
    assert [own for _, _, own in scenes["a"]["runs"]] == weights
    faulty = {n for n, of in page.STRUCTURES.items() if of.get("faults")}
    assert {module for _, module, _ in scenes["faults"]["runs"]} <= faulty
    shown = {name: [(of.start_s, of.end_s) for of in fault] for name, fault in page.FAULTS.items()}
    assert world["shaded"] == shown and all(end > start for ((start, end),) in shown.values())
    assert not any(rhec.Scenario(faults=of).sensors for of in page.FAULTS.values())
    rhe = tuning.NOISES["rhe"][tuning.DEFAULT_RULE]._asdict()
    for name, scene in scenes.items():
        ((start_s, _),) = world["shaded"][scene["fault"]]
        said = re.findall(r"fails at (\d+) s", scene["about"])
        assert [float(number) for number in said] == [start_s] * len(said), name
        usual = vars(rhec.Scenario()) | rhe | dict(duration_s=scene["duration_s"])
        assert scene["values"] == {key: usual[key] for key in page._FIELDS}
        assert scene["duration_s"] > scene["time_s"]
    assert world["robot_m"] == (paper.ROBOT_LENGTH_M, paper.ROBOT_WIDTH_M)
    assert world["default_rule"] == tuning.process_noise_of(rhec.Scenario())
    text = (page.HERE / "live.html.j2").read_text(encoding="utf-8")
    assert "of the ten seeds" in text and [*page.SEEDS] == [*range(10)]


def test_without_a_compiler_the_page_is_left_out_and_the_report_says_so(monkeypatch, capsys):
    built = []
    monkeypatch.setattr("sys.argv", ["report", "one.ipynb"])
    monkeypatch.setattr(report, "build", lambda notebooks, live: built.append(live))
    for can_compile in (False, True):
        monkeypatch.setattr(wasm, "can_compile", lambda can_compile=can_compile: can_compile)
        report._main()
        assert ("without the live page" in capsys.readouterr().out) != can_compile
    assert built == [False, True]


def test_the_arrays_of_a_module_are_exported(monkeypatch, tmp_path):
    def command_as_module(command, sources):
        code = (Path(sources) / "code.c").read_text()
        Path(command[command.index("-o") + 1]).write_text("\n".join([*command, code]))

    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(compiled, "run_compiler", command_as_module)
    monkeypatch.setattr(wasm, "find_spec", lambda name: SimpleNamespace(origin=name))
    text = "double at_one[3];\nstatic double w[2];\ndouble at_two[1];\n"
    made = wasm.module_of(text).decode()
    exported = re.findall(r"--export=(\w+)$", made, re.M)
    assert {"at_one", "at_two"} == {name for name in exported if name.startswith("at_")}
    assert made.endswith(text)


@pytest.fixture(scope="module")
def story():
    """The story's Functions, what the page loads of them, and a drive with its setup."""
    scenario = rhec.Scenario(process_noise="prediction", duration_s=20.0)
    tools = window.build_tools(scenario)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wasm, "module_of", lambda text: b"")
        patch.setattr(window, "build_tools", lambda scenario: tools)
        made = page._tools()
    setup = closed_loop.set_up(scenario)
    run = rhec.simulate(scenario)
    z = np.column_stack([run.columns[name] for name in MEASUREMENTS])
    # The memory of the check of positions follows.
    memory = setup.memory[made["first"] :][: tools["shift"].size1_in("memory")]
    return SimpleNamespace(tools=tools, made=made, setup=setup, memory=memory, z=z, run=run)


def test_shift_and_solve_are_a_sample_of_the_rhe(story):
    """Their estimates are those of the run; without bounds they may leave 0 to 1."""
    tools = story.tools
    memory = story.memory
    pieces = story.setup.unpack(story.setup.memory)["estimator"]
    for name, places in story.made["places"].items():
        np.testing.assert_array_equal(memory[places], np.atleast_2d(pieces[name].T), name)
    given = dict(V=story.setup.settings["V"], P_0=story.made["P_0"])
    beyond = 0
    for k, z_N in enumerate(story.z):
        memory = tools["shift"](memory=memory, V=given["V"], W=story.setup.settings["W"])["memory"]
        free = tools["free"](memory=memory, z_N=z_N, **given)["estimate"].full().ravel()
        found = tools["solve"](memory=memory, z_N=z_N, **given)
        memory = found["memory"]
        estimate = found["estimate"].full().ravel()
        expected = [story.run.columns[name][k] for name in ESTIMATE]
        np.testing.assert_allclose(estimate, expected, atol=1e-9)
        beyond += free[5] > 1 + 1e-6
        if np.all((free[4:] > 0) & (free[4:] < 1)):
            np.testing.assert_allclose(free, estimate, atol=1e-12)
    assert 0 < beyond < len(story.z)


def test_the_storys_other_filters_begin_at_the_loops_guess(story):
    """The Kalman filter with the RHE's first covariance."""
    guess = np.arange(1.0, 7.0)
    found = window.first_memories(rhec.Scenario(), guess)
    assert {*found} == {"shortest", "shortest_free", "kalman"}
    # Both nodes of one interval and the arrival cost's mean are the guess.
    assert [np.sum(memory == guess[-1]) for memory in found.values()] == [1, 3, 3]
    for name, memory in found.items():
        assert len(memory) == story.tools[name].size1_in("memory")
        assert np.isin(guess, memory).all()
    P = story.setup.unpack(story.setup.memory)["estimator"]["P"]
    np.testing.assert_allclose(found["kalman"][:42], [*guess, *P.ravel()])


def test_the_storys_c_calls_the_function_that_is_asked_for(story, tmp_path):
    some = {name: story.tools[name] for name in ("shift", "reckon")}
    library, array = compiled_text(window.c_text(some), tmp_path)
    given = dict(memory=story.memory, pose=[1.0, 2.0, 0.3], z_N=story.z[3])
    given |= {name: story.setup.settings[name] for name in ("V", "W")}
    for which, (name, function) in enumerate(some.items()):
        for of in function.name_in():
            array(f"{name}_{of}", function.nnz_in(of))[:] = given[of]
        assert library.run(which) == 0
        results = function(**{of: given[of] for of in function.name_in()})
        for of, expected in results.items():
            found = array(f"{name}_new_{of}", function.nnz_out(of))
            np.testing.assert_allclose(found, expected.nonzeros(), atol=1e-12)
    assert library.run(len(some)) == 1


def test_dead_reckoning_takes_the_encoders_at_their_word(story):
    """A circle of one radius: speed over yaw rate."""
    pose = np.zeros(3)
    for _ in range(100):
        pose = story.tools["reckon"](pose=pose, z_N=[9.0, 9.0, 0.5, 0.25])["pose"]
    x, y, theta = pose.full().ravel()
    expected = 2 * np.sin(5), 2 - 2 * np.cos(5), 5
    assert (x, y, theta) == pytest.approx(expected, abs=1e-6)


def test_a_robot_in_the_middle_of_its_row_is_one_tolerance_away_from_the_leaves():
    path = closed_loop.set_up(rhec.Scenario()).path
    plants = plants_of(path)
    for place, away in ((plants[:, :2], 0.0), (plants[:, 2:], 0.1)):
        distance, _ = path.project(place)
        free = paper.ROBOT_WIDTH_M / 2 + paper.TOLERANCE_M
        np.testing.assert_allclose(distance, free + away, atol=1e-9)
    # Beside four rows of 30 m, of which the first and the last go on by an eighth of the distance
    # of two rows, one plant on either side every 0.15 m; none on the way back along the headland.
    assert len(plants) == 2 * round((4 * 30.0 + 2 * 7.8 / 4) / 0.15)
    assert len(np.unique(plants.round(6), axis=0)) == len(plants)
    assert plants[:, 0].min() > -7.8 / 4 - 0.15
