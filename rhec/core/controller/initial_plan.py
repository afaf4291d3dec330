"""An initial plan: what the first sample of an RHC starts from, instead of a robot that stays."""

import numpy as np

from rhec.core._casadi.validation import numbers, refuse
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE


def checked_plan(stages, u_plan, x_plan):
    """Check a plan that a user passes.

    Args:
        stages: The Stages.
        u_plan: (n_u, N) or (n_u,) inputs, or None.
        x_plan: (n_x, N+1) states, or None for those to which the inputs lead.

    Returns:
        (u, x), copies of full size, x None if no states are given; None if both are None.

    Raises:
        ValueError: If one of them has another shape or an entry that is no number, or if there are
            states without inputs.
    """
    if u_plan is None:
        if x_plan is not None:
            raise ValueError("u_plan was None; with x_plan it should be the inputs (n_u, N)")
        return None
    u = _checked("u_plan", u_plan, (len(stages.model.inputs), stages.N))
    if x_plan is None:
        return u, None
    return u, _checked("x_plan", x_plan, (stages.n_x, stages.N + 1))


def planned_memory(stages, plan, lower, upper, x, p, known):
    """The first memory (s, u) of Stages that begins with a plan.

    Args:
        stages: The Stages.
        plan: That of `checked_plan`. Commands beyond a bound begin at it.
        lower: (n_c,) least commands.
        upper: (n_c,) greatest commands.
        x: (n_x,) state, which node 0 gets.
        p: (n_p,) parameters.
        known: (n_d, N) known signals.

    Returns:
        dict of s (n_s, N+1) and u (n_u, N).

    Raises:
        ValueError: If the inputs lead from a plausible x to states that are not.
    """
    u, nodes = plan
    u = u.copy()
    commands = list(stages.command)
    u[commands] = np.clip(u[commands].T, lower, upper).T
    if nodes is None:
        nodes = stages.model.simulate(
            x, u.T, p, dt=stages.dt_s, known=dict(zip(stages.model.known, known))
        ).T
        _check_simulated(nodes, np.concatenate([x, p]))
    s = np.tile([*x, *p], (stages.N + 1, 1)).T
    s[: stages.n_x, 1:] = nodes[:, 1:]
    return dict(s=s, u=np.vstack([u, known]))


def _check_simulated(nodes, start):
    """Refuse a plan that diverges; an estimate that is absurd by itself is not its fault."""
    if np.all(_is_plausible(start)) and not np.all(_is_plausible(nodes)):
        sample = int(np.argmin(np.all(_is_plausible(nodes), axis=0)))
        expected = "with x_plan, or other inputs, the controller could start"
        refuse(f"u_plan led at node {sample} to states", nodes[:, sample], expected)


def _checked(name, value, shape):
    """A copy of an argument as an array; one column stands for all."""
    array = numbers(name, value)
    if array.shape not in (shape, shape[:1]):
        expected = f"it should have {shape}, or {shape[:1]} if it is constant"
        raise ValueError(f"{name} had shape {array.shape}; {expected}")
    array = np.broadcast_to(array.reshape(shape[0], -1), shape).copy()
    bad = np.argwhere(~_is_plausible(array))
    if len(bad):
        row, column = map(int, bad[0])
        expected = f"it should be a number of at most {MAX_PLAUSIBLE_STATE:g} in size"
        refuse(f"{name}[{row}, {column}] was", array[row, column].item(), expected)
    return array


def _is_plausible(array):
    """Where an array holds numbers that may be states or inputs."""
    return np.abs(array) <= MAX_PLAUSIBLE_STATE
