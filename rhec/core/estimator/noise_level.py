"""How noisy the judged measurements are, as the judge learns it from the samples themselves.

A receiver may become many times noisier than its `sigma_v` says, such as RTK that falls to float.
Its samples are rejected then, and they scatter: their second differences

    q = mean of b' (6 S)⁻¹ b / n_y,  b = y_k - 2 y_{k-1} + y_{k-2},  over those rejected in a row

tell by how much their variance exceeds S. Above `scattered` no restart among them would be right,
and there is no need to wait for one. The variances V of the judged outputs are multiplied by q
instead, in the whole window. If the sample agrees with its prediction then, the window goes on with
it; otherwise it restarts with this noise.

Less noise, or a σ that was said too small, lets most samples pass, and rejects one now and then.
Once more than `many` of the last ones are rejected, the factor follows q of every sample, used or
not, until it is 1 again. One sample multiplies it by no more than `most`, so that a wild one, which
is part of three second differences, moves it little. Innovations that are all alike are no noise,
but an estimate that is off. At 1 the factor changes nothing.
"""

from typing import NamedTuple

import casadi as ca

from rhec.core._casadi.build import casadi_function

SHAPES = dict.fromkeys(("spread", "line_spread", "noise_scale", "share"), (1, 1))
MAX_SCALE = 1e15


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived, on the drives of `innovation_gate.Tuned`."""

    # name: value  # [unit] meaning
    scattered: float = 4.0  # [S] of second differences; of samples without a new noise 1
    many: float = 0.02  # [1] share of rejected samples, above which each one tells of noise
    most: float = 1.5  # [1] by which one sample multiplies the noise, however wild it is
    patience: int = 8  # [samples] rejected in a row, after which those that scatter are noisier


TUNED = Tuned()
USUAL = dict(spread=0, line_spread=0, noise_scale=1)  # the memory of usual noise


def is_usual(memory):
    """Whether the noise is what it should be, and few samples were rejected."""
    return (memory["noise_scale"] <= 1) * (memory["share"] <= TUNED.many)


def scale_of(memory):
    """The factor of the variances of judged outputs; nothing remembered is 1."""
    return ca.fmax(memory["noise_scale"], 1)


def bend_of(memory, y):
    """The second difference of innovations, with the newest one y."""
    return y - 2 * memory["trail"][:, 0] + memory["trail"][:, 1]


def spreads(memory, square, has_any, is_line):
    """q with this sample's square: of those rejected in a row but two, and of those in line."""
    n = memory["rejected"] - 1
    mean = memory["spread"] + (square - memory["spread"]) / ca.fmax(n, 1)
    in_line = memory["line_spread"] + (square - memory["line_spread"]) / (memory["in_line"] + 1)
    return dict(
        spread=ca.if_else((n > 0) * has_any, ca.fmin(mean, MAX_SCALE), memory["spread"]),
        line_spread=is_line * in_line,
    )


def is_noisy(run, is_in_line, scale):
    """Whether the samples of a run scatter: the last ones if they are in line, else many of them.

    Wild samples before a line say nothing of those in it. What is in line only by a noise of this
    scale, which the run itself may have raised, scatters.
    """
    is_told = ca.logic_or(is_in_line, run["rejected"] >= TUNED.patience)
    spread = ca.if_else(run["in_line"] > 0, run["line_spread"] * scale, run["spread"])
    return is_told * (spread > TUNED.scattered)


def followed(memory, square, is_told):
    """The noise's factor after a sample.

    Args:
        memory: The memory before the sample.
        square: Its second difference, as q.
        is_told: Whether it tells of noise.
    """
    scale = scale_of(memory)
    # The logarithm follows with a weight of 1/8. That of a square of noise is -0.58 in the mean.
    factor = ca.fmin(ca.sqrt(ca.sqrt(ca.sqrt(1.78 * square))), TUNED.most)
    is_many = memory["share"] > TUNED.many
    return ca.if_else(is_told * ca.logic_or(scale > 1, is_many), ca.fmax(1, scale * factor), scale)


def share_after(memory, is_rejected, has_any, n):
    """The share of rejected samples among about the last n that had outputs."""
    return memory["share"] + has_any * (is_rejected - memory["share"]) / n


def scaled(window, V, scale):
    """The variances V (n_z,) of which those of the judged outputs are multiplied by the scale."""
    judged = {output.row for output in window.judge.outputs(window)}

    @casadi_function("scaled_variances")
    def variances(V: (V.numel(), 1), scale: (1, 1)):
        factors = [ca.fmax(scale, 1) if row in judged else 1 for row in range(V.numel())]
        return dict(V=V * ca.vertcat(*factors))

    return variances(V=V, scale=scale)["V"]
