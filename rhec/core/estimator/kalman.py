"""The Kalman measurement update, one scalar measurement after the other.

RHE and EKF share it. One by one there is nothing to invert, and a sensor that is silent is skipped
rather than replaced.
"""

import casadi as ca

from rhec.core.solver.gauss_newton import symmetric

__all__ = ["update"]


def update(m, P, z, V, outputs, s_bar):
    """Mean m (n,) and covariance P (n, n), corrected by the measurements z of some outputs.

    Args:
        m: (n,) mean of the joint state.
        P: (n, n) its covariance.
        z: (n_z,) measurements, NaN where there is none.
        V: (n_z,) their variances.
        outputs: The model's Outputs that measure the joint state.
        s_bar: (n,) where outputs that are not affine are linearised.

    Returns:
        m, P; the gains K (n, n_outputs); the weighted innovations e = y / S (n_outputs,); the
        deviance Σ y²/S + log S, which is -2 log likelihood of z up to a constant.
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
        weight = used / S
        K = PH * weight
        m = m + K * y
        P = symmetric(P - K @ PH.T)
        gains.append(K)
        weighted.append(y * weight)
        deviance += ca.if_else(used, y**2 / S + ca.log(S), 0)
    return m, P, ca.horzcat(*gains), ca.vertcat(*weighted), deviance
