"""Random instances of the constrained gallery: the plans of `rhec.RHC` beside those of IPOPT."""

import numpy as np
import pandas as pd

from rhec.core.controller.rhc import RHC
from rhec.workbench.studies.constrained_gallery import obstacle, race_car
from rhec.workbench.studies.gallery import goal_at
from rhec.workbench.studies.ipopt_plans import Reference

__all__ = ["PROBLEMS", "compare", "summary"]


def before_the_obstacle(rng):
    """A state in front of the obstacle, with the goal behind it."""
    return np.array([*rng.uniform(-0.3, 0.1, 2), rng.uniform(-0.3, 1.2)])


def on_the_track(rng):
    """A state of the race car at 1 to 2 m/s."""
    aside = rng.uniform(-0.06, 0.06)
    yaw = rng.uniform(-0.05, 0.05)
    return np.array([rng.uniform(0, 3), aside, yaw, rng.uniform(1, 2), 0.3, 0.0])


PROBLEMS = {"obstacle": (obstacle, before_the_obstacle), "race car": (race_car, on_the_track)}


def compare(name, seeds, iterations=100):
    """Solve random instances of a problem by `rhec.RHC.solve` and by IPOPT.

    IPOPT begins at the plan of rhec.RHC, so that it stays there if that is a solution, and once
    more at rest, where it may find another local solution.

    Args:
        name: A key of PROBLEMS.
        seeds: Of the start, one for each instance.
        iterations: Gauss-Newton steps, at most.

    Returns:
        DataFrame, a row for each seed: the largest difference of a command from IPOPT's (`off`),
        whether a bound of a state or output is active there, the costs of both and of IPOPT from
        rest, and whether each says that it has solved the problem.
    """
    define, draw = PROBLEMS[name]
    problem = define()
    reference = Reference(problem.options)
    rows = []
    for seed in seeds:
        x = draw(np.random.default_rng(seed))
        goal = goal_at(problem, x)
        rhc = RHC(**problem.options)
        rest = np.zeros(len(problem.options["model"].inputs))
        rhc.solve(x, (), goal, rest, iterations=iterations)
        near = reference.solve(x, goal, rhc.u_plan)
        cold = reference.solve(x, goal)
        row = dict(seed=seed, off=np.abs(rhc.u_plan - near.u).max(), active=near.active)
        row |= dict(cost=reference.cost(x, goal, rhc.u_plan), ipopt=near.cost, from_rest=cold.cost)
        row |= dict(converged=rhc.converged, solved=near.solved, solved_from_rest=cold.solved)
        rows.append(row)
    return pd.DataFrame(rows)


def summary(tables):
    """Count over the instances.

    Args:
        tables: {name: table of `compare`}.

    Returns:
        DataFrame, a row for each problem: instances, those within 1e-6 of IPOPT, the largest
        difference, those with an active bound, and those where IPOPT from rest is cheaper or dearer
        by more than a millionth, which are other local solutions.
    """
    rows = []
    for name, table in tables.items():
        relative = table.from_rest / table.cost - 1
        solved = table.solved_from_rest
        row = dict(problem=name, instances=len(table), within=int((table.off < 1e-6).sum()))
        row |= dict(largest=table.off.max(), active=int(table.active.sum()))
        row |= dict(converged=int(table.converged.sum()), ipopt_solved=int(table.solved.sum()))
        row |= dict(ipopt_cheaper=int((solved & (relative < -1e-6)).sum()))
        rows.append(row | dict(ipopt_dearer=int((solved & (relative > 1e-6)).sum())))
    return pd.DataFrame(rows)
