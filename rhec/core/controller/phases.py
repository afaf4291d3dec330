"""The phases of an RHC (see `rhec.core.solver.rti`), whatever its stages weigh and bound.

What differs is an object, `PlainStages` (only commands are bounded) or `ConstrainedStages`:

- `loop_symbols`: SX or MX, for Functions that repeat a stage;
- `roll_out`: that of `build_roll_out`;
- `prepare(inputs)`: what the QP needs besides the dynamics, from memory, dynamics and weights;
- `solve(inputs)`: the QP's solution, with `change` (n_c, N) of the commands and `ok`;
- `command_bounds(inputs)`: lowest and highest commands, (n_c, 1) each;
- `remember(u)`: what the memory keeps of the last sample's plan besides;
- `tolerance`: the inputs of `kkt`, which gives the KKT tolerance after the feedback;
- `taken`: the name of the result of `solve` that tells whether the plan takes the change, which may
  be one that is not `ok`;
- `reported`: names of results of `solve` that a step returns besides;
- `search`: the Function that takes a share of an iteration's step, or None.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.controller.horizon import finite_or, planned, states_after
from rhec.core.solver import gauss_newton
from rhec.core.solver.rti import IMPROVE, iterate, run_phases


def build(horizon, stages):
    """Build the RHC as {name: Function}: shift, linearise, feedback, expand, step.

    `step` runs all phases; it maps (memory, weights, data) to (memory, kkt, command, ok). With a
    search there is `improve`, too, an iteration without shift.

    Args:
        horizon: A Horizon or ConstrainedHorizon.
        stages: Its stages.
    """
    linearise = _build_linearise(horizon, stages)
    feedback = _build_feedback(horizon, stages, linearise)
    expand = _build_expand(horizon, stages, feedback)
    phases = dict(shift=_build_shift(horizon, stages), linearise=linearise)
    phases |= dict(feedback=feedback, expand=expand)
    if stages.search:
        phases[IMPROVE] = _build_improve(horizon, stages, phases)
    return phases | dict(step=_build_step(horizon, stages, phases))


def _build_shift(horizon, stages):
    """The plan moved on by one sample."""
    plain = horizon.plain

    @casadi_function("rhc_shift", **horizon.memory)
    def shift(s, u, **others):
        s_after, u_after = gauss_newton.shift(plain.interval, s, u, plain.dt_s)
        return dict(s=s_after, u=u_after) | stages.remember(u)

    return shift


def _build_linearise(horizon, stages):
    """The dynamics along the plan, and what the QP can prepare."""
    plain = horizon.plain
    N = plain.N

    @casadi_function("rhc_linearise", stages.loop_symbols, **horizon.memory, **horizon.weights)
    def linearise(**inputs):
        dt_s = ca.repmat(ca.DM(plain.dt_s), 1, N)
        # Each interval is linearised at its own node, whether or not the nodes are connected.
        F, D, B = plain.interval.linearised.map(N)(inputs["s"][:, :N], inputs["u"], dt_s)
        dynamics = dict(F=F, D=D, B=B)
        return dynamics | stages.prepare(inputs | dynamics)

    return linearise


def _build_feedback(horizon, stages, linearise):
    """The estimate and the references complete the QP, which gives the new plan."""
    plain = horizon.plain
    shapes = {name: linearise.sparsity_out(name) for name in linearise.name_out()}
    shapes |= horizon.memory | horizon.weights | horizon.data

    @casadi_function("rhc_feedback", ca.MX, **shapes)
    def feedback(**inputs):
        solution = stages.solve(inputs)
        u = inputs["u"][list(plain.command), :] + solution.pop("change")
        # Rounding may take u + (upper - u) past the bound, which is a hard one.
        lower, upper = (ca.repmat(each, 1, plain.N) for each in stages.command_bounds(inputs))
        commands = ca.vertsplit(ca.fmin(ca.fmax(u, lower), upper))
        # With a reference that is not finite there is no step, and the last plan goes on.
        u_plan = planned(plain, commands, finite_or(inputs["u_ref"], inputs["u"]))
        return dict(u_plan=u_plan) | solution

    return feedback


def _build_expand(horizon, stages, feedback):
    """The predicted states of the new plan, and the KKT tolerance of the linearisation point."""
    plain = horizon.plain
    references = {name: plain.references[name] for name in ("s_0", "u_ref")}
    results = ("u_plan", *stages.tolerance, stages.taken)
    shapes = horizon.memory | plain.dynamics | references
    shapes |= {name: feedback.sparsity_out(name) for name in results}

    @short_cut(stages.taken)
    @casadi_function("rhc_expand", plain.loop_symbols, **shapes)
    def expand(s, u, F, D, B, s_0, u_ref, u_plan, **inputs):
        taken = inputs.pop(stages.taken)
        kept = {name: inputs.pop(name) for name in horizon.memory if name not in ("s", "u")}
        kkt = ca.if_else(taken, stages.kkt(u, u_ref, u_plan, **inputs), ca.DM.nan())
        predicted = ca.horzcat(*stages.roll_out(s, u, F, D, B, s_0, u_plan))
        after = states_after(plain, taken, predicted, s, s_0)
        return dict(s=after, u=u_plan) | kept | dict(kkt=kkt)

    return expand


def _build_step(horizon, stages, phases):
    """All phases of one sample as one Function, as a closed loop calls it."""
    memory = horizon.memory

    @with_packed_memory("rhc_step", memory, ca.MX, **horizon.weights, **horizon.data)
    def step(**values):
        values = run_phases(phases, values)
        command = values["u_plan"][:, 0]  # eq. (13)
        outputs = dict(kkt=values["kkt"], command=command, ok=values["ok"])
        return outputs | {name: values[name] for name in (*stages.reported, *memory)}

    return step


def _build_improve(horizon, stages, phases):
    """One iteration without shift: linearise, feedback, expand, and a share of their step.

    Where the QP was not solved, what expand leaves stays; the iteration after one that moved
    nothing, either, would be the same.
    """
    search = stages.search
    unknowns = horizon.plain.memory
    shapes = horizon.memory | horizon.weights | horizon.data

    @casadi_function("rhc_improve", ca.MX, **shapes, penalty=search.sparsity_in("penalty"))
    def improve(penalty, **inputs):
        values, full = iterate(phases, inputs)
        steps = {f"{name}_full": full[name] for name in unknowns}
        known = values | dict(kkt=full["kkt"], penalty=penalty) | steps
        chosen = search(**select_inputs(search, known))
        taken = values[stages.taken]
        moved = ca.norm_inf(ca.veccat(*(full[name] - inputs[name] for name in unknowns)))
        outputs = {name: values[name] for name in phases["feedback"].name_out()}
        outputs |= {name: full[name] for name in (*horizon.memory, "kkt")}
        outputs |= {name: ca.if_else(taken, chosen[name], full[name]) for name in unknowns}
        outputs["u_plan"] = outputs["u"]
        flags = dict(converged=chosen["converged"] * taken, ok=values["ok"] * chosen["near"])
        flags["done"] = ca.if_else(taken, chosen["done"], moved == 0)
        return outputs | flags | dict(penalty_after=chosen["penalty_after"])

    return improve
