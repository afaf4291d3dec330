"""Fuzz the exported C of a scenario and of a Model with sanitizers (`python tests/fuzz`).

python tests/fuzz [--runs N] [--seed S]

With a Clang that has libFuzzer, coverage guides the inputs, and those that reach new code are kept
in build/fuzz. Without it, N inputs are random mutations of the stored corpus.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import casadi as ca

import rhec
from notebooks.studies import toolchain

HERE = Path(__file__).parent
CORPUS = HERE / "corpus"
FOUND = HERE.parents[1] / "build/fuzz"
SANITIZERS = "address,undefined,float-cast-overflow"
FLAGS = ["-std=c99", "-O0", "-g1", f"-fsanitize={SANITIZERS}", "-fno-sanitize-recover=all"]


def bicycle():
    """The estimator and the controller of a Model with a parameter."""
    model = rhec.Model(
        states=("x_m", "y_m", "theta_rad"),
        inputs=("speed_mps", "steering_rad"),
        parameters={"offset_rad": (-0.2, 0.2)},
        outputs=("x_m", "y_m", "speed_mps", "steering_rad"),
        f=lambda x, u, p: ca.vertcat(
            u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[0] * ca.tan(u[1] + p[0])
        ),
    )
    estimator = rhec.RHE(
        model=model,
        dt=0.2,
        horizon=4,
        sigma_v=(0.03, 0.03, 0.05, 0.02),
        sigma_w=(0.01, 0.01, 0.01, 0.001),
        guess=(0.0, 0.0, 0.0, 0.0),
        sigma_guess=(1.0, 1.0, 1.0, 0.1),
    )
    controller = rhec.RHC(
        model=model,
        dt=0.2,
        horizon=4,
        q=(1.0, 1.0, 1.0),
        r=(1.0, 1.0),
        command=("speed_mps", "steering_rad"),
        bounds={"speed_mps": (0.0, 1.0), "steering_rad": (-0.5, 0.5)},
    )
    return estimator, controller


EXPORTS = {"scenario": lambda: rhec.Scenario(), "model": bicycle}


def build(folder, libfuzzer=False):
    """Compile the fuzzer of an export.

    Args:
        folder: Of the export.
        libfuzzer: Whether libFuzzer chooses the inputs.

    Returns:
        Path of the program, or None if no compiler has the sanitizers.
    """
    program = folder / ("libfuzzer" if libfuzzer else "exported")
    sources = [HERE / "exported.c", *(folder / name for name in toolchain.LIBRARY)]
    extra = ["-fsanitize=fuzzer", "-DLIBFUZZER"] if libfuzzer else []
    for compiler in filter(None, map(shutil.which, ("clang", "gcc", "cc"))):
        command = [compiler, *FLAGS, *extra, f"-I{folder}", *sources, "-o", program, "-lm"]
        if not subprocess.run(command, capture_output=True).returncode:
            return program
    return None


def corpus():
    """Paths of the stored inputs."""
    return sorted(CORPUS.glob("*.bin"))


def fuzz(name, folder, runs, seed):
    """Fuzz one of EXPORTS; a finding is printed and ends the program.

    Returns:
        What was run, in words.
    """
    rhec.export(EXPORTS[name](), folder)
    program = build(folder, libfuzzer=True)
    if program:
        found = FOUND / name
        found.mkdir(parents=True, exist_ok=True)
        command = [program, f"-runs={runs}", f"-seed={seed}", "-max_len=2048", found, CORPUS]
        kind = "inputs guided by coverage"
    else:
        program = build(folder)
        if not program:
            sys.exit("no compiler here has the sanitizers")
        command = [program, str(runs), str(seed), *corpus()]
        kind = "mutations of the corpus"
    if subprocess.run(command).returncode:
        sys.exit(f"{name}: {' '.join(map(str, command))} found something")
    return f"{name}: {runs} {kind}, nothing found"


def main():
    """Read the command line and fuzz each export."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in EXPORTS:
        with tempfile.TemporaryDirectory() as folder:
            print(fuzz(name, Path(folder) / "c", options.runs, options.seed), flush=True)


if __name__ == "__main__":
    main()
