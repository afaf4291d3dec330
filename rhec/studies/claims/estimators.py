"""Estimators that claims need beside the paper's own, as Functions (memory, z) -> (memory,
estimate); the memory begins with the first guess.
"""

import casadi as ca

from rhec import paper


def dead_reckoned():
    """No estimate of the yaw: it is the encoders' yaw rate summed up from the start, position and
    speed are as measured, no slip.
    """
    memory, z = ca.SX.sym("memory", 6), ca.SX.sym("z", 4)
    estimate = ca.vertcat(z[:2], memory[2] + paper.DT_S * z[3], z[2], 1, 1)
    return ca.Function(
        "dead_reckoned", [memory, z], [estimate, estimate], {"allow_duplicate_io_names": True}
    )
