"""Pictures and tables in git are what the code makes of the drives and tables in git.

Of pictures, small copies are kept beside this file: of those of many drives, with a few.
"""

import functools
import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import rhec
from docs.site.check_figures import difference
from notebooks.further import (
    faults,
    recorded_logs,
    recorded_logs_plots,
    traction_worth_plots,
    your_robot,
)
from notebooks.further.recorded import scores
from notebooks.plots import robot_drawings, scenarios, which_worlds
from notebooks.plots.timing import phases
from notebooks.studies import order_in_worlds, scenario_tables
from notebooks.studies import which_worlds as worlds
from rhec import paper, style


def table(name):
    return pd.read_csv(style.ROOT / f"data/results/{name}.csv")


@functools.cache
def pairs():
    """The drives of Figures 7 and 8, the same field with W by each rule."""
    return {
        noise: scenario_tables.rhe_and_ekf(process_noise=noise, seed=0, turns="alternate")
        for noise in scenario_tables.PROCESS_NOISES
    }


@functools.cache
def inverse():
    """What notebook 07 shows: the posterior's worlds, and its tables."""
    drives = worlds.prior_drives()
    table = worlds.simulations(drives, worlds.both_rounds(drives))
    drawn, *_ = worlds.posterior_draws(table, 2000, 0)
    learned = worlds.learned(drawn)
    after = worlds.statistics_with_own_w(
        worlds.posterior_drives()["posterior"], worlds.posterior_table()
    )
    of_w = table.statistics.reshape(len(worlds.CHOICES), -1, len(worlds.STATEMENTS))
    before = of_w[:, : worlds.FIELDS * worlds.FIRST_ROUND]
    effective = order_in_worlds.effective_worlds()
    parts = {"prior": worlds.shares(before), "posterior": worlds.shares(after, effective)}
    statements = pd.concat(parts, axis=1)
    tables = dict(
        inverse_posterior=learned.reset_index(),
        inverse_statements=statements.set_axis(map(" ".join, statements), axis=1).reset_index(),
        inverse_default=worlds.beside_the_default().reset_index(),
        inverse_rules=order_in_worlds.rule_rows(order_in_worlds.order_drives(), effective),
    )
    return (drawn, learned), tables


def yaw_weights():
    """The drives of Figure 6."""
    return {
        weight: rhec.simulate(rhec.Scenario(process_noise="printed", **choice))
        for weight, choice in scenario_tables.yaw_weights().items()
    }


def phases_of_the_paper():
    """Times of the paper's phases as if they had been taken here, a thousandth of them in µs."""
    rows = [
        (problem, phase, *times)
        for (problem, phase), times in paper.TABLE_1_MS.items()
        if phase != "overall"
    ]
    columns = ["problem", "phase", "minimum_us", "average_us", "maximum_us"]
    return pd.DataFrame(rows, columns=columns)


@functools.cache
def drives():
    """Two short drives of the RHE, and one on soft soil."""
    short = dict(duration_s=75.0, row_length_m=4.0)
    two = [
        rhec.simulate(rhec.Scenario(seed=seed, process_noise="prediction", **short))
        for seed in range(2)
    ]
    return two, [rhec.simulate(rhec.Scenario(duration_s=75.0, **rhec.WORLDS["soft"]))]


def estimates():
    two, soft = drives()
    return scenarios.estimates({"a title": two, "soft soil": soft})


def replay_yaw():
    """Of a log of two segments, in the second of which the first yaw is a turn off."""
    one = recorded_log(5.0, 30.0, noise_m=0.02, seed=1).assign(segment="a")
    turned = one.assign(segment="b", t_s=one["t_s"] + 30.0)
    log = pd.concat([one, turned], ignore_index=True)
    given = dict(process_noise="prediction", sigma_v=paper.SIGMA_V, trust_log=True)
    replays = {
        name: scores.perturbed_replay(log, 0, yaw_error_rad=off_rad, **given)
        for name, off_rad in (("RHE", 0.3), ("EKF", 3.0))
    }
    return recorded_logs_plots.replay_yaw(replays)


OWN_PATH = rhec.Path.from_segments([(20.0, 0.0)])
OWN_BOUNDS = {"left": (0.0, 0.7), "right": None}


