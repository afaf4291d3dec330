"""How long the window of an RHE should be: where its measurements alone estimate best."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import Flag, NotNegatives, Positive, Positives, Reals, checked
from rhec.core.estimator.base import joint_guess, noise_of, variances_w
from rhec.core.model import base
from rhec.core.model.base import Model

_MORE = 0.05  # standard deviation that a shorter window may cost, as a share
_SHORTEST = 2
_LONGEST = 60
_STARTS = 10  # windows along the drive that the rule looks at


@checked
def suggest_window(
    *,
    model: Model,
    u: Any,
    dt: Positive,
    sigma_v: Positives,
    sigma_w: NotNegatives,
    guess: Reals,
    sigma_guess: Positives,
    noise_in_window: Flag = False,
) -> int:
    """Suggest the number of intervals of an RHE's window, by covariances along a typical drive.

    If the arrival cost is lost, a short window has too few measurements. In a long one the process
    noise that it neglects adds up, unless the RHE has `noise_in_window`. The rule is the shortest
    window whose score is within 5 % of the best one's, with the deviations σ of the newest node:

        score(N)² = mean over i of (σ_i(window of N intervals alone) / σ_i(Kalman filter))²

    A window alone begins with `sigma_guess`; the Kalman filter has seen the whole drive. Both are
    linearised at the states of the drive, and the mean is also one over ten windows. Only states
    and parameters with process noise count, and all states if none has any: the knowledge of a
    constant grows for ever, and the arrival cost keeps it.

    Args:
        model: The robot, a rhec.Model.
        u: (n, n_u) inputs of a typical drive, a row for each sample.
        dt: Length of a sample [s].
        sigma_v: Standard deviation of each output's measurement, in the output's unit.
        sigma_w: Standard deviations of the process noise per sample, of each state, then of each
            parameter.
        guess: States at the beginning of the drive, then parameters.
        sigma_guess: Standard deviations of the guess.
        noise_in_window: Whether the process noise also acts within the window, as in `rhec.RHE`.

    Returns:
        Intervals, from 2 to 60 or, of a short drive, to half of its samples.

    Raises:
        ValueError: If an argument is invalid, or if the drive has fewer than 4 samples.
    """
    s, sigma = joint_guess(model, guess, sigma_guess)
    u = _checked_inputs(model, u)
    steps = _linearised(model, u, dt, s, noise_of(model, sigma_v, sigma_w))
    best, _ = _deviations(steps, np.diag(sigma**2), neglects_noise=False)
    longest = min(_LONGEST, len(u) // 2)
    counts = _counting(model, sigma_w)
    squares = np.zeros(longest + 1)
    for start in np.linspace(len(u) - 2 * longest, len(u) - longest, _STARTS).astype(int):
        part = slice(start, start + longest + 1)
        # Constants are known as well as the arrival cost knows them.
        prior = np.where(counts, sigma, np.minimum(sigma, best[start]))
        alone, _ = _deviations(steps[part], np.diag(prior**2), neglects_noise=not noise_in_window)
        ratios = alone[:, counts] / best[part][:, counts]
        squares += np.mean(ratios**2, axis=1) / _STARTS
    scores = np.sqrt(squares)[_SHORTEST:]
    return _SHORTEST + int(np.argmax(scores <= (1 + _MORE) * scores.min()))


def _checked_inputs(model, u):
    """The inputs as an array (n, n_u)."""
    u = np.atleast_2d(np.asarray(u, float))
    if u.shape[1:] != (len(model.inputs),) or len(u) < 4:
        expected = f"it should have (n, {len(model.inputs)}), with n at least 4"
        raise ValueError(f"u had shape {u.shape}; {expected}")
    return u


def _counting(model, sigma_w):
    """Which entries (n_s,) of the joint state the rule looks at."""
    counts = variances_w(model, sigma_w) > 0
    n_x = len(model.states)
    return counts if counts.any() else np.arange(model.n_s) < n_x


class _Step(NamedTuple):
    """An interval and the node at its end, linearised at the drive."""

    A: Any  # (n_s, n_s)
    inputs: Any  # (n_s, n_s) covariance by the inputs, B R B'
    W: Any  # (n_s, n_s) covariance of the process noise
    H: Any  # (n, n_s) of the outputs that measure the joint state
    V: Any  # (n,)


def _linearised(model, u, dt, s, noise):
    """The _Steps (n + 1) of a drive from the joint state s; the first has no interval."""
    interval = base.interval(model)
    state = ca.SX.sym("s", interval.n_s)
    v = ca.SX.sym("v", interval.n_v)
    z = ca.SX.sym("z", len(model.outputs))
    c = noise.get("c")
    F, D, B = interval.linearised(state, v, dt)
    mean, R = interval.input_noise(z, v, noise["V"], c)
    W = ca.SX(interval.process_noise(mean, ca.DM(noise["W"]), dt, c))
    rows = ca.vertcat(ca.SX(0, interval.n_s), *(output.H(state) for output in interval.outputs))
    results = [F, interval.A_0 + D, B @ ca.diag(R) @ B.T, ca.diag(W)]
    step = ca.Function("step", [state, v, z], [ca.densify(each) for each in results])
    slopes = ca.Function("slopes", [state], [ca.densify(rows)])
    V = noise["V"][[output.row for output in interval.outputs]]
    none = np.zeros((interval.n_s, interval.n_s))
    steps = [_Step(np.eye(interval.n_s), none, none, np.array(slopes(s)), V)]
    for row in u:
        measured = np.zeros(len(model.outputs))
        for place, (output, _) in interval.input_outputs.items():
            measured[output] = row[place]
        s, *matrices = (np.array(each) for each in step(s, row, measured))
        steps.append(_Step(*matrices, np.array(slopes(s)), V))
    return steps


def _deviations(steps, P, neglects_noise):
    """Standard deviations (n, n_s) at the nodes of a Kalman filter that begins with P (n_s, n_s).

    S is the covariance of its error, and P the one that it computes. They differ where it neglects
    the process noise W:

        P⁻ = A P A' + B R B' (+ W),   S⁻ = A S A' + B R B' + W
        K = P⁻ H' / (H P⁻ H' + V),    S = (1 - K H) S⁻ (1 - K H)' + K V K'

    Returns:
        Those of S and of P.
    """
    S = P
    found = []
    for k, step in enumerate(steps):
        if k:
            added = step.inputs + step.W
            P = step.A @ P @ step.A.T + (step.inputs if neglects_noise else added)
            S = step.A @ S @ step.A.T + added
        for H, V in zip(step.H, step.V):
            K = P @ H / (H @ P @ H + V)
            kept = np.eye(len(P)) - np.outer(K, H)
            P = kept @ P
            S = kept @ S @ kept.T + V * np.outer(K, K)
        found.append((np.diag(S), np.diag(P)))
    return np.sqrt(np.moveaxis(found, 1, 0))
