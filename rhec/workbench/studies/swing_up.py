"""What one iteration a sample costs in a swing-up, beside iterating to convergence at each sample.

The closed loop of `feedback`, which iterates at its first sample alone, is driven from random
starts around hanging still, and so is that of `solve(…, iterations=100)`.

    python -m rhec.workbench.studies.swing_up

prints the summary of 40 starts of both pendulums of `rhec.workbench.studies.gallery`, with the
Gauss-Newton matrix and with the exact Hessian (`hessian` of rhec.RHC). Both are compared with
`solve` by Gauss-Newton. It also prints how often each iterates to solve the first sample's problem.
"""

import bisect

import numpy as np
import pandas as pd
from scipy.stats import quantile_test

from rhec.core.controller.rhc import RHC
from rhec.workbench.studies import gallery
from rhec.workbench.studies.ipopt_plans import next_state

__all__ = ["SPREAD", "cost_of_loop", "excesses", "iterations_from_rest", "summary"]

SPREAD = 0.5  # of each state at the start, to either side, in its unit


def cost_of_loop(problem, start, iterations):
    """Cost of a closed loop, and its last state.

    J = Σ_k (x_k - goal)ᵀ diag(q) (x_k - goal) + u_kᵀ diag(r) u_k.

    Args:
        problem: A ControlProblem whose goal is a state.
        start: (n_x,) first state.
        iterations: Of each sample; None: of `feedback`.

    Returns:
        J, and the state (n_x,) at the end.
    """
    rhc = RHC(**problem.options)
    model = problem.options["model"]
    step = next_state(model, problem.options["dt"])
    goal = np.array(problem.goal)
    q = np.array(problem.options["q"])
    r = np.array(problem.options["r"])
    x = np.array(start)
    cost = 0.0
    for _ in range(problem.samples):
        rhc.prepare()
        given = dict(x=x, p=np.zeros(0), x_ref=goal, u_ref=np.zeros(len(model.inputs)))
        u = (
            rhc.feedback(**given)
            if iterations is None
            else rhc.solve(**given, iterations=iterations)
        )
        cost += q @ (x - goal) ** 2 + r @ u**2
        x = step(x, u, []).full().ravel()
    return cost, x


def excesses(problem, seeds, hessian="gauss_newton"):
    """How much dearer one iteration a sample is than 100, from random starts.

    Args:
        problem: A ControlProblem whose goal is a state.
        seeds: Of the starts, each state within SPREAD of the problem's start.
        hessian: Of the loop with one iteration; the other one is always solved by Gauss-Newton.

    Returns:
        DataFrame, a row for each: seed; the costs `one` and `solved`; excess, one/solved - 1; and
        the larger of both loops' distances [rad or m] of a weighted state from the goal at the end.
    """
    q = np.array(problem.options["q"])
    weighted = q > 1e-2 * max(q)
    chosen = problem._replace(options=problem.options | dict(hessian=hessian))
    rows = []
    for seed in seeds:
        start = _start(problem, seed)
        one, x_one = cost_of_loop(chosen, start, None)
        solved, x_solved = cost_of_loop(problem, start, 100)
        away = np.abs([x_one, x_solved] - np.array(problem.goal))[:, weighted].max()
        row = dict(seed=seed, one=one, solved=solved, excess=one / solved - 1, away=away)
        rows.append(row)
    return pd.DataFrame(rows)


def _start(problem, seed):
    """A random start (n_x,)."""
    spread = np.random.default_rng(seed).uniform(-SPREAD, SPREAD, len(problem.start))
    return problem.start + spread


def iterations_from_rest(problem, seeds, hessian, most=1000):
    """How many iterations solve the first sample's problem, from a robot that stays.

    Args:
        problem: A ControlProblem whose goal is a state.
        seeds: Of the starts, as in `excesses`.
        hessian: Of rhec.RHC.
        most: Iterations.

    Returns:
        DataFrame, a row for each: seed; iterations until `converged`, `most` + 1 if it never is.
    """
    rhc = RHC(**problem.options, hessian=hessian)
    given = dict(p=(), x_ref=problem.goal, u_ref=np.zeros(len(problem.options["model"].inputs)))
    rows = []
    for seed in seeds:
        start = _start(problem, seed)

        def is_converged(iterations, x=start):
            rhc.restart()
            rhc.solve(x, **given, iterations=iterations)
            return rhc.converged

        count = 1 + bisect.bisect_left(range(1, most + 1), True, key=is_converged)
        rows.append(dict(seed=seed, iterations=count))
    return pd.DataFrame(rows)


def summary(table):
    """Median excess with its 95 % interval, the worst, and how many starts end at the goal.

    Args:
        table: DataFrame of `excesses`.

    Returns:
        Series: median, low, high (by order statistics), worst, n_up (both loops within 0.05 of the
        goal), n.
    """
    between = quantile_test(table["excess"]).confidence_interval(0.95)
    return pd.Series(
        dict(
            median=table["excess"].median(),
            low=between.low,
            high=between.high,
            worst=table["excess"].max(),
            n_up=(table["away"] < 0.05).sum(),
            n=len(table),
        )
    )


def _main():
    """Print the summaries of 40 starts."""
    for define in (gallery.furuta, gallery.pendulum):
        for hessian in ("gauss_newton", "exact"):
            found = summary(excesses(define(), range(40), hessian)).to_dict()
            counts = iterations_from_rest(define(), range(40), hessian)["iterations"]
            quartiles = counts.quantile([0.25, 0.5, 0.75, 1.0]).tolist()
            print(define.__name__, hessian, found, "iterations", quartiles, flush=True)


if __name__ == "__main__":
    _main()
