"""The worst drive within bounds: soil, bumps and position errors chosen against the robot.

Random fields say how often the robot fails; this says by how much. Within bounds of `level` times
two standard deviations of the default scenario, differential evolution looks for the drive (the
first row and headland, begun on the path) with the largest error. It chooses the traction of the
whole soil and of one patch, and where the patch lies. Bumps and position errors are at their bound,
with a sign that changes periodically. A drive that is found can be repeated by its seed and
numbers; a worse one may exist.
"""

import dataclasses
import functools
import itertools

import numpy as np
import pandas as pd
from scipy import optimize

from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.core._casadi.build import packed_size
from rhec.simulation.closed_loop import build_sample, finish, set_up
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import plant as robot
from rhec.workbench.studies import ensured
from rhec.workbench.studies.claims.run_sets import parallel_map

__all__ = ["compare", "drive", "search"]

LEVELS = (0.1, 0.15, 0.2, 0.5, 1.0)
_SIGMAS = 2.0  # at level 1
_ROW_M = paper.ROW_LENGTH_M
_HEADLAND_M = np.pi * paper.HEADLAND_RADIUS_M
_SIGNS = (-1.0, 1.0)  # of a bound
_RANGES = dict(
    mu=_SIGNS,
    kappa=_SIGNS,
    patch_mu=_SIGNS,
    patch_kappa=_SIGNS,
    patch_radius_m=(0.5, 4.0),
    patch_s_m=(10.0, _ROW_M + _HEADLAND_M),
    bump_period_s=(0.4, 20.0),
    bump_phase=(0.0, 1.0),
    gnss_period_s=(0.4, 40.0),
    gnss_phase=(0.0, 1.0),
    gnss_angle_rad=(0.0, np.pi),
)


def _soil(base, level, chosen):
    """Traction (μ, κ) of the whole soil and of the patch, at a level of the bounds."""
    off = {name: _SIGMAS * level * getattr(base, f"{name}_deviation") for name in ("mu", "kappa")}
    mean = {name: getattr(base, f"{name}_mean") for name in off}
    return [
        float(np.clip(mean[name] + off[name] * chosen[choice], 0.01, 0.999))
        for name, choice in zip(("mu", "kappa") * 2, ("mu", "kappa", "patch_mu", "patch_kappa"))
    ]


def _square_wave(chosen, name, level, t_s):
    """Noise at its bound whose sign changes periodically, in standard deviations."""
    cycles = t_s / chosen[f"{name}_period_s"] + chosen[f"{name}_phase"]
    return _SIGMAS * level * np.where(cycles % 1 < 0.5, 1.0, -1.0)


def _noise(scenario, level, chosen):
    """The scenario's noise with bumps and position errors replaced by the chosen ones."""
    noise = robot.draw_noise(scenario.seed, round(scenario.duration_s / paper.DT_S))
    ends = np.cumsum([packed_size({name: shape}) for name, shape in robot.NOISE.items()])
    places = dict(zip(robot.NOISE, np.split(np.arange(ends[-1]), ends[:-1])))
    t_s = np.arange(len(noise)) * paper.DT_S
    angle = chosen["gnss_angle_rad"]
    noise[:, places["bump"]] = _square_wave(chosen, "bump", level, t_s)[:, None]
    noise[:, places["white"]] = np.outer(
        _square_wave(chosen, "gnss", level, t_s), [np.cos(angle), np.sin(angle)]
    )
    return noise


def drive(base, level, **chosen):
    """The Run of a scenario with chosen soil, bumps and position errors.

    Args:
        base: The Scenario.
        level: Of the bounds.
        chosen: A value for each of _RANGES.
    """
    mu, kappa, *patch = _soil(base, level, chosen)
    constant = dict(mu_mean=mu, kappa_mean=kappa, mu_deviation=0.0, kappa_deviation=0.0)
    # The chosen bumps and position errors act as they are, without a filter.
    constant |= dict(rut_length_m=0.0, gnss_slow_share=0.0)
    # The patch is placed along the path, which is known once the scenario is set up.
    plain = dataclasses.replace(base, **constant)
    ((x, y, _),), _ = set_up(plain).path.poses([chosen["patch_s_m"]])
    disc = (float(x), float(y), float(chosen["patch_radius_m"]), *patch)
    scenario = dataclasses.replace(plain, patches=(disc,))
    # The run's noise is replaced, so the loop is scanned here and not by `simulate`.
    setup = set_up(scenario)
    noise = _noise(scenario, level, chosen)
    functions = compiled.load(build_sample, *setup.structure)
    return finish(scenario, setup, scan.scan(functions, setup.memory, noise, setup.settings)[1])


def search(levels, seed=0, evaluations=100, **fields):
    """Search for the worst drive at each level.

    Args:
        levels: Of the bounds.
        seed: Of the search, and of the encoders' noise.
        evaluations: Drives a level, about.
        fields: Of Scenario.

    Returns:
        DataFrame, one row a level: worst_m, the largest error [m]; drives, how many were tried;
        seed; and the choices.
    """
    longest_s = 1.3 * (_ROW_M + _HEADLAND_M) / (paper.SPEED_MPS * Scenario.mu_mean)
    base = Scenario(**dict(duration_s=longest_s, start_offset_m=0.0, seed=seed) | fields)
    rows = []

    def error_m(values, level):
        columns = drive(base, level, **dict(zip(_RANGES, values))).columns
        return -columns["error_true_m"][columns["s_m"] < _ROW_M + _HEADLAND_M].max()

    members = 2 * len(_RANGES)  # of a generation, by popsize
    for level in levels:
        result = optimize.differential_evolution(
            error_m,
            [*_RANGES.values()],
            args=(level,),
            popsize=2,
            polish=False,
            tol=0,
            maxiter=max(1, evaluations // members - 1),
            rng=np.random.default_rng(seed),
        )
        rows.append(dict(level=level, worst_m=-result.fun, drives=result.nfev, seed=seed))
        rows[-1] |= dict(zip(_RANGES, result.x.tolist()))
    return pd.DataFrame(rows)


def compare(evaluations, levels=LEVELS):
    """Search for the worst drive of the cautious controller, and of that at a constant speed.

    Args:
        evaluations: Drives a level, about.
        levels: Of the bounds.

    Returns:
        The rows of `search` by the proposal, with the column cautious.
    """
    cases = [*itertools.product((True, False), levels)]
    task = functools.partial(_search_of, evaluations=evaluations)
    return pd.concat(parallel_map(task, cases), ignore_index=True)


def _search_of(case, evaluations):
    """The row of `compare` of a case (cautious, level)."""
    cautious, level = case
    fields = ensured.ESTIMATORS[ensured.PROPOSAL] | dict(cautious=cautious)
    return search([level], evaluations=evaluations, **fields).assign(cautious=cautious)
