"""The phases of an RHC (see `rhec.core.solver.rti`), whatever its stages weigh and bound."""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.controller.qp import solver_of
from rhec.core.controller.stages import (
    build_cost,
    build_node,
    linearised_outputs,
    repeated,
    weights_at_end,
    weights_before_end,
)
from rhec.core.model.limits import is_plausible
from rhec.core.solver import gauss_newton
from rhec.core.solver.rti import IMPROVE, iterate, run_phases


def build_phases(stages):
    """Build the RHC as {name: Function}: shift, linearise, feedback, expand, step.

    `step` runs all phases; it maps (memory, weights, data) to (memory, kkt, command, ok). Damped
    stages have `improve`, too, an iteration without shift.
    """
    qp = solver_of(stages)
    roll_out = _build_roll_out(stages)
    linearise = _build_linearise(stages, qp)
    condition = _build_condition(stages, roll_out)
    feedback = _build_feedback(stages, qp, condition, linearise)
    expand = _build_expand(stages, roll_out, feedback)
    phases = dict(shift=_build_shift(stages), linearise=linearise, feedback=feedback, expand=expand)
    if stages.damped:
        of_iteration = _build_feedback(
            stages, qp, condition, linearise, dict.fromkeys(qp.chosen, (1, 1))
        )
        phases[IMPROVE] = _build_improve(stages, qp, phases | dict(feedback=of_iteration))
    return phases | dict(step=_build_step(stages, qp, phases))


def init(stages, x, p, settings=None):
    """Memory before the first sample: the robot stays at x, with parameters p, nothing planned.

    Args:
        stages: The Stages.
        x: (n_x,) state.
        p: (n_p,) parameters.
        settings: {name: array} with the bounds, where changes of commands count.
    """
    s = np.tile([*x, *p], (stages.N + 1, 1)).T
    memory = dict(s=s, u=np.zeros((stages.n_u, stages.N)))
    if stages.has_changes:
        # 0, or the nearest number within their bounds.
        lower, upper = (settings[name][: stages.n_c] for name in ("lower", "upper"))
        memory |= dict(before=np.clip(0.0, lower, upper))
    return memory


def _build_shift(stages):
    """The plan moved on by one sample."""

    @casadi_function("rhc_shift", **stages.memory)
    def shift(s, u, before=None):
        s_after, u_after = gauss_newton.shift(stages.interval, s, u, stages.dt_s)
        commanded = {} if before is None else dict(before=u[list(stages.command), 0])
        return dict(s=s_after, u=u_after) | commanded

    return shift


def _build_linearise(stages, qp):
    """The dynamics and the outputs along the plan, and what the QP can prepare."""
    N = stages.N

    @casadi_function("rhc_linearise", stages.loop_symbols, **stages.memory, **stages.weights)
    def linearise(s, u, **others):
        dt_s = ca.repmat(ca.DM(stages.dt_s), 1, N)
        # Each interval is linearised at its own node, whether or not the nodes are connected.
        F, D, B = stages.interval.linearised.map(N)(s[:, :N], u, dt_s)
        found = dict(F=F, D=D, B=B)
        if stages.n_y:
            found |= zip("YCE", linearised_outputs(stages).map(N + 1)(s, repeated(u)))
        return found | qp.prepare(others | found)

    return linearise


def _build_feedback(stages, qp, condition, linearise, chosen=None):
    """The estimate and the references complete the QP, which gives the new plan.

    `chosen` has the shapes of what an iteration chooses of the QP besides.
    """
    shapes = {name: linearise.sparsity_out(name) for name in linearise.name_out()}
    shapes |= stages.memory | stages.weights | stages.data | (chosen or {})

    @casadi_function("rhc_feedback", ca.MX, **shapes)
    def feedback(**inputs):
        at_plan = condition(**select_inputs(condition, inputs))
        solution = qp.solve(at_plan, inputs)
        u = inputs["u"]
        u_ref = inputs["u_ref"]
        commands = u[list(stages.command), :] + solution.pop("change")
        # Rounding may take u + (upper - u) past the bound, which is a hard one.
        commands = _within_bounds(stages, commands, inputs)
        # With a reference that is not finite there is no step, and the last plan goes on.
        finite = ca.if_else(ca.fabs(u_ref) < np.inf, u_ref, u)
        return dict(u_plan=_planned(stages, commands, finite)) | solution

    return feedback


