"""What one drive tells of the soil under it: a smoother over the whole drive.

The soil has the values (μ, κ, g) at nodes along the way, between which it is linear, and the pose
ξ = (x, y, θ) and the speed ν of every sample are unknown, too. With the tracks' yaw rate ω as it is
measured, and Gaussian noise of the standard deviations behind V and W, the drive obeys

    x⁺ = x + Δt μ ν cos θ̄,  y⁺ = y + Δt μ ν sin θ̄,  θ⁺ = θ + Δt (κ ω + g ν),  ν⁺ = ν,

with θ̄ = θ + Δt (κ ω + g ν) / 2, and the sensors measure x, y and ν. Here g = (μ_r - μ_l) / b is the
yaw that unlike tracks add to each metre that they run. Gauss-Newton steps find the most likely
drive; they are what a Rauch-Tung-Striebel smoother would return, iterated. Then poses and speeds
are eliminated (Schur complement), which leaves what the drive alone says of the soil: its
likelihood exp(-½ w'Λw + η'w) of w, the μ, then the κ, then the g of all nodes. Where the robot
drove straight on, it says nothing of κ, and Λ has zeros there. No prior is in it, so that several
drives are simply added up (`rhec.tracked_robot.soil_field`).
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import spsolve

from rhec.core.model.limits import MAX_MEASUREMENT

NODES_M = 2.0  # half of the simulated soil's correlation length
_ITERATIONS = 2
# A weak prior that only the Gauss-Newton steps use, (mean, standard deviation) of (μ, κ, g).
_WEAK = ((0.9, 0.2), (0.9, 0.3), (0.0, 0.1))
_RIDGE = 1e-6  # keeps poses that nothing measures from being free
_POSE = 4  # entries of a sample: x, y, θ, ν


class Evidence(NamedTuple):
    """The likelihood of the soil at the m nodes of one drive, in information form.

    Attributes:
        place_m: (m, 2) places of the nodes [m].
        heading_rad: (m,) headings of the robot there [rad].
        information: (3m, 3m) Λ, of the μ, the κ and the g [1/m] of all nodes.
        score: (3m,) η.
    """

    place_m: np.ndarray
    heading_rad: np.ndarray
    information: np.ndarray
    score: np.ndarray


class _Nodes(NamedTuple):
    """Where each of the n samples lies between the m nodes along the way."""

    before: np.ndarray  # (n,) number of the last node
    share: np.ndarray  # (n,) of the way to the next one
    count: int  # m

    def at(self, values):
        """Values (rows, m) at the nodes, interpolated at the samples."""
        return values[:, self.before] * (1 - self.share) + values[:, self.before + 1] * self.share


def evidence_of(z, first, sigma_v, sigma_w, dt_s, nodes_m=NODES_M):
    """The Evidence of one drive.

    Args:
        z: (n, 4) measurements (x, y, ν, ω) [m, m, m/s, rad/s], NaN where there is none.
        first: (n, 4) where the iteration begins, such as the estimates (x, y, θ, ν) of the drive.
        sigma_v: Standard deviations of z; that of ω has no effect, because its noise is in θ.
        sigma_w: (4,) standard deviations of the process noise of (x, y, θ, ν) per sample.
        dt_s: Length of a sample [s].
        nodes_m: Distance of the nodes, as the tracks run [m].

    Returns:
        The Evidence.
    """
    z = np.where(np.abs(z) <= MAX_MEASUREMENT, z, np.nan)
    measured = z[:, :3], _held(z[:, 3])
    run = np.cumsum(np.abs(_held(z[:, 2]))) * dt_s / nodes_m
    before = run.astype(int)
    nodes = _Nodes(before, run - before, before[-1] + 2)
    mean, sigma = np.repeat(_WEAK, nodes.count, axis=0).T
    poses = np.array(first, dtype=float)
    soil = mean.copy()
    for _ in range(_ITERATIONS):
        parts = _linearised(poses, soil, measured, nodes, sigma_v, sigma_w, dt_s)
        step = _step(*parts, soil - mean, sigma)
        poses += step[: poses.size].reshape(poses.shape)
        soil += step[poses.size :]
    parts = _linearised(poses, soil, measured, nodes, sigma_v, sigma_w, dt_s)
    information, score = _without_poses(*parts)
    # The last node lies ahead of the last sample, where the pose is continued.
    at = np.arange(nodes.count)
    ahead_m = np.maximum(at - run[-1], 0)[:, None] * nodes_m
    x, y, theta = (np.interp(at, run, poses[:, i]) for i in range(3))
    place_m = np.column_stack([x, y]) + ahead_m * np.column_stack([np.cos(theta), np.sin(theta)])
    return Evidence(place_m, theta, information, score + information @ soil)


def _held(values):
    """Values (n,), where one is missing the last before it, and zero before the first."""
    places = np.where(np.isnan(values), 0, np.arange(len(values)))
    return np.nan_to_num(values[np.maximum.accumulate(places)])


def _linearised(poses, soil, measured, nodes, sigma_v, sigma_w, dt_s):
    """Weighted residuals r (m,) and their derivatives by poses and soil, (m, 4n) and (m, n_w)."""
    z, omega = measured
    seen = np.isfinite(z)
    r_z = (poses[:, [0, 1, 3]] - z)[seen] / np.broadcast_to(sigma_v[:3], z.shape)[seen]
    r_f, by_first, by_last, by_soil = _motion(poses, soil, omega, nodes, dt_s)
    n = len(poses)
    sample = np.arange(n - 1)
    weights = 1 / np.asarray(sigma_w)
    columns = _POSE * np.arange(n)[:, None] + [0, 1, 3]
    of_z = _matrix(1 / np.broadcast_to(sigma_v[:3], z.shape)[seen][:, None, None],
                   columns[seen][:, None], _POSE * n)  # fmt: skip
    pairs = np.hstack([_POSE * (sample + i)[:, None] + np.arange(_POSE) for i in (0, 1)])
    of_f = _matrix(np.concatenate([by_first, by_last], 2) * weights[:, None], pairs, _POSE * n)
    triples = nodes.before[1:, None] + nodes.count * np.arange(3)
    share = nodes.share[1:, None, None]
    of_soil = sum(
        _matrix(by_soil * weights[:, None] * part, triples + i, len(soil))
        for i, part in enumerate((1 - share, share))
    )
    r = np.concatenate([r_z, (r_f * weights).ravel()])
    nothing = sparse.csr_matrix((len(r_z), len(soil)))
    return r, sparse.vstack([of_z, of_f]).tocsc(), sparse.vstack([nothing, of_soil]).tocsc()


def _matrix(blocks, columns, n_columns):
    """The sparse matrix of row blocks (m, rows, k) in the columns (m, k)."""
    m, rows, k = blocks.shape
    row = np.arange(m * rows).reshape(m, rows, 1)
    places = np.broadcast_to(row, blocks.shape), np.broadcast_to(columns[:, None], blocks.shape)
    entries = (blocks.ravel(), tuple(place.ravel() for place in places))
    return sparse.csr_matrix(entries, (m * rows, n_columns))


def _motion(poses, soil, omega, nodes, dt_s):
    """Residuals (n-1, 4) of the motion, and derivatives by the pose before, after, by (μ, κ, g).

    The speed and the yaw rate of an interval are those measured at its end.
    """
    mu, kappa, g = nodes.at(soil.reshape(3, -1))[:, 1:]
    nu = poses[1:, 3]
    turn = dt_s * (kappa * omega[1:] + g * nu)
    middle = poses[:-1, 2] + turn / 2
    cos = np.cos(middle)
    sin = np.sin(middle)
    ahead = dt_s * mu * nu
    still = np.zeros_like(nu)
    moved = np.column_stack([ahead * cos, ahead * sin, turn, still])
    # By the turn of the interval, by θ before it, and by the way ahead.
    by_turn = np.column_stack([-ahead * sin / 2, ahead * cos / 2, still + 1, still])
    by_theta = np.column_stack([-ahead * sin, ahead * cos, still, still])
    by_ahead = np.column_stack([cos, sin, still, still])
    by_first = np.tile(-np.eye(_POSE), (len(nu), 1, 1))
    by_first[:, :, 2] -= by_theta
    by_last = np.tile(np.eye(_POSE), (len(nu), 1, 1))
    by_last[:, :, 3] -= by_ahead * (dt_s * mu)[:, None] + by_turn * (dt_s * g)[:, None]
    by_soil = np.stack([by_ahead * (dt_s * nu)[:, None], by_turn * (dt_s * omega[1:])[:, None],
                        by_turn * (dt_s * nu)[:, None]], axis=2)  # fmt: skip
    return poses[1:] - poses[:-1] - moved, by_first, by_last, -by_soil


def _step(r, by_poses, by_soil, off_prior, sigma):
    """One Gauss-Newton step of poses and soil, with the weak prior on the soil."""
    J = sparse.hstack([by_poses, by_soil]).tocsc()
    n = by_poses.shape[1]
    prior = np.concatenate([np.full(n, _RIDGE), 1 / sigma**2])
    gradient = J.T @ r
    gradient[n:] += off_prior / sigma**2
    return -spsolve(J.T @ J + sparse.diags(prior), gradient)


def _without_poses(r, by_poses, by_soil):
    """Information and gradient of the soil's change, with poses and speeds eliminated.

    With N = J_ξ'J_ξ:  Λ = J_w'J_w - J_w'J_ξ N⁻¹ J_ξ'J_w,  η = -(J_w'r - J_w'J_ξ N⁻¹ J_ξ'r).
    """
    N = (by_poses.T @ by_poses).tocsc()
    band = 2 * _POSE - 1
    diagonals = np.zeros((band + 1, N.shape[0]))
    for k in range(band + 1):
        diagonals[k, : N.shape[0] - k] = N.diagonal(-k)
    diagonals[0] += _RIDGE
    crossed = (by_poses.T @ by_soil).toarray()
    factor = linalg.cholesky_banded(diagonals, lower=True)
    right = np.column_stack([crossed, by_poses.T @ r])
    solved = linalg.cho_solve_banded((factor, True), right)
    information = (by_soil.T @ by_soil).toarray() - crossed.T @ solved[:, :-1]
    return (information + information.T) / 2, crossed.T @ solved[:, -1] - by_soil.T @ r
