"""The horizon of an RHC: its structure, and what all its QPs have in common."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core.model.base import Model, interval
from rhec.core.model.limits import is_plausible


class Horizon(NamedTuple):
    """The structure of an RHC, which decides the shapes of its Functions."""

    model: Model
    command: tuple[int, ...]  # places of the commanded inputs in `model.inputs`
    dt_s: float  # length of an interval [s]
    N: int  # intervals of the prediction
    # None for the QP by its stages, or an object whose `build(horizon)` returns a solver with the
    # methods of `rhec.core.controller.plain.StagewiseQP`.
    qp: Any = None
    damped: bool = False  # whether an iteration with a line search is built, too

    @property
    def plain(self):
        """The horizon without bounds of more than commands: itself."""
        return self

    @property
    def has_changes(self):
        """Whether changes of commands have weights or bounds: here not."""
        return False

    @property
    def soft_names(self):
        """Names of what a plan may exceed: here nothing."""
        return ()

    @property
    def n_x(self):
        """Length of the state x."""
        return len(self.model.states)

    @property
    def n_u(self):
        """Length of the input u, whether commanded or not."""
        return len(self.model.inputs)

    @property
    def n_s(self):
        """Length of the joint state s = (x, p)."""
        return self.n_x + len(self.model.parameters)

    @property
    def interval(self):
        """The model's shooting interval."""
        return interval(self.model, measured=False)

    @property
    def memory(self):
        """Shapes of the predicted joint states s and of the planned inputs u."""
        return dict(s=(self.n_s, self.N + 1), u=(self.n_u, self.N))

    @property
    def weights(self):
        """Shapes of the diagonals of Q and QN (states) and of R (commanded inputs)."""
        return dict(Q=(self.n_x, 1), QN=(self.n_x, 1), R=(len(self.command), 1))

    @property
    def references(self):
        """Shapes of the estimate s_0, the references, and the bounds of the commanded inputs."""
        bound = (len(self.command), 1)
        references = dict(s_0=(self.n_s, 1), x_ref=(self.n_x, self.N + 1), u_ref=(self.n_u, self.N))
        return references | dict(lower=bound, upper=bound)

    @property
    def data(self):
        """Shapes of what is new in each sample: here the references."""
        return self.references

    @property
    def dynamics(self):
        """Sparsities of F, D and B of all intervals, side by side."""
        return {name: ca.repmat(part, 1, self.N) for name, part in self.interval.sparsities.items()}

    def first_commands(self, settings):
        """What the memory holds besides the plan before the first sample: nothing."""
        return {}

    @property
    def loop_symbols(self):
        """SX or MX, for Functions that repeat an interval."""
        # In one piece, a step takes two thirds of the time, and a long horizon 7 s to compile. The
        # paper's horizon has 15 intervals, one command and six joint states.
        is_long = self.N > 15 or self.N * len(self.command) * self.n_s > 100
        return compiled.loop_symbols() if self.qp is None and is_long else ca.SX


def row_of_commands(u, horizon):
    """The commanded rows of inputs (n_u, N) as one row, sample by sample: (1, N·n_c)."""
    return ca.vec(u[list(horizon.command), :]).T


def for_all_samples(bound, horizon):
    """Repeat the bounds (n_c, 1) of one sample for all: (1, N·n_c)."""
    return ca.repmat(bound, horizon.N, 1).T


def finite_or(u_ref, u):
    """The references (n_u, N), with those of the last plan u where they are not finite."""
    return ca.if_else(ca.fabs(u_ref) < np.inf, u_ref, u)


def plain_stages(horizon):
    """A_0, and the sparsities of D and B, of the states x and the commanded inputs alone.

    The parameters do not move: with x alone the stages are half as large.
    """
    x = list(range(horizon.n_x))
    D = horizon.interval.sparsities["D"].sub(x, x)[0]
    B = horizon.interval.sparsities["B"].sub(x, list(horizon.command))[0]
    return horizon.interval.A_0[x, x], D, B


def commanded_stages(horizon, inputs):
    """D and B of all intervals, side by side, of the states x and the commanded inputs alone."""
    n_x = horizon.n_x
    D = ca.horzsplit(inputs["D"], horizon.n_s)
    B = ca.horzsplit(inputs["B"], horizon.n_u)
    return dict(
        D=ca.horzcat(*(part[:n_x, :n_x] for part in D)),
        B=ca.horzcat(*(part[:n_x, list(horizon.command)] for part in B)),
    )


def active_before(horizon, inputs):
    """The bounds at which the previous plan was, as a first guess of the active set: ±1 or 0."""
    u = row_of_commands(inputs["u"], horizon)
    at_upper = u >= for_all_samples(inputs["upper"], horizon)
    at_lower = u <= for_all_samples(inputs["lower"], horizon)
    return at_upper - at_lower


def planned(horizon, commands, u_ref):
    """The plan (n_u, N) from the rows of its commanded inputs; the others follow u_ref."""
    rows = ca.vertsplit(u_ref)
    for place, row in zip(horizon.command, commands):
        rows[place] = row
    return ca.vertcat(*rows)


def build_roll_out(horizon):
    """A function that rolls the linearised dynamics out from s_0 under new inputs.

    s_{i+1} = F_i + A_i (s_i - s̄_i) + B_i (u_i - ū_i), with (s̄, ū) from the previous plan. The gaps
    that multiple shooting leaves between the intervals close here.
    """
    n_s = horizon.n_s
    n_u = horizon.n_u
    s_i = (n_s, 1)
    u_i = (n_u, 1)
    F_i, D_i, B_i = horizon.interval.sparsities.values()

    @casadi_function("rhc_forward")
    def forward(F: F_i, D: D_i, B: B_i, s: s_i, u: u_i, s_new: s_i, u_new: u_i):
        A = horizon.interval.A_0 + D
        return dict(s_after=F + A @ (s_new - s) + B @ (u_new - u))

    def roll_out(s, u, F, D, B, s_0, u_new):
        nodes = [s_0]
        intervals = map(ca.horzsplit, (F, D, B, s, u, u_new), (1, n_s, n_u, 1, 1, 1))
        for *previous, u_new_i in zip(*intervals):
            nodes.append(forward(*previous, nodes[-1], u_new_i))
        return nodes

    return roll_out


def init(horizon, x, p, settings=None):
    """Memory before the first sample: the robot stays at x, with parameters p, nothing planned.

    Args:
        horizon: A Horizon, or a ConstrainedHorizon.
        x: (n_x,) state.
        p: (n_p,) parameters.
        settings: {name: array} of weights and bounds, which a ConstrainedHorizon needs.
    """
    plain = horizon.plain
    s = np.tile([*x, *p], (plain.N + 1, 1)).T
    return dict(s=s, u=np.zeros((plain.n_u, plain.N))) | horizon.first_commands(settings)


def states_after(horizon, ok, predicted, s, s_0):
    """The states for the next linearisation: those predicted or, after a step that failed, others.

    A step that failed leaves the shifted inputs. Its states s may be the cause, and would stay: the
    next linearisation starts from the estimate s_0, if that is plausible.
    """
    restarted = ca.if_else(is_plausible(s_0), ca.repmat(s_0, 1, horizon.N + 1), s)
    return ca.if_else(ok, predicted, restarted)
