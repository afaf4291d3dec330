"""Approximate Bayesian computation (ABC) from a table of simulations that were run before: the
nearest simulations to what was observed, corrected by local linear regression.

This is the method of Beaumont, Zhang and Balding (2002, Genetics 162, 2025-2035). The distance to
the observation s_obs is ||(s - s_obs) / scale||. The nearest simulations get the weight of an
Epanechnikov kernel, 1 - (d / d_max)². Among them a weighted linear regression of the parameters θ
on the statistics s corrects what the tolerance leaves: θ* = θ - (s - s_obs) β. Parameters lie
between 0 and 1 here and are regressed as logits, so that a corrected one stays in its prior's
range (the package `abc` of R can do the same).

Packages for Python (pyABC, ELFI, ABCpy) call the simulator themselves, one draw at a time, and
bring a database or a scheduler. Here a campaign has driven all worlds beforehand, in SIMD lanes,
and all that is left of the method is one sort and one least-squares fit by NumPy.

Few worlds of a wide prior come near the observation. A second round draws its worlds from a
`Proposal`, a distribution about those that did, and a weight makes up for it (Beaumont, Cornuet,
Marin and Robert 2009, Biometrika 96, 983-990). With α the share of the worlds that the prior drew,
p its density and q that of the proposal, the weight of every world, of either round, is

    p / (α p + (1 - α) q),

which is at most 1/α (the balance heuristic; Owen and Zhou 2000, JASA 95, 135-143).
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import expit, logit, ndtr, ndtri

_EDGE = 1e-6  # a parameter at the very end of its range would have an infinite logit


class Simulations(NamedTuple):
    """A table of simulations.

    Attributes:
        unit: (worlds, d) parameters, each between 0 and 1 and uniform there in the prior.
        world: (n,) the row of `unit` that each simulation drove.
        statistics: (n, k) what it gave.
        scales: (k,) by which differences of the statistics are divided.
        discrete: (d,) flags of the parameters that are choices; regression leaves them alone.
        prior: (n,) weight of each simulation in the prior.
    """

    unit: np.ndarray
    world: np.ndarray
    statistics: np.ndarray
    scales: np.ndarray
    discrete: np.ndarray
    prior: np.ndarray


class Draws(NamedTuple):
    """Weighted draws of a posterior.

    Attributes:
        unit: (m, d) parameters, corrected by regression.
        weights: (m,), which sum to 1.
        rows: (m,) the simulation of each.
        effective_worlds: Kish's effective number of worlds, 1 / Σ W², W the weight of a world.
    """

    unit: np.ndarray
    weights: np.ndarray
    rows: np.ndarray
    effective_worlds: float


class Proposal(NamedTuple):
    """A distribution of worlds: normal where the prior is the standard normal, z = Φ⁻¹(u).

    Attributes:
        mean: (d,) of z.
        covariance: (d, d) of z.
    """

    mean: np.ndarray
    covariance: np.ndarray

    def unit_at(self, unit):
        """Points (n, d) of it from points that are uniform between 0 and 1: Φ(m + L Φ⁻¹(u))."""
        root = np.linalg.cholesky(self.covariance)
        return ndtr(self.mean + ndtri(np.clip(unit, _EDGE, 1 - _EDGE)) @ root.T)

    def weights(self, unit, alpha):
        """p / (α p + (1 - α) q) at points (n, d)."""
        z = ndtri(np.clip(unit, _EDGE, 1 - _EDGE))
        log_q = stats.multivariate_normal.logpdf(z, self.mean, self.covariance)
        log_p = stats.norm.logpdf(z).sum(axis=1)
        return 1 / (alpha + (1 - alpha) * np.exp(log_q - log_p))


# Learned is an unknown whose mean moved by more than this, or whose deviation is below that, in z.
_LEARNED = 0.3, 0.8
_SHRINK = 0.3


def proposal(draws, discrete):
    """The Proposal about the draws of a posterior.

    The unknowns of which the posterior says little, and the choices, stay as the prior has them.
    The covariance C of the others is that of few worlds, so it becomes 0.7 C + 0.3 I, where I is
    the prior's. Numbers are rounded, so that every machine has the same.

    Args:
        draws: `Draws`.
        discrete: (d,) flags of the choices.
    """
    z = ndtri(np.clip(draws.unit, _EDGE, 1 - _EDGE))
    mean = np.average(z, axis=0, weights=draws.weights)
    covariance = np.cov(z.T, aweights=draws.weights)
    moved, narrow = _LEARNED
    learned = (np.abs(mean) > moved) | (np.sqrt(np.diag(covariance)) < narrow)
    learned &= ~discrete
    shrunk = np.where(np.outer(learned, learned), (1 - _SHRINK) * covariance, 0)
    shrunk += np.diag(np.where(learned, _SHRINK, 1))
    return Proposal(np.where(learned, mean, 0).round(2), shrunk.round(2))


def posterior(simulations, observed, keep, but_world=None):
    """Draws of the posterior, given what was observed.

    Args:
        simulations: A `Simulations`.
        observed: (k,) statistics.
        keep: How many of the nearest simulations count.
        but_world: A world whose simulations are left out, for a check on itself.
    """
    scaled = (simulations.statistics - observed) / simulations.scales
    squares = np.einsum("ij,ij->i", scaled, scaled)
    if but_world is not None:
        squares = np.where(simulations.world == but_world, np.inf, squares)
    # Sorted, because the order that numpy leaves them in, which decides the draws of `resample`,
    # depends on the processor.
    rows = np.sort(np.argpartition(squares, keep)[:keep])
    weights = simulations.prior[rows] * (1 - squares[rows] / squares[rows].max())
    weights = weights / weights.sum()
    worlds = simulations.world[rows]
    unit = _corrected(simulations.unit[worlds], scaled[rows], weights, simulations.discrete)
    of_world = np.bincount(worlds, weights)
    return Draws(unit, weights, rows, 1 / np.sum(of_world**2))


def _corrected(unit, differences, weights, discrete):
    """θ - (s - s_obs) β on the scale of logits, β by weighted least squares with an intercept."""
    theta = logit(np.clip(unit, _EDGE, 1 - _EDGE))
    # A statistic that is the same in all of them says nothing, and would make the fit singular.
    varying = differences[:, np.ptp(differences, axis=0) > 0]
    root = np.sqrt(weights)[:, None]
    design = np.hstack([np.ones_like(root), varying])
    beta, *_ = np.linalg.lstsq(root * design, root * theta)
    corrected = expit(theta - varying @ beta[1:])
    return np.where(discrete, unit, corrected)


def resample(draws, n, rng):
    """n draws of equal weight: (n, d) parameters and (n,) their simulations.

    Systematic resampling: a draw of weight w comes n w times, rounded up or down.
    """
    ends = np.cumsum(draws.weights)
    ends[-1] = 1.0
    picks = np.searchsorted(ends, (rng.random() + np.arange(n)) / n, side="right")
    picks = rng.permutation(picks)
    return draws.unit[picks], draws.rows[picks]


def ranks(simulations, truths, keep, draws, rng):
    """Simulation-based calibration: the rank of each truth among draws of its posterior.

    Each truth, a row of the simulations, is taken as the observation; its world is left out of the
    table. If the posteriors are right, the ranks are uniform on 0 to `draws` (Talts et al. 2018),
    also among truths chosen by their statistics alone, as those near an observation (Prangle et
    al. 2014). The result is (truths, d).
    """
    all_ranks = []
    for row in truths:
        world = simulations.world[row]
        found = posterior(simulations, simulations.statistics[row], keep, but_world=world)
        unit, _ = resample(found, draws, rng)
        all_ranks.append(np.sum(unit < simulations.unit[world], axis=0))
    return np.array(all_ranks)


def calibration(ranks, draws, names):
    """Whether ranks are uniform, as those of right posteriors are: a DataFrame, a row an unknown.

    It has the shares of truths within the middle 50 % and 90 % of their posterior's draws, and p,
    the probability that the largest distance to the uniform distribution is as large by chance for
    one of all unknowns (Kolmogorov and Smirnov, with Bonferroni's correction).

    Args:
        ranks: Of `ranks`.
        draws: How many draws each rank is among.
        names: Of the unknowns.
    """
    n, unknowns = ranks.shape
    middle = np.abs((ranks + 0.5) / (draws + 1) - 0.5)
    levels = np.arange(draws + 1)
    below = np.mean(ranks[:, :, None] <= levels, axis=0)
    off = np.abs(below - (levels + 1) / (draws + 1)).max(axis=1)
    columns = {f"middle {share:.0%}": np.mean(middle <= share / 2, axis=0) for share in (0.5, 0.9)}
    columns["p"] = np.minimum(unknowns * stats.kstwo.sf(off, n), 1)
    return pd.DataFrame(columns, names)
