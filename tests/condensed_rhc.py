"""The paper's controller with its QP condensed, which libraries solve: an oracle of the QP."""

import rhec
from benchmark.condensed import Condensed
from rhec.core._casadi.packing import pack_array
from rhec.core.controller import rhc
from rhec.simulation.closed_loop import first_guess
from rhec.tracked_robot.paper_rhc import problem_of_scenario
from rhec.tracked_robot.path import path_of


def rhc_by(solver, **options):
    """The controller with its QP "structured", by stages, or by "daqp" or "qpoases"."""
    qp = None if solver == "structured" else Condensed(solver)
    return rhec.RHC(**options, qp=qp)


def controller(scenario, solver):
    """The RHC of a Scenario with its QP condensed, as a rhec.Controller."""
    stages, settings = problem_of_scenario(scenario)
    stages = stages._replace(qp=Condensed(solver))
    guess = first_guess(scenario, path_of(scenario))
    memory = pack_array(rhc.init(stages, guess[:3], guess[3:], settings))
    return rhec.Controller(rhc.build_phases(stages)["step"], memory)
