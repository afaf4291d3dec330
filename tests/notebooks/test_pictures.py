"""The pictures in git are those that the code draws of the committed tables, pixel by pixel.

Those of many drives are not in git; `test_figures` compares what they show with the drives.
"""

import functools
import io

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from PIL import Image

import rhec
from notebooks.further import traction_worth_plots
from notebooks.plots import interpretations, robot_drawings, scenarios, which_worlds
from notebooks.studies import scenario_tables
from rhec import style


def table(name):
    return pd.read_csv(style.ROOT / f"data/results/{name}.csv")


@functools.cache
def pairs():
    """The drives of Figures 7 and 8, the same field with W by each rule."""
    return {
        noise: scenario_tables.rhe_and_ekf(process_noise=noise, seed=0, turns="alternate")
        for noise in scenario_tables.PROCESS_NOISES
    }


def yaw_weights():
    """The drives of Figure 6."""
    return {
        weight: rhec.simulate(rhec.Scenario(process_noise="printed", **choice))
        for weight, choice in scenario_tables.yaw_weights().items()
    }


PICTURES = {
    "fig01_robot_in_row": robot_drawings.robot_in_row,
    "fig02_robot_parts": robot_drawings.robot_parts,
    "fig03_hardware": robot_drawings.hardware_blocks,
    "fig04_schematic": robot_drawings.schematic,
    "fig06_yaw_weight": lambda: scenarios.trajectories_q(yaw_weights(), table("table_scenario_a")),
    "fig07_trajectories": lambda: scenarios.trajectories(pairs()),
    "fig08_errors": lambda: scenarios.errors(pairs()),
    "fig09_violations": lambda: scenarios.violations(table("table_scenario_b")),
    "fig12_yaw_rate": lambda: scenarios.yaw_rate(pairs()["printed"]["RHE"]),
    "audit_interpretations": lambda: interpretations.forest(
        table("audit_interpretations"), "prediction"
    ),
    "inverse_order": lambda: which_worlds.order(table("inverse_rules")),
    "traction_map": lambda: traction_worth_plots.map_of_worth(
        table("table_traction_map").astype(dict(told=str))
    ),
    "unknowns": lambda: traction_worth_plots.unknowns_by_difference(table("table_unknowns")),
}


@pytest.mark.parametrize("name", PICTURES)
def test_the_picture_in_git_is_what_is_drawn(name, virtual_machine):
    figure = PICTURES[name]()
    assert figure.get_figwidth() in (style.COLUMN_IN, style.DOUBLE_IN)
    kept = Image.open(style.ROOT / f"figures/{name}.png")
    # Matplotlib's next version may put a letter elsewhere.
    if f"version{mpl.__version__}," in kept.text["Software"]:
        with mpl.rc_context(style.RC | {"figure.constrained_layout.use": False}):
            figure.savefig(pixels := io.BytesIO(), format="rgba")
        drawn = np.frombuffer(pixels.getvalue(), np.uint8).astype(int)
        differs = np.abs(drawn - np.asarray(kept.convert("RGBA")).ravel()) > 16
        assert differs.sum() < 20, f"{differs.sum()} values differ; look at it after `make figures`"
