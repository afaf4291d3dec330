"""The newest interval of an RHE's window, at the input that was measured with the newest sample.

The preparation linearises this interval at the last input v̄, as no other is known yet, and predicts
the newest node linearly in the new one, m + B (v - v̄). Where the model is not linear in its inputs,
such as a steering angle, an input that jumps makes that prediction wrong by many of its standard
deviations. So before the sample is judged, the interval is linearised again, at v:

    F, D, B at (s_M, v),   m_N = F + A (m_M - s_M),   P_N = A P_M A'

with the mean m_M and the covariance P_M of the node before it. That is the prediction of an EKF.
There are two of them: with all inputs as they were "measured", and with those of them that are
"kept" if the judge doubts the others. Later iterations of `solve` take the input as it was
estimated: they have to end where the problem's own slopes are.

The window linearises its other intervals at inputs as they were estimated. One that was not
measured may be estimated anywhere in a single step, such as beyond the pole of tan. So a step takes
none beyond the range of the inputs that the window has had, and some σ.
"""

import functools

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.model import robot_model
from rhec.core.model.limits import is_plausible

BEFORE = ("m_M", "P_M")  # of the filter at the node before
PIECES = ("s_N", "v_N", "B_N", "m_N", "P_N")  # of a prediction; the end F and slopes D besides
VARIANTS = tuple(f"{name}_{which}" for which in ("measured", "kept") for name in PIECES)
# The window's arrays whose last columns are the interval's: {array: piece}.
_COLUMNS = dict(s="s_N", v="v_N", F="F_newest", D="D_newest", B="B_N")


@functools.cache
def bends(model):
    """Whether an interval's slopes depend on its measured inputs: otherwise nothing changes."""
    interval = robot_model.interval(model)
    s, v, dt_s = interval.linearised.sx_in()
    _, D, B = interval.linearised(s, v, dt_s)
    measured = v[[*interval.input_outputs]]
    return bool(measured.numel()) and ca.depends_on(ca.veccat(D, B), measured)


def pieces_of(window):
    """{name: shape} of the interval's pieces."""
    sparse = window.interval.sparsities
    shapes = window.prediction | dict(s_N=window.shapes[0])
    return shapes | dict(F_newest=sparse["F"], D_newest=sparse["D"])


def variants_of(window):
    """{name: shape} of the predictions that the judge is given, where there are two."""
    shapes = pieces_of(window)
    return {name: shapes[name.rsplit("_", 1)[0]] for name in VARIANTS}


def needs(window):
    """{name: shape} of what the variants are made of."""
    s, P, *_ = window.shapes
    N = window.N
    columns = {name: ca.repmat(each, 1, N) for name, each in window.interval.sparsities.items()}
    pieces = dict(s=window.pieces.s, v=window.pieces.v, age=(1, 1), iteration=(1, 1))
    return columns | pieces | dict(zip(BEFORE, (s, P)))


def _prepared(window, values):
    """The pieces of the interval as it was prepared, from the phases' arrays."""
    last = dict(F_newest=values["F"][:, -1], D_newest=values["D"][:, -window.interval.n_s :])
    return {name: values[name] for name in PIECES} | last


def _build_interval(window):
    """The Function of one variant; where it has no finite slopes, it stays as it was prepared."""
    interval = window.interval
    s, P, _, z, *_ = window.shapes

    @casadi_function("rhe_newest_interval", window.symbols)
    def again(
        prepared: pieces_of(window),
        m_M: s,
        P_M: P,
        s_M: s,
        z_N: z,
        age: (1, 1),
        iteration: (1, 1),
        noise: window.noise,
    ):
        v_m, _ = interval.input_noise(z_N, prepared["v_N"], **noise)
        F, D, B = interval.linearised(s_M, v_m, window.dt_s * (age >= 1))
        m, P = window.propagated(F, D, m_M, P_M, s_M)
        P = ca.densify(P)
        new = dict(s_N=F, v_N=v_m, B_N=B, m_N=m, P_N=P, F_newest=F, D_newest=D)
        is_new = is_plausible(ca.veccat(F, D, B, m, P)) * (iteration < 2)
        return {name: ca.if_else(is_new, new[name], prepared[name]) for name in prepared}

    return again


def build(window, judge):
    """The Function (arrays of the phases, z_N, …) -> both variants, by name."""
    again = _build_interval(window)
    kept = judge.build_kept(window)
    pieces = pieces_of(window)
    shapes = {key: again.sparsity_in(key) for key in again.name_in() if key not in ("s_M", *pieces)}
    shapes |= {key: kept.sparsity_in(key) for key in kept.name_in()}
    shapes |= needs(window) | {name: pieces[name] for name in PIECES}

    @casadi_function("newest_intervals", ca.MX, **shapes)
    def intervals(**inputs):
        given = inputs | _prepared(window, inputs) | dict(s_M=inputs["s"][:, window.N - 1])
        z_kept = kept(**select_inputs(kept, inputs))["z_kept"]
        results = {}
        for which, z in dict(measured=inputs["z_N"], kept=z_kept).items():
            found = again(**select_inputs(again, given | dict(z_N=z)))
            results |= {f"{name}_{which}": found[name] for name in pieces}
        return results

    return intervals


def chosen(window, values, verdict):
    """The pieces that go with the judge's verdict."""
    pairs = {
        name: (values[f"{name}_measured"], values[f"{name}_kept"]) for name in pieces_of(window)
    }
    return {name: ca.if_else(verdict["as_measured"], *pair) for name, pair in pairs.items()}


def within_range(window, v_new, v, V):
    """New inputs (n_v, N), those with an output of their own within the range of the last ones v.

    The range is that of the window's intervals, and as many σ as the judge grants an input.
    """
    rows = ca.vertsplit(v_new)
    for place, (row, _) in window.interval.input_outputs.items():
        margin = ca.sqrt(2 * window.judge.limit(window) * V[row])
        lower = ca.mmin(v[place, :]) - margin
        upper = ca.mmax(v[place, :]) + margin
        rows[place] = ca.fmin(ca.fmax(rows[place], lower), upper)
    return ca.vertcat(*rows)


def replaced(values, pieces):
    """The phases' arrays `values` with these pieces of the newest interval, by name."""
    changed = dict(pieces)
    for array, piece in _COLUMNS.items():
        if array in values and piece in pieces:
            kept = values[array].size2() - pieces[piece].size2()
            changed[array] = ca.horzcat(values[array][:, :kept], pieces[piece])
    return values | changed
