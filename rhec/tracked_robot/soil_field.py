"""A Gaussian process of the soil: what several drives, added up, tell of (μ, κ) everywhere.

The fields have the correlation k(d) = exp(-c d'd), c = π / (4 ℓ²), at the distance d, and each a
standard deviation s and an unknown mean. Tracks on unlike soil turn the robot, to the right by

    g = -a ∂μ/∂n + g₀,

where n points to the left, a is the share of this in the robot's yaw (1 where each track stands on
soil of its own) and g₀ what always turns it. So (μ, κ, g) at a place are linear functionals of the
process, and the yaw on a straight row tells how μ changes across it.

The drives' likelihood exp(-½ w'Λw + η'w) of the w at their nodes (`soil_pass`) meets the prior
w ~ N(m, K). With M = I + ΛK, b = η - Λm and the covariance k of another place with w,

    mean = m* + k' M⁻ᵀ b   variance = k** - k' M⁻¹Λ k   2 log likelihood = b'K M⁻ᵀ b - log |M| + …,

in which neither K nor Λ is inverted: where a drive said nothing, Λ is zero. (C. Rasmussen and
C. Williams, "Gaussian Processes for Machine Learning", 2006, ch. 2 and 9.4.) A search finds the
s_μ, s_κ, ℓ and a of the highest likelihood, times a weak prior: two headlands alone say little of
s_κ, and the likelihood is then often highest at zero, where the map would be sure of itself.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from rhec.tracked_robot.soil_pass import Evidence

# Before the first drive: mean and standard deviation of the fields' means and of g₀.
MEAN = dict(mu=0.85, kappa=0.85, g=0.0)
SIGMA_OF_MEAN = dict(mu=0.2, kappa=0.2, g=0.1)
# Yaw that neither soil nor g₀ explains, from node to node [1/m].
_SIGMA_G = 2e-3


class Statistics(NamedTuple):
    """What describes the soil as a whole.

    Attributes:
        sigma_mu: Standard deviation s_μ of μ over the field.
        sigma_kappa: Standard deviation s_κ of κ.
        length_m: Correlation length ℓ [m].
        track_share: Share a with which the tracks' own soil turns the robot.
    """

    sigma_mu: float
    sigma_kappa: float
    length_m: float
    track_share: float


FIRST = Statistics(0.06, 0.06, 5.0, 0.5)
# By choice: two thirds of all soils have an s and an ℓ within a factor of 2 of the first ones.
_SIGMA_LOG = np.log(2)
# Lowest and highest values of the search.
_RANGES = ((3e-3, 0.3), (3e-3, 0.3), (1.0, 30.0), (0.0, 1.0))


def merged(evidences):
    """Several drives' Evidence as one."""
    sizes = [len(evidence.place_m) for evidence in evidences]
    total = sum(sizes)
    information = np.zeros((3, total, 3, total))
    score = np.zeros((3, total))
    begin = 0
    for evidence, size in zip(evidences, sizes):
        part = slice(begin, begin + size)
        information[:, part, :, part] = evidence.information.reshape(3, size, 3, size)
        score[:, part] = evidence.score.reshape(3, size)
        begin += size
    place_m = np.concatenate([evidence.place_m for evidence in evidences])
    heading_rad = np.concatenate([evidence.heading_rad for evidence in evidences])
    return Evidence(place_m, heading_rad, information.reshape(3 * total, -1), score.ravel())


def _left(heading_rad):
    return np.column_stack([-np.sin(heading_rad), np.cos(heading_rad)])


def _correlation(one_m, other_m, length_m):
    """k(d), the differences d (n, m, 2), and c."""
    c = np.pi / (4 * length_m**2)
    d = one_m[:, None] - other_m
    return np.exp(-c * np.einsum("ijk,ijk->ij", d, d)), d, c


def prior(evidence, statistics):
    """Mean m (3n,) and covariance K (3n, 3n) of the (μ, κ, g) at the nodes of an Evidence."""
    sigma_mu, sigma_kappa, length_m, share = statistics
    k, d, c = _correlation(evidence.place_m, evidence.place_m, length_m)
    left = _left(evidence.heading_rad)
    across = np.einsum("ijk,jk->ij", d, left)  # d'n of the second place
    n = len(k)
    K = np.zeros((3, n, 3, n))
    K[0, :, 0] = SIGMA_OF_MEAN["mu"] ** 2 + sigma_mu**2 * k
    K[1, :, 1] = SIGMA_OF_MEAN["kappa"] ** 2 + sigma_kappa**2 * k
    # Derivatives of k by the second place, by the first, and by both, along the lefts n.
    K[0, :, 2] = -share * sigma_mu**2 * 2 * c * across * k
    K[2, :, 0] = K[0, :, 2].T
    slopes = 2 * c * left @ left.T + 4 * c**2 * across * across.T
    K[2, :, 2] = SIGMA_OF_MEAN["g"] ** 2 + share**2 * sigma_mu**2 * slopes * k
    K[2, :, 2] += _SIGMA_G**2 * np.eye(n)
    return np.repeat([*MEAN.values()], n), K.reshape(3 * n, 3 * n)


