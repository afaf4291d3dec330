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

from rhec.core._casadi.build import casadi_function, every, select_inputs, short_cut
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
    return ca.depends_on(ca.veccat(D, B), measured)


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
    """The Function of the interval at the inputs v_m, and whether its slopes are finite."""
    interval = window.interval
    s, P, v, *_ = window.shapes

    @casadi_function("rhe_newest_interval", window.symbols)
    def again(m_M: s, P_M: P, s_M: s, v_m: v, age: (1, 1), iteration: (1, 1)):
        F, D, B = interval.linearised(s_M, v_m, window.dt_s * (age >= 1))
        m, P = window.propagated(F, D, m_M, P_M, s_M)
        P = ca.densify(P)
        new = dict(s_N=F, v_N=v_m, B_N=B, m_N=m, P_N=P, F_newest=F, D_newest=D)
        numbers = ca.vertcat(F, D.nz[:], B.nz[:], m, ca.vec(P))
        return new | dict(is_new=is_plausible(numbers) * (iteration < 2))

    return again


@functools.cache
def _build_either(window):
    """The Function (is_first, pieces of one interval, pieces of another) -> those of either."""
    shapes = dict(is_first=(1, 1))
    for which in ("first", "second"):
        shapes |= {f"{name}_{which}": shape for name, shape in pieces_of(window).items()}

    @short_cut("is_first", ca.MX)
    @casadi_function("either_interval", ca.MX, **shapes)
    def either(is_first, **values):
        return {
            name: ca.if_else(is_first, values[f"{name}_first"], values[f"{name}_second"])
            for name in pieces_of(window)
        }

    return either


def _either(window, is_first, first, second):
    """The pieces of one of two intervals."""
    pairs = {f"{name}_first": piece for name, piece in first.items()}
    pairs |= {f"{name}_second": piece for name, piece in second.items()}
    return _build_either(window)(is_first=is_first, **pairs)


def _build_kept(window, again):
    """The Function of the variant with the inputs that are kept, unless they are the measured ones.

    Nearly always they are. Then nothing is computed.
    """
    pieces = pieces_of(window)
    shapes = {f"{name}_measured": shape for name, shape in pieces.items()}
    shapes |= pieces | {name: again.sparsity_in(name) for name in again.name_in()}

    @short_cut("is_same", ca.MX)
    @casadi_function("rhe_kept_interval", ca.MX, is_same=(1, 1), **shapes)
    def kept(is_same, **inputs):
        found = again(**select_inputs(again, inputs))
        prepared = {name: inputs[name] for name in pieces}
        found = _either(window, found.pop("is_new"), found, prepared)
        return {
            name: ca.if_else(is_same, inputs[f"{name}_measured"], found[name]) for name in pieces
        }

    return kept


def build(window, judge):
    """The Function (arrays of the phases, z_N, …) -> both variants, by name."""
    again = _build_interval(window)
    kept = _build_kept(window, again)
    choose = judge.build_kept(window)
    pieces = pieces_of(window)
    shapes = {name: choose.sparsity_in(name) for name in choose.name_in()} | window.noise
    shapes |= needs(window) | {name: pieces[name] for name in PIECES}

    @casadi_function("newest_intervals", ca.MX, **shapes)
    def intervals(**inputs):
        noise = {name: inputs[name] for name in window.noise}
        prepared = _prepared(window, inputs)
        z_kept = choose(**select_inputs(choose, inputs))["z_kept"]
        v_m, _ = window.interval.input_noise(inputs["z_N"], inputs["v_N"], **noise)
        v_kept, _ = window.interval.input_noise(z_kept, inputs["v_N"], **noise)
        given = inputs | dict(s_M=inputs["s"][:, window.N - 1], v_m=v_m)
        found = again(**select_inputs(again, given))
        measured = _either(window, found.pop("is_new"), found, prepared)
        given |= prepared | {f"{name}_measured": piece for name, piece in measured.items()}
        given |= dict(v_m=v_kept, is_same=every(v_kept == v_m))
        others = kept(**select_inputs(kept, given))
        results = {f"{name}_measured": piece for name, piece in measured.items()}
        return results | {f"{name}_kept": piece for name, piece in others.items()}

    return intervals


def chosen(window, values, verdict):
    """The pieces that go with the judge's verdict."""
    variants = (
        {name: values[f"{name}_{which}"] for name in pieces_of(window)}
        for which in ("measured", "kept")
    )
    return _either(window, verdict["as_measured"], *variants)


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
            # In parts of equal widths, so that whoever splits it again gets these without a copy.
            *before, _ = ca.horzsplit(values[array], pieces[piece].size2())
            changed[array] = ca.horzcat(*before, pieces[piece])
    return values | changed
