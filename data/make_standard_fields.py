"""The standard Gaussian fields that all slip fields are cut from, in rhec/tracked_robot/terrain.py:
two independent ones by GSTools' Fourier method, which makes them periodic.

`python data/make_standard_fields.py` makes the file again, in minutes. Half precision is plenty.
"""

from pathlib import Path

import gstools
import numpy as np

from rhec.tracked_robot.terrain import CELLS_PER_LENGTH

__all__ = ["make"]

FILE = Path(__file__).with_name("standard_gaussian_fields.npz")
PERIOD = 768
MODES = 144
SEED = 2018


def make(file=FILE):
    """Write both fields, (2, PERIOD, PERIOD), one value a cell, into `file`."""
    axis = np.arange(float(PERIOD))
    model = gstools.Gaussian(dim=2, var=1, len_scale=CELLS_PER_LENGTH)
    fields = [
        gstools.SRF(
            model, generator="Fourier", period=PERIOD, mode_no=MODES, seed=SEED + k
        ).structured([axis, axis])
        for k in range(2)
    ]
    fields = [(field - field.mean()) / field.std() for field in fields]
    np.savez_compressed(
        file,
        fields=np.array(fields, dtype=np.float16),
        gstools_version=gstools.__version__,
        seed=SEED,
    )


if __name__ == "__main__":
    make()
