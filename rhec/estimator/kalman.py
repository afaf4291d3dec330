"""The Kalman measurement update, one scalar reading after the other: what the RHE's window and the
EKF share.

Reading by reading there is nothing to invert, and a sensor that is silent is skipped rather than
replaced.
"""

import casadi as ca

Z_MAX = (
    1e8,
    1e8,
    100.0,
    100.0,
)  # x, y [m], ν [m/s], ω [rad/s]: a reading beyond, or not a number, is no reading


def is_valid_measurement(z, row):
    """1 where the entry `row` of z (4,) can be used, 0 where it is missing (NaN), infinite or
    absurd.
    """
    return ca.fabs(z[row]) <= Z_MAX[row]


def symmetric(P):
    """P (n, n) computed from its lower triangle: half the work, and symmetric to the last bit."""
    return ca.tril2symm(ca.tril(P))


def update(m, P, z, V, measured):
    """Mean m (n,), covariance P (n, n) updated by the readings z (4,), variances V (4,); `measured`
    holds (place in m, place in z) pairs.

    Returns m, P, the gains K (n, rows), the weighted innovations e = y / S (rows,), and the
    deviance Σ y²/S + log S, which is -2 log likelihood of the readings up to a constant.
    """
    gains, weighted, deviance = [], [], 0
    for place, row in measured:
        used = is_valid_measurement(z, row)
        y = ca.if_else(used, z[row] - m[place], 0)
        S = P[place, place] + V[row]
        K = P[:, place] * (used / S)
        m, P = m + K * y, symmetric(P - K @ P[place, :])
        gains.append(K)
        weighted.append(y / S)
        deviance += ca.if_else(used, y**2 / S + ca.log(S), 0)
    return m, P, ca.horzcat(*gains), ca.vertcat(*weighted), deviance
