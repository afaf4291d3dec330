"""Where the loss of a log is least, and how sure that is.

Losses of neighbouring samples are correlated, so that their number says little. Blocks of many
samples are nearly independent, and the scatter of their slopes tells how far the minimum may move
(the sandwich of Huber, 1967).
"""

import numpy as np

_BLOCKS = 20


def least(at, losses):
    """Where the sum L of losses is least, and its standard deviation.

    With the slopes g_b of the blocks' losses there, σ² = B/(B-1) Σ (g_b - ḡ)² / L''². The sum is
    least where the parabola through its lowest value and the two beside it is.

    Args:
        at: (m,) equidistant values of what is searched.
        losses: (m, n) loss of each sample at these, in the order of time.

    Returns:
        The value, and its standard deviation, at least that of rounding to the distance of `at`.
    """
    step = at[1] - at[0]
    n = losses.shape[1]
    block = np.arange(n) * _BLOCKS // n
    of_blocks = np.array([losses[:, block == each].sum(axis=1) for each in np.unique(block)])
    total = of_blocks.sum(axis=0)
    k = int(np.clip(np.argmin(total), 1, len(at) - 2))
    before, lowest, after = total[k - 1 : k + 2]
    bend = before - 2 * lowest + after
    if bend <= 0:
        return float(at[k]), np.inf
    shift = np.clip(0.5 * (before - after) / bend, -1, 1)
    slopes = (of_blocks[:, k + 1] - of_blocks[:, k - 1]) / 2
    sigma = step * np.sqrt(len(slopes)) * slopes.std(ddof=1) / bend
    return float(at[k] + step * shift), float(max(sigma, step / np.sqrt(12)))
