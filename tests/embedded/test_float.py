"""The exported C with numbers as float: close to Python's doubles, in 64 KiB of RAM."""

import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec.embedded import LOG
from rhec.simulation.columns import MEASUREMENTS
from rhec.workbench.studies.embedded import toolchain

BOARD = Path(__file__).with_name("cortex_m")
RAM_BYTES = 64 * 1024
FLAGS = [flag.replace("-O3", "-O1") for flag in toolchain.FLAGS if "frame" not in flag]
FLOAT = [*FLAGS, "-DRHEC_FLOAT"]
CORTEX_M4 = "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16".split()
# What float may cost: little of pose, speed and command. The information on kappa is small on
# straights, so its equations are solved with fewer digits.
MOST = dict.fromkeys([name for name in LOG if name not in MEASUREMENTS], 1e-3) | {"kappa_hat": 2e-2}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    scenario = rhec.Scenario(duration_s=30.0, seed=1)
    return rhec.export(scenario, tmp_path_factory.mktemp("float") / "rhec")


def assert_close(answers, exported):
    expected = pd.read_csv(exported / "log.csv")
    assert len(answers) == len(expected) and (answers["status"] == 0).all()
    difference = (answers[[*MOST]] - expected[[*MOST]]).abs().max()
    assert (difference <= pd.Series(MOST)).all(), difference
    assert difference.max() > 1e-7  # it was float


@pytest.mark.parametrize("machine", [toolchain.this_machine, toolchain.arm])
def test_float_is_close_to_double(machine, exported, tmp_path):
    machine = machine()
    if machine is None:
        pytest.skip("there is no compiler for this machine, or no emulator")
    objects = toolchain.library(machine, exported, tmp_path, FLOAT)
    program = toolchain.program(machine, exported, "replay", objects, FLOAT)
    assert_close(toolchain.replay(machine, program, exported / "log.csv"), exported)
    assert toolchain.run(machine, program, exported / "log.csv").returncode == 0
    if not machine.emulator:
        program = toolchain.program(machine, exported, "fuzz", objects, FLOAT)
        came_back = toolchain.nonsense(machine, program, 10_000).iloc[0]
        assert came_back["still_lost"] < came_back["storms"]


def test_the_header_tells_the_size_of_the_memory(exported):
    if toolchain.this_machine() is None:
        pytest.skip("there is no C compiler")
    program = '#include "rhec.h"\nint here[sizeof(struct rhec) == RHEC_MEMORY_BYTES ? 1 : -1];\n'
    command = [toolchain.this_machine().compiler, f"-I{exported}", "-fsyntax-only", "-x", "c", "-"]
    for flags in ([], ["-DRHEC_FLOAT"]):
        subprocess.run([*command, *flags], input=program, text=True, check=True)
    sizes = re.findall(r"RHEC_MEMORY_BYTES (\d+)", (exported / "rhec_memory.h").read_text())
    assert np.isclose(int(sizes[1]) / int(sizes[0]), 0.5, atol=0.01)


def test_a_cortex_m4_with_64_kib_of_ram_drives(exported, tmp_path):
    """Bare metal on an emulated board; the linker gives RAM_BYTES to memory, stack and stdio."""
    tools = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")
    if not all(tools):
        pytest.skip("gcc-arm-none-eabi, libnewlib-arm-none-eabi or qemu-system-arm is missing")
    assert f"LENGTH = {RAM_BYTES // 1024}K" in (BOARD / "board.ld").read_text()
    sources = [BOARD / "startup.c", *(exported / name for name in (*toolchain.LIBRARY, "replay.c"))]
    command = [tools[0], "-std=c99", "-O1", "-ffp-contract=off", "-fsingle-precision-constant"]
    command += [*CORTEX_M4, "--specs=rdimon.specs", "-DRHEC_FLOAT", f"-I{exported}"]
    program = tmp_path / "replay.elf"
    subprocess.run([*command, "-T", BOARD / "board.ld", *sources, "-o", program, "-lm"], check=True)
    files = f"enable=on,target=native,arg=replay,arg={exported / 'log.csv'}"
    board = ["-M", "mps2-an386", "-display", "none", "-monitor", "none", "-serial", "none"]
    done = subprocess.run(
        [tools[1], *board, "-semihosting-config", files, "-kernel", program],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert_close(pd.read_csv(io.StringIO(done.stdout)), exported)