def _within_bounds(stages, commands, inputs):
    """Commands (n_c, N) that are beyond a bound, at it."""
    # Their bounds are the first of all.
    bounds = (inputs[name][: stages.n_c] for name in ("lower", "upper"))
    lower, upper = (ca.repmat(bound, 1, stages.N) for bound in bounds)
    return ca.fmin(ca.fmax(commands, lower), upper)


def _planned(stages, commands, u_ref):
    """The plan (n_u, N) with these commands (n_c, N); the other inputs follow u_ref."""
    rows = ca.vertsplit(u_ref)
    for place, row in zip(stages.command, ca.vertsplit(commands)):
        rows[place] = row
    return ca.vertcat(*rows)


def _build_roll_out(stages):
    """A function that rolls the linearised dynamics out from s_0 under new inputs.

    s_{i+1} = F_i + A_i (s_i - s̄_i) + B_i (u_i - ū_i), with (s̄, ū) from the previous plan. The gaps
    that multiple shooting leaves between the intervals close here.
    """
    n_s = stages.n_s
    n_u = stages.n_u
    s_i = (n_s, 1)
    u_i = (n_u, 1)
    F_i, D_i, B_i = stages.interval.sparsities.values()

    @casadi_function("rhc_forward")
    def forward(F: F_i, D: D_i, B: B_i, s: s_i, u: u_i, s_new: s_i, u_new: u_i):
        A = stages.interval.A_0 + D
        return dict(s_after=F + A @ (s_new - s) + B @ (u_new - u))

    def roll_out(s, u, F, D, B, s_0, u_new):
        nodes = [s_0]
        intervals = map(ca.horzsplit, (F, D, B, s, u, u_new), (1, n_s, n_u, 1, 1, 1))
        for *previous, u_new_i in zip(*intervals):
            nodes.append(forward(*previous, nodes[-1], u_new_i))
        return ca.horzcat(*nodes)

    return roll_out


def _build_condition(stages, roll_out):
    """The QP's gradient and rows of all nodes, at the previous plan from the new estimate."""
    node = build_node(stages)
    shapes = {name: ca.repmat(each, 1, stages.N + 1) for name, each in stages.slopes.items()}
    shapes |= stages.dynamics | stages.memory | stages.weights | stages.references

    @casadi_function("rhc_condition", stages.loop_symbols, **shapes)
    def condition(F, D, B, s, u, s_0, x_ref, u_ref, before=None, **given):
        command = list(stages.command)
        plan = _planned(stages, u[command, :], u_ref)
        nodes = roll_out(s, u, F, D, B, s_0, plan)
        # Without weights or bounds of changes, it does not matter what was before.
        first = plan[command, 0] if before is None else before
        u_before = ca.horzcat(first, plan[command, :])
        columns = dict(s=nodes, u=repeated(plan), u_before=u_before)
        columns |= dict(x_ref=x_ref, u_ref=repeated(u_ref))
        if stages.n_y:
            columns |= dict(s_old=s, u_old=repeated(u), y_ref=given["y_ref"])
            columns |= {name: given[name] for name in stages.slopes}
        weights = weights_before_end(stages, given)
        return _at_nodes(node, stages.N, columns, weights, weights_at_end(stages, given))

    return condition


def _at_nodes(node, N, columns, weights, weights_N):
    """The results of a node's Function at the nodes 0 … N, side by side.

    Args:
        node: The Function.
        N: Number of intervals.
        columns: {input: what it is at the nodes 0 … N, side by side}.
        weights: {input: what it is at each of the nodes 0 … N-1}.
        weights_N: The same at node N.
    """
    widths = {name: node.size2_in(name) for name in columns}
    before_end = {name: each[:, : N * widths[name]] for name, each in columns.items()}
    at_end = {name: each[:, N * widths[name] :] for name, each in columns.items()}
    along = node.map(N)(**before_end, **weights)
    last = node(**at_end, **weights_N)
    return {name: ca.horzcat(along[name], last[name]) for name in node.name_out()}


