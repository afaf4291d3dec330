"""The Kalman measurement update, one scalar measurement after the other.

RHE and EKF share it. Scalar updates need no matrix inverse, and a missing measurement is skipped
rather than replaced.
"""

from typing import Any, NamedTuple

import casadi as ca

from rhec.core.solver.gauss_newton import symmetric


class Update(NamedTuple):
    """The corrected mean m (n,) and covariance P (n, n), and how they came about."""

    m: Any
    P: Any
    K: Any  # (n, n_outputs) gains
    e: Any  # (n_outputs,) weighted innovations y / S
    deviance: Any  # -2 log likelihood of z, up to a constant


def update(m, P, z, V, outputs, s_bar):
    """Correct the mean m (n,) and the covariance P (n, n) by the measurements z of some outputs.

    For each output h with H = ∂h/∂s and variance V, in turn:

        y = z - h(m)          innovation
        S = H P H' + V        its variance
        K = P H' / S          gain
        m⁺ = m + K y
        P⁺ = P - K H P

    The measurements z (n_z,) are NaN where there is none. Outputs that are not affine are
    linearised at s_bar (n,). The deviance is Σ y²/S + log S.
    """
    gains = []
    weighted = []
    deviance = 0
    for output in outputs:
        used = output.is_valid(z)
        H = output.H(s_bar)
        y = ca.if_else(used, z[output.row] - output.predicted(m, s_bar), 0)
        PH = P @ H.T
        S = H @ PH + V[output.row]
        weight = used / S  # 1/S, and 0 without a measurement, which makes K and e zero
        K = PH * weight
        m = m + K * y
        P = symmetric(P - K @ PH.T)
        gains.append(K)
        weighted.append(y * weight)
        deviance += ca.if_else(used, y**2 / S + ca.log(S), 0)
    return Update(m, P, ca.horzcat(*gains), ca.vertcat(*weighted), deviance)
