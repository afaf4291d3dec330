"""Limits of numbers: beyond them one is no measurement, no state, no entry of a QP, no divisor."""

import casadi as ca

from rhec.core._casadi.build import every

MAX_MEASUREMENT = 1e8  # in any unit; a Model may say less
MAX_PLAUSIBLE_STATE = 1e12  # of an estimate
MAX_QP_ENTRY = 1e20  # that a solver is given; as a bound: no bound
TINY = 1e-300  # the least divisor, where one may be 0


def is_valid_measurement(z, limit):
    """1 where a measurement can be used, 0 where it is missing (NaN), infinite or absurd."""
    return ca.fabs(z) <= limit


def is_plausible(x, limit=MAX_PLAUSIBLE_STATE):
    """1 if every entry of x is a number of at most this size."""
    return every(ca.fabs(x) <= limit)