def log_likelihood(evidence, statistics):
    """Log likelihood of the drives under the Statistics, up to a constant."""
    m, K = prior(evidence, statistics)
    b = evidence.score - evidence.information @ m
    factor, pivots = linalg.lu_factor(np.eye(len(m)) + K @ evidence.information)
    log_determinant = np.log(np.abs(np.diag(factor))).sum()
    explained = b @ linalg.lu_solve((factor, pivots), K @ b)
    constant = evidence.score @ m - m @ evidence.information @ m / 2
    return (explained - log_determinant) / 2 + constant


def likeliest(evidence, first=FIRST):
    """The most probable Statistics, by a search (L-BFGS-B) that begins at `first`."""
    usual = np.log(FIRST[:3])

    def deviance(u):
        unusual = np.sum(((u[:3] - usual) / _SIGMA_LOG) ** 2) / 2
        return unusual - log_likelihood(evidence, Statistics(*np.exp(u[:3]), u[3]))

    def in_search(values):
        return [*np.log(values[:3]), values[3]]

    bounds = list(zip(*map(in_search, zip(*_RANGES))))
    options = dict(maxiter=20, eps=1e-4, ftol=1e-6)
    found = optimize.minimize(
        deviance, in_search(first), method="L-BFGS-B", bounds=bounds, options=options
    )
    return Statistics(*np.exp(found.x[:3]).tolist(), float(found.x[3]))


class Field(NamedTuple):
    """Posterior mean and variance at n places: of μ, κ, and the slope (a ∂μ/∂x, a ∂μ/∂y) [1/m].

    `constant_yaw` is mean and variance of g₀ [1/m].
    """

    mean: np.ndarray  # (4, n)
    variance: np.ndarray  # (4, n)
    constant_yaw: tuple


def posterior(evidence, statistics, place_m):
    """The Field at the places (n, 2) [m], given the drives."""
    sigma_mu, sigma_kappa, length_m, share = statistics
    m, K = prior(evidence, statistics)
    factor = linalg.lu_factor(np.eye(len(m)) + evidence.information @ K)
    weights = linalg.lu_solve(factor, evidence.score - evidence.information @ m)
    reduction = linalg.lu_solve(factor, evidence.information)
    c = np.pi / (4 * length_m**2)
    slope = share**2 * sigma_mu**2 * 2 * c
    means = [MEAN["mu"], MEAN["kappa"], 0.0, 0.0]
    variances = [
        SIGMA_OF_MEAN["mu"] ** 2 + sigma_mu**2,
        SIGMA_OF_MEAN["kappa"] ** 2 + sigma_kappa**2,
        slope,
        slope,
    ]
    fields = []
    for k, mean, variance in zip(_crossed(evidence, statistics, place_m), means, variances):
        explained = np.einsum("ij,ij->i", k @ reduction, k)
        fields.append((mean + k @ weights, np.maximum(variance - explained, 0)))
    n = len(evidence.place_m)
    always = SIGMA_OF_MEAN["g"] ** 2 * np.repeat([0.0, 0.0, 1.0], n)
    left_over = SIGMA_OF_MEAN["g"] ** 2 - always @ reduction @ always
    mean, variance = (np.array(values) for values in zip(*fields))
    return Field(mean, variance, (always @ weights, max(left_over, 0.0)))


def _crossed(evidence, statistics, place_m):
    """Covariances (n, 3m) of μ, κ and the two slopes at the places with the drives' (μ, κ, g)."""
    sigma_mu, sigma_kappa, length_m, share = statistics
    k, d, c = _correlation(place_m, evidence.place_m, length_m)
    left = _left(evidence.heading_rad)
    across = np.einsum("ijk,jk->ij", d, left)
    zero = np.zeros_like(k)
    mu = SIGMA_OF_MEAN["mu"] ** 2 + sigma_mu**2 * k
    kappa = SIGMA_OF_MEAN["kappa"] ** 2 + sigma_kappa**2 * k
    yield np.hstack([mu, zero, -share * sigma_mu**2 * 2 * c * across * k])
    yield np.hstack([zero, kappa, zero])
    for axis in range(2):
        by_place = -share * sigma_mu**2 * 2 * c * d[..., axis] * k
        slopes = 2 * c * left[:, axis] - 4 * c**2 * d[..., axis] * across
        yield np.hstack([by_place, zero, -(share**2) * sigma_mu**2 * slopes * k])
