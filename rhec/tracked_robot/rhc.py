"""The paper's receding horizon controller of the tracked robot, eq. (11)-(13), (16), (19)-(22)."""

from rhec import paper
from rhec.core.controller import rhc
from rhec.tracked_robot.kinematics import SPEED_MODELS


def horizon_of(N, qp="structured", dt_s=paper.DT_S):
    """The Horizon of the paper's problem, N intervals of dt_s [s]: the yaw rate ω is commanded.

    `qp` is "structured", by stages, or the condensed QP by "daqp" or "qpoases".
    """
    solver = None
    if qp != "structured":
        # Imported here, because only the two condensed QPs need it.
        from rhec.core.solver.condensed import Condensed

        solver = Condensed(qp)
    return rhc.Horizon(SPEED_MODELS["parameter"].model, (0,), dt_s, N, solver)
