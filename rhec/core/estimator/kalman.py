"""The Kalman measurement update, one scalar measurement after the other.

RHE and EKF share it. Scalar updates need no matrix inverse, and a missing measurement is skipped
rather than replaced.
"""

from collections import namedtuple

import casadi as ca

from rhec.core.solver.gauss_newton import symmetric

# The corrected mean m (n,) and covariance P (n, n), gains K (n, n_outputs), weighted innovations
# e = y / S (n_outputs,), the deviance, -2 log likelihood of z up to a constant, its part y²/S, and
# the innovations y with their variances S (n_outputs,).
Update = namedtuple("Update", "m P K e deviance distance y S")


def update(m, P, z, V, outputs, s_bar):
    """Correct the mean m (n,) and the covariance P (n, n) by the measurements z of some outputs.

    For each output h with H = ∂h/∂s and variance V, in turn:

        y = z - h(m)          innovation, of an angle within ±π
        S = H P H' + V        its variance
        K = P H' / S          gain
        m⁺ = m + K y
        P⁺ = P - K H P

    The measurements z (n_z,) are NaN where there is none. Outputs that are not affine are
    linearised at s_bar (n,). The deviance is Σ (y²/S + log S), the distance Σ y²/S.
    """
    gains = []
    weighted = []
    innovations = []
    variances = []
    distance = ca.SX(0)
    for output in outputs:
        is_valid = output.is_valid(z)
        H = output.slope(s_bar, z)
        y = ca.if_else(is_valid, output.residual(z, m, s_bar), 0)
        PH = P @ H.T
        S = H @ PH + V[output.row]
        weight = is_valid / S  # 1/S, and 0 without a measurement, which makes K and e zero
        K = PH * weight
        m = m + K * y
        P = symmetric(P - K @ PH.T)
        gains.append(K)
        weighted.append(y * weight)
        innovations.append(y)
        variances.append(S)
        distance += y**2 * weight
    y = ca.vertcat(*innovations)
    S = ca.vertcat(*variances)
    deviance = deviance_of(z, outputs, y, S)
    return Update(m, P, ca.horzcat(*gains), ca.vertcat(*weighted), deviance, distance, y, S)


def deviance_of(z, outputs, y, S):
    """Σ (y²/S + log S) of those outputs that the measurements z (n_z,) have."""
    valid = (output.is_valid(z) for output in outputs)
    return sum(
        ca.if_else(is_valid, y[i] ** 2 / S[i] + ca.log(S[i]), 0) for i, is_valid in enumerate(valid)
    )