def _build_expand(stages, roll_out, feedback):
    """The predicted states of the new plan, and the KKT tolerance of the linearisation point."""
    found = ("u_plan", "decrease", "complementarity", "solved")
    shapes = stages.memory | stages.dynamics | dict(s_0=stages.references["s_0"])
    shapes |= {name: feedback.sparsity_out(name) for name in found}

    @short_cut("solved")
    @casadi_function("rhc_expand", stages.loop_symbols, **shapes)
    def expand(s, u, F, D, B, s_0, u_plan, decrease, complementarity, solved, **kept):
        kkt = ca.if_else(solved, decrease + complementarity, ca.DM.nan())
        predicted = roll_out(s, u, F, D, B, s_0, u_plan)
        after = _states_after(stages, solved, predicted, s, s_0)
        return dict(s=after, u=u_plan) | kept | dict(kkt=kkt)

    return expand


def _states_after(stages, solved, predicted, s, s_0):
    """The states for the next linearisation: those predicted or, after a step that failed, others.

    A step that failed leaves the shifted inputs. Its states s may be the cause, and would stay: the
    next linearisation starts from the estimate s_0, if that is plausible.
    """
    restarted = ca.if_else(is_plausible(s_0), ca.repmat(s_0, 1, stages.N + 1), s)
    return ca.if_else(solved, predicted, restarted)


def _build_step(stages, qp, phases):
    """All phases of one sample as one Function, as a closed loop calls it."""
    memory = stages.memory

    @with_packed_memory("rhc_step", memory, ca.MX, **stages.weights, **stages.data)
    def step(**values):
        values = run_phases(phases, values)
        command = values["u_plan"][:, 0]  # eq. (13)
        outputs = dict(kkt=values["kkt"], command=command, ok=values["ok"])
        return outputs | {name: values[name] for name in (*qp.reported, *memory)}

    return step


def _build_improve(stages, qp, phases):
    """One iteration without shift: linearise, feedback, expand, and a share of their step.

    Commands beyond a bound begin at it. The merit does not know their bounds, and would refuse the
    way back to them, where it raises the cost: from a first plan of 0, or after `update`.

    Where the QP was not solved, what expand leaves stays, or the plan before, if the search wants
    it to be tried `again` with other prices. Else the iteration after one that moved nothing,
    either, would be the same.
    """
    search = _build_search(stages, qp)
    unknowns = stages.unknowns
    shapes = stages.memory | stages.weights | stages.data

    @casadi_function("rhc_improve", ca.MX, **shapes, penalty=search.sparsity_in("penalty"))
    def improve(penalty, **inputs):
        commands = _within_bounds(stages, inputs["u"][list(stages.command), :], inputs)
        inputs |= dict(u=_planned(stages, commands, inputs["u"]))
        chosen = {name: penalty[place] for name, place in qp.chosen.items()}
        values, full = iterate(phases, inputs | chosen)
        steps = {f"{name}_full": full[name] for name in unknowns}
        known = values | dict(kkt=full["kkt"], penalty=penalty) | steps
        found = search(**select_inputs(search, known))
        solved = values["solved"]
        moved = ca.norm_inf(ca.veccat(*(full[name] - inputs[name] for name in unknowns)))
        outputs = {name: values[name] for name in phases["feedback"].name_out()}
        outputs |= {name: full[name] for name in (*stages.memory, "kkt")}
        unsolved = {name: full[name] for name in unknowns}
        is_over = moved == 0
        if "again" in found:
            again = found["again"]
            unsolved = {name: ca.if_else(again, inputs[name], full[name]) for name in unknowns}
            is_over *= ca.logic_not(again)
        outputs |= {name: found[f"{name}_shown"] for name in outputs if f"{name}_shown" in found}
        outputs |= {name: ca.if_else(solved, found[name], unsolved[name]) for name in unknowns}
        outputs["u_plan"] = outputs["u"]
        flags = dict(converged=found["converged"] * solved, ok=values["ok"] * found["near"])
        flags["done"] = ca.if_else(solved, found["done"], is_over)
        return outputs | flags | dict(penalty_after=found["penalty_after"])

    return improve


def _build_search(stages, qp):
    """How far to go along a step, as what solves the QP says."""
    cost = build_cost(stages)
    data = {name: cost.sparsity_in(name) for name in cost.name_in() if name not in stages.unknowns}
    return qp.search("rhc_search", stages.unknowns, data, cost)
