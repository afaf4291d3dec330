"""The paper's controller with its QP condensed, which libraries solve: an oracle of the QP."""

import rhec
from notebooks.studies import condensed


def rhc_by(solver, **options):
    """The controller with its QP "structured", by stages, or by "daqp" or "qpoases"."""
    qp = None if solver == "structured" else condensed.Condensed(solver)
    return rhec.RHC(**options, qp=qp)
