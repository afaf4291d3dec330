"""What solves the QP of an RHC's stages, in changes z of (x, commands before, commands):

    min  ½ z'Hz + g'z   s.t. the linearised dynamics, lower ≤ rows + Gz ≤ upper
    H = J'WJ,  g = J'W (w - w_r),  G = some rows of J

Either solver has the methods of `ActiveSet`.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function
from rhec.core.controller.stages import (
    bounds_of_nodes,
    counts_at_end,
    jacobian,
    weight,
    weights_at_end,
    weights_before_end,
)
from rhec.core.solver.interior_point import Shape, interior_point
from rhec.core.solver.line_search import line_search_of_plan
from rhec.core.solver.relaxation import RELIEF, relaxation
from rhec.core.solver.stage_qp import stage_qp


def solver_of(stages):
    """What solves the QP of Stages."""
    if stages.qp:
        return stages.qp.build(stages)
    return InteriorPoint(stages) if stages.is_general else ActiveSet(stages)


class ActiveSet:
    """The QP by a Riccati recursion, where only the commands are bounded and weights are diagonals.

    Args:
        stages: The Stages.
    """

    reported = ()  # results of `solve` that a step of the RHC returns besides
    # {input of `solve` that iterations alone choose, and that is 0 else: its place in `penalty`}
    chosen = {}
    search = staticmethod(line_search_of_plan)  # how far iterations go along a step

    def __init__(self, stages):
        self._stages = stages
        # The parameters do not move: with x alone the stages are half as large.
        x = list(range(stages.n_x))
        D = stages.interval.sparsities["D"].sub(x, x)[0]
        B = stages.interval.sparsities["B"].sub(x, list(stages.command))[0]
        W = (ca.Sparsity.diag(n) for n in (stages.n_x, stages.n_c))
        A_0 = stages.interval.A_0[x, x]
        self._solve = stage_qp(stages.N, A_0, D, B, *W, stages.loop_symbols)

    def prepare(self, inputs):
        """What the linearisation can compute of the QP: nothing without the active set."""
        return {}

    def solve(self, at_plan, inputs):
        """Solve the QP.

        Args:
            at_plan: g of all nodes side by side, and the rows, at the plan rolled out.
            inputs: Those of the feedback phase, by name.

        Returns:
            dict of the `change` (n_c, N) of the commands; `decrease` |g'z| and `complementarity`
            Σ |λd| with the distances d to the bounds, whose sum is the KKT tolerance; `solved`, and
            `ok`, whether the solution keeps all bounds.
        """
        stages = self._stages
        weights = {name: ca.diag(inputs[name]) for name in stages.weights}
        commands = at_plan["rows"][:, : stages.N]
        bounds = {name: ca.vec(inputs[name] - commands).T for name in ("lower", "upper")}
        dynamics = commanded(stages, inputs)
        active = _active_before(stages, inputs)
        solution = self._solve(**dynamics, **weights, g=at_plan["g"], **bounds, active=active)
        multipliers = solution["multipliers"]
        distance = ca.if_else(multipliers > 0, bounds["upper"], bounds["lower"])
        return dict(
            change=ca.reshape(solution["x"], stages.n_c, stages.N),
            decrease=ca.fabs(solution["slope"]),
            complementarity=ca.sum2(ca.fabs(multipliers * distance)),
            solved=solution["solved"],
            ok=solution["solved"],
        )


def commanded(stages, inputs):
    """D and B of all intervals, side by side, of the states x and the commanded inputs alone."""
    n_x = stages.n_x
    D = ca.horzsplit(inputs["D"], stages.n_s)
    B = ca.horzsplit(inputs["B"], stages.n_u)
    return dict(
        D=ca.horzcat(*(part[:n_x, :n_x] for part in D)),
        B=ca.horzcat(*(part[:n_x, list(stages.command)] for part in B)),
    )


def _active_before(stages, inputs):
    """The bounds at which the previous plan was, as a first guess of the active set: ±1 or 0."""
    u = ca.vec(inputs["u"][list(stages.command), :]).T
    lower, upper = (ca.repmat(inputs[name], stages.N, 1).T for name in ("lower", "upper"))
    return (u >= upper) - (u <= lower)


class InteriorPoint:
    """The QP of any stages.

    Args:
        stages: The Stages.
    """

    reported = ("iterations", "excess")
    chosen = dict(relief=RELIEF)
    search = staticmethod(relaxation)

    def __init__(self, stages):
        self._stages = stages
        self._stage = _build_stage(stages, at_end=False)
        self._last_stage = _build_stage(stages, at_end=True)
        x = list(range(stages.n_x))
        n_added = stages.n_z - stages.n_x
        A_0 = ca.diagcat(stages.interval.A_0[x, x], ca.DM(n_added, n_added))
        parts = (self._stage.sparsity_out(name) for name in ("qp_D", "qp_B", "G"))
        self._solve = interior_point(Shape(stages.N, A_0, *parts, len(stages.bounded)))

    def prepare(self, inputs):
        """Dynamics, Hessian and rows of all nodes."""
        stages = self._stages
        n_s, n_u, N = stages.n_s, stages.n_u, stages.N
        D, B = inputs["D"], inputs["B"]
        slopes = [(inputs[name], n) for name, n in (("C", n_s), ("E", n_u)) if name in inputs]
        # A map is a loop in C. N inlined calls would take the compiler longer than all the rest.
        before_end = [each[:, : N * n] for each, n in slopes]
        weights = weights_before_end(stages, inputs).values()
        path = self._stage.map(N)(D, B, *before_end, *weights)
        at_end = [each[:, N * n :] for each, n in slopes]
        # Weights of its commands, which change nothing, make the last stage's solution unique.
        weights = weights_at_end(stages, inputs, of_commands=1).values()
        end = self._last_stage(D[:, -n_s:], B[:, -n_u:], *at_end, *weights)
        names = self._stage.name_out()
        sparsities = map(self._stage.sparsity_out, names)
        last = [ca.project(each, sparsity) for each, sparsity in zip(end, sparsities)]
        return {name: ca.horzcat(*both) for name, *both in zip(names, path, last)}

    def solve(self, at_plan, inputs):
        """Solve the QP, as `ActiveSet.solve`."""
        stages = self._stages
        lower, upper = bounds_of_nodes(stages, inputs)
        rows = at_plan["rows"]
        qp = {name: inputs[name] for name in ("H", "G", "linear", "quadratic")}
        qp |= {name: inputs[name] for name in self.chosen if name in inputs}
        qp |= dict(D=inputs["qp_D"], B=inputs["qp_B"], g=at_plan["g"])
        solution = self._solve(**qp, lower=lower - rows, upper=upper - rows)
        z = solution.pop("z")
        return solution | dict(
            change=z[stages.n_z :, : stages.N],
            decrease=ca.fabs(ca.dot(at_plan["g"], z)),
            ok=solution["solved"] * (ca.sum1(solution["excess"]) == 0),
        )


def _build_stage(stages, at_end):
    """The Function of a stage of the QP: dynamics, the Hessian H = J'WJ, and rows G of J."""
    n_x = stages.n_x
    shapes = {name: stages.interval.sparsities[name] for name in ("D", "B")}
    shapes |= {name: sparsity for name, sparsity in stages.slopes.items() if name != "Y"}
    shapes |= weights_before_end(stages, stages.weights)

    @casadi_function("rhc_last_stage" if at_end else "rhc_stage", **shapes)
    def stage(D, B, C=None, E=None, **weights):
        # Commands of node N change nothing.
        E = ca.SX(stages.n_y, stages.n_u) if at_end or E is None else E
        C = ca.SX(0, stages.n_s) if C is None else C
        J = jacobian(stages, C, E)
        G = J[stages.rows, :]
        if at_end:
            G = ca.diag(counts_at_end(stages)[stages.rows]) @ G
        added = ca.SX(stages.n_z - n_x, stages.n_z - n_x)
        now_before = ca.DM.eye(stages.n_c)[: stages.n_z - n_x, :]
        return dict(
            qp_D=ca.diagcat(D[:n_x, :n_x], added),
            qp_B=ca.vertcat(B[:n_x, list(stages.command)], now_before),
            H=ca.densify(J.T @ weight(stages, **weights) @ J),
            G=G,
        )

    return stage
