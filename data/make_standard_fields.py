"""Make data/standard_gaussian_fields.npz, from which `rhec.tracked_robot.terrain` cuts slip.

The two independent fields are by GSTools' Fourier method, which makes them periodic. `python
data/make_standard_fields.py` makes the file again, in minutes. It needs the package gstools, of the
version that stands in the file, which nothing else here uses.
"""

from pathlib import Path

import gstools
import numpy as np

from rhec.tracked_robot.terrain import CELLS_PER_LENGTH

__all__ = ["make"]

FILE = Path(__file__).with_name("standard_gaussian_fields.npz")
PERIOD = 768  # cells
MODES = 144  # in each direction
SEED = 2018  # of the first field; the second has the next one


def make(file=FILE):
    """Write both fields into a file, an array (2, PERIOD, PERIOD) with a value for each cell."""
    axis = np.arange(float(PERIOD))
    model = gstools.Gaussian(dim=2, var=1, len_scale=CELLS_PER_LENGTH)
    fields = []
    for seed in (SEED, SEED + 1):
        field = gstools.SRF(model, generator="Fourier", period=PERIOD, mode_no=MODES, seed=seed)
        values = field.structured([axis, axis])
        fields.append((values - values.mean()) / values.std())
    # Half precision keeps three digits, more than soil needs.
    np.savez_compressed(
        file,
        fields=np.array(fields, dtype=np.float16),
        gstools_version=gstools.__version__,
        seed=SEED,
    )


if __name__ == "__main__":
    make()
