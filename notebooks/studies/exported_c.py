"""An export of `rhec.export`: agreement with Python, and memory.

What the tools of this machine cannot measure is left out.
"""

import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from notebooks.studies import toolchain
from rhec.simulation.columns import MEASUREMENTS


def sizes(export):
    """Measure an export, a folder, on this machine and on 64-bit Arm.

    Returns:
        DataFrame, one row a machine: the largest difference to Python in the export's log, and
        bytes of memory, code and stack. It is empty where a tool is missing.
    """
    export = Path(export)
    header = (export / "rhec_memory.h").read_text()
    log = export / "log.csv"
    expected = pd.read_csv(log).drop(columns=MEASUREMENTS)
    rows = []
    # The two are one where this machine is a 64-bit Arm.
    for machine in dict.fromkeys(filter(None, (toolchain.this_machine(), toolchain.arm()))):
        with tempfile.TemporaryDirectory() as folder:
            objects = toolchain.library(machine, export, folder)
            replay = toolchain.program(machine, export, "replay", objects)
            answers = toolchain.replay(machine, replay, log)[expected.columns]
            row = dict(
                machine=machine.name,
                largest_difference=np.abs(answers - expected).to_numpy().max(),
                memory_bytes=int(re.search(r"RHEC_MEMORY_BYTES (\d+)", header)[1]),
            )
            rows.append(row | toolchain.sizes(machine, objects))
    return pd.DataFrame(rows)
