"""What cannot be exported, or not there: one sentence, and nothing is written."""

import casadi as ca
import pytest
from helpers import assert_refused, no_compiler, own_controller
from robots import DT, ROBOTS

import rhec
from notebooks.rivals import RIVALS

pytestmark = pytest.mark.usefixtures("virtual_machine")
NO_SCENARIO = "; it should be a rhec.Scenario"
EXPORTED = "to export, it should "


def solving_estimator():
    """An estimator that solves a QP with a library."""
    memory, z = ca.MX.sym("memory", 6), ca.MX.sym("z", 4)
    x = ca.conic("qp", "daqp", {"h": ca.Sparsity.dense(2, 2)})(h=ca.DM.eye(2), g=-z[:2])["x"]
    return ca.Function("mine", [memory, z], [ca.vertcat(x, memory[2:])] * 2)


def of_scenario(**fields):
    return dict(scenario=rhec.Scenario(**fields))


def of_models():
    """What is wrong with parts of a cart's loop."""
    cart = ROBOTS["cart"]
    model = rhec.Model(**cart.model)
    given = dict(model=model, dt=DT, guess=(0, 0, 0), **cart.estimator)
    with no_compiler():
        mhe, ekf = rhec.RHE(horizon=6, **given), rhec.EKF(**given)
        other = rhec.RHC(model=model, dt=0.1, horizon=8, **cart.controller)
        return [
            (dict(scenario=(mhe, mhe)), "scenario was …it should be a RHE, a RHC or one of each"),
            (dict(scenario=rhec.RHE()), "…for the paper's robot a Scenario"),
            (dict(scenario=ekf), "scenario was …; it should be"),
            (dict(scenario=(mhe, other)), "RHE and RHC differ; both should have the same model"),
            (dict(scenario=()), f"scenario was …{NO_SCENARIO}"),
        ]


SCENARIOS = [
    (dict(scenario="printed"), f"scenario was 'printed'{NO_SCENARIO}"),
    (
        of_scenario(estimator="oracle"),
        f"estimator was 'oracle', which needs the truth; {EXPORTED}be one of 'rhe', 'ekf', "
        "'bounded_ekf' or a CasADi Function",
    ),
    (
        of_scenario(estimator=RIVALS["traction_oracle"]),
        "estimator was Estimator('traction_oracle_step', …, which needs the true traction",
    ),
    (
        of_scenario(estimator=solving_estimator()),
        f"estimator was …mine…, which calls 'qp' …Daqp…; {EXPORTED}consist of expressions",
    ),
    (
        of_scenario(controller=own_controller(rhec.Scenario())),
        f"controller was Controller('steer', memory of 1); {EXPORTED}be 'rhc'",
    ),
    (
        of_scenario(traction_timing="sample_before"),
        "traction_timing was 'sample_before'; to export",
    ),
]


def test_what_cannot_be_exported_is_refused_in_one_sentence(tmp_path):
    folder = tmp_path / "new"
    assert_refused(lambda scenario: rhec.export(scenario, folder), [*SCENARIOS, *of_models()])
    assert not folder.exists()


def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path):
    thesis = tmp_path / "thesis.tex"
    thesis.write_text("mine")
    may_be = "it should be a new or empty folder or an earlier export"
    rows = [
        (dict(folder=tmp_path), f"folder was …which contains other files; {may_be}"),
        (dict(folder=thesis), f"folder was …which is a file; {may_be}"),
    ]
    rows += [(dict(folder=None), "folder was None; it should be a path")]
    assert_refused(lambda folder: rhec.export(rhec.Scenario(), folder), rows)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