def own_log():
    """Of one's own robot, 0.3 m beside the path, estimated 0.05 m off and slips by 0.02 and 0.04;
    1 more in the samples that do not count, the first half of each half.
    """
    n = 40
    early = np.where(np.repeat([False, True, False, True], n // 4), 0.0, 1.0)[:, None]
    x = np.column_stack([np.linspace(0, 10, n), np.full(n, -0.3), np.zeros(n)])
    x[:, 1:2] -= early
    slips = np.tile([0.1, 0.2], (n, 1))
    u = np.full((n, 2), 0.5)
    u[:3, 0] = 0.7
    u[3, 1] = 0.0
    return dict(
        x=x,
        z=np.hstack([x, u]) + 0.1,
        u=u,
        x_hat=x + (0.03, -0.04, 0.0) + early,
        p_hat=slips + (0.02, -0.04) + early,
        sigma=np.tile([9.0, 9.0, 9.0, 0.1, 0.2], (n, 1)),  # of the pose, then of the slips
        slips=slips,
    )


def own_slips():
    limits = dict.fromkeys(OWN_BOUNDS, (0.0, 0.7))
    return your_robot.parameters_and_commands(0.2 * np.arange(40), own_log(), OWN_BOUNDS, limits)


PICTURES = {
    "fig01_robot_in_row": robot_drawings.robot_in_row,
    "fig02_robot_parts": robot_drawings.robot_parts,
    "fig03_hardware": robot_drawings.hardware_blocks,
    "fig04_schematic": robot_drawings.schematic,
    "fig05_phases": lambda: phases(phases_of_the_paper(), "another computer"),
    "fig06_yaw_weight": lambda: scenarios.trajectories_q(yaw_weights(), table("table_scenario_a")),
    "fig07_trajectories": lambda: scenarios.trajectories(pairs()),
    "fig08_errors": lambda: scenarios.errors(pairs()),
    "fig09_violations": lambda: scenarios.violations(table("table_scenario_b")),
    "fig10_estimates": estimates,
    "fig11_speed": lambda: scenarios.speed(drives()[0]),
    "fig12_yaw_rate": lambda: scenarios.yaw_rate(pairs()["printed"]["RHE"]),
    "fig13_kkt": lambda: scenarios.kkt(drives()[0]),
    "inverse_posterior": lambda: which_worlds.posterior(*inverse()[0]),
    "replay_yaw": replay_yaw,
    "slip_fields": lambda: scenarios.slip_fields(
        pairs()["printed"]["RHE"].terrain, pairs()["printed"]["RHE"].path, "slip fields"
    ),
    "traction_map": lambda: traction_worth_plots.map_of_worth(
        table("table_traction_map").astype(dict(told=str))
    ),
    "your_robot_path": lambda: your_robot.positions(own_log(), OWN_PATH),
    "your_robot_slips": own_slips,
}


# A copy's pixel is the mean of so many times as many: processors may round an edge in another way.
SMALLER = 5
COPIES = Path(__file__).with_name("pictures")


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_drawn_as_its_copy_shows(name, tmp_path):
    figure = PICTURES[name]()
    pixels = io.BytesIO()
    assert figure.get_figwidth() in (style.COLUMN_IN, style.DOUBLE_IN)
    with mpl.rc_context(style.RC | {"figure.constrained_layout.use": False}):
        figure.savefig(pixels, format="rgba")
    size = figure.get_size_inches() * style.RC["savefig.dpi"]
    picture = Image.frombuffer("RGBA", (*size.astype(int).tolist(),), pixels.getvalue())
    small = picture.convert("RGB").reduce(SMALLER)
    copy = Image.open(COPIES / f"{name}.png")
    software = f"Matplotlib version{mpl.__version__}, https://matplotlib.org/"
    # Matplotlib's next version may put a letter elsewhere.
    if copy.text["Software"] == software:
        difference = np.abs(np.subtract(small, copy, dtype=int))
        if difference.max() > 8:
            about = PngInfo()
            about.add_text("Software", software)
            small.save(tmp_path / f"{name}.png", pnginfo=about)
        assert difference.max() <= 8, f"look at {tmp_path}; if it is right, it is the next copy"


def test_the_tables_in_git_are_what_the_drives_in_git_give(monkeypatch):
    """Of the table by how many simulations are kept, the first row."""
    monkeypatch.setattr(worlds, "KEPT", worlds.KEPT[:1])
    drives = worlds.prior_drives()
    made = worlds.simulations(drives, worlds.both_rounds(drives))
    kept = worlds.by_kept(made, 2000, 0).reset_index()
    expected = table("inverse_kept").head(1)
    assert difference(kept.astype(expected.dtypes), expected) == ""
    for name, made in inverse()[1].items():
        assert difference(made.astype(table(name).dtypes), table(name)) == "", name


def test_a_row_of_the_published_faults_is_what_its_drives_give():
    case = {"outage": {"10 s": faults.CASES["outage"]["10 s"]}}
    runs = faults.study(rhec.Scenario(process_noise="prediction"), range(6), {"RHE": {}}, case)
    made = faults.fault_table(runs)
    of = table("table_faults")
    row = of[(of["family"] == "GNSS outage") & (of["case"] == "10 s") & (of["estimator"] == "RHE")]
    assert difference(made, row.reset_index(drop=True)) == ""


def test_the_published_scores_of_a_replay_are_those_of_the_example_log():
    estimators = {"EKF": recorded_logs.estimators("soft_soil", {})["EKF"]}
    log = rhec.logs.read(style.ROOT / "data/example_log.csv")
    trials = recorded_logs.trials(log, range(6), estimators, noise_m=0.02, yaw_error_rad=0.3)
    made = recorded_logs.replay_table(trials)
    of = table("table_replay")
    assert difference(made, of[of["estimator"] == "EKF"].reset_index(drop=True)) == ""


def test_the_table_of_one_s_own_robot_counts_where_its_slips_have_converged():
    table = your_robot.errors(own_log(), OWN_PATH, 0.7)
    assert [*table["value"]] == pytest.approx([0.3, 0.05, 0.02, 0.04, 4 / 40])
