"""The C of the live page: CasADi's and what drives it, noise and soil with their tables.

What the page reads and writes are arrays whose names begin with `at_`.
"""

from pathlib import Path

import numpy as np

from rhec.core._casadi.build import packed_size
from rhec.core._casadi.c_text import generate_c
from rhec.simulation import closed_loop, faults
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import plant, terrain

__all__ = ["CELL_M", "MOST", "SEEDS", "SOILS", "loop_text", "world_text"]

_HERE = Path(__file__).parent
SEEDS = range(10)
MOST = 1200  # samples of a run
# of a start beside the path; around it; of a cell
_FARTHEST_M = 3.0
_MARGIN_M = 5.0
CELL_M = 0.5
_PATCHES = 100
SOILS = {
    "firm": {},
    "soft": dict(mu_mean=0.8, mu_deviation=0.08, kappa_mean=0.65, kappa_deviation=0.12),
    "even": dict(mu_deviation=0.0, kappa_deviation=0.0),
}


def loop_text(functions, s_place):
    """The C of build_live's Functions and of a whole run; s_place: of s in the loop's memory."""
    f = functions
    lengths = {}
    given = {}
    for of, function in f.items():
        inputs = {name: function.nnz_in(name) for name in function.name_in()}
        (given if of == "start" else lengths).update(inputs)
        lengths |= {name: function.nnz_out(name) for name in function.name_out()}
    logs = ("memory", "noise", "row", "covariance", "tally")
    one = {name: lengths[name] for name in logs}  # sample
    lengths |= {name: length * (MOST + 1) for name, length in one.items()}
    lengths |= dict(errors=2 * MOST, tally=2 * one["tally"])
    lines = [f"enum {{ {name.upper()} = {length} }};" for name, length in one.items()]
    lines.append(f"enum {{ S = {s_place} }};")
    for name, length in (lengths | {f"given_{name}": n for name, n in given.items()}).items():
        lines.append(f"double at_{name}[{length}];")
    for of, function in f.items():
        inputs = [f"at_{'given_' * (of == 'start')}{name}" for name in function.name_in()]
        outputs = [f"at_{name}" for name in function.name_out()]
        lines.append(f"static const double *{of}_arg[{function.sz_arg()}] = {_braces(inputs)};")
        lines.append(f"static double *{of}_res[{function.sz_res()}] = {_braces(outputs)};")
    n_iw, n_w = (max(sizes) for sizes in zip(*((of.sz_iw(), of.sz_w()) for of in f.values())))
    lines.append(f"static long long iw[{n_iw + 1}];\nstatic double w[{n_w + 1}];\n")
    return generate_c([*f.values()], "code.c") + "\n".join(lines) + _read("loop.c")


def world_text():
    """The C of noise and soil, with their tables."""
    start = Scenario()
    setup = closed_loop.set_up(start)
    points = setup.path.poses(np.arange(0, setup.path.length_m, 0.5))[0][:, :2]
    farthest = np.ptp(points, axis=0) + 2 * (_MARGIN_M + _FARTHEST_M)
    n = np.ceil(farthest / CELL_M).astype(int) + 1
    windows = [
        terrain.gaussian_fields(seed, *n, CELL_M, start.correlation_length_m) for seed in SEEDS
    ]
    keys = [
        [np.random.SeedSequence((seed, stream)).generate_state(2, np.uint64) for stream in (1, 4)]
        for seed in SEEDS
    ]
    soils = [
        [_traction(vars(start) | own, name) for name in ("mu", "kappa")] for own in SOILS.values()
    ]
    wide, long = setup.structure.terrain_shape
    noise = packed_size(plant.NOISE)
    fault = packed_size(faults.STREAM)
    constants = dict(
        NOISE=noise,
        MOST=MOST,
        QUANTILES=len(terrain.QUANTILES),
        LOWEST=terrain.LOWEST,
        MARGIN_M=_MARGIN_M,
        CELL_M=CELL_M,
        WIDE=wide,
        LONG=long,
    )
    tables = _ziggurat() | dict(
        quantiles=terrain.QUANTILES,
        soils=soils,
        keys=keys,
        lowest=points.min(axis=0),
        highest=points.max(axis=0),
    )
    arrays = dict(stream=MOST * (noise + fault), slip=2 * wide * long, patches=5 * _PATCHES)
    lines = [f"#define {name} {value}" for name, value in constants.items()]
    lines += [f"double at_{name}[{n}];" for name, n in (arrays | dict(origin_m=2)).items()]
    lines += ["int at_n[2];", *(_table(name, np.array(table)) for name, table in tables.items())]
    # Cells are the standard fields' own, numbers of 16 bits.
    lines.append(_table("windows", np.array(windows), "float"))
    return "\n".join(lines) + "\n" + _read("world.c")


def _read(file):
    return (_HERE / file).read_text(encoding="utf-8")


def _traction(of, name):
    """The traction at each quantile of the Gaussian field."""
    mean = of[f"{name}_mean"]
    deviation = of[f"{name}_deviation"]
    if not deviation:
        return np.full(len(terrain.QUANTILES), mean)
    return terrain.beta_quantiles(mean, deviation)


def _table(name, values, kind="double"):
    kind = "unsigned long long" if values.dtype == np.uint64 else kind
    shape = "".join(f"[{n}]" for n in values.shape)
    return f"static const {kind} {name}{shape} = {_braces(values)};"


def _braces(values):
    """Nested values as C has them."""
    if isinstance(values, str):
        return values
    if isinstance(values, np.uint64):
        return f"{values}ull"
    if isinstance(values, float):
        return float(values).hex()
    return f"{{{', '.join(map(_braces, values))}}}"


def _ziggurat():
    """The ziggurat's tables, as NumPy's own generator shows them."""
    bits = np.random.Philox(0)
    state = bits.state
    generator = np.random.Generator(bits)

    def drawn(layer, size):
        """The number made of these random bits, and whether it was accepted at once."""
        # What follows is accepted beyond the last layer.
        state["buffer"] = np.array([layer | size << 9, 1 << 40, 1 << 60, 0], dtype=np.uint64)
        bits.state = state | dict(buffer_pos=0)
        return generator.standard_normal(), bits.state["buffer_pos"] == 1

    width = np.array([drawn(layer, 1)[0] for layer in range(256)])
    inner = []
    for layer in range(256):
        low = 0
        high = 1 << 52
        while low < high:
            middle = (low + high) // 2
            low, high = (middle + 1, high) if drawn(layer, middle)[1] else (low, middle)
        inner.append(low)
    height = np.exp(-0.5 * np.square(width * 2.0**52))
    height[0] = 1.0
    return dict(width=width, inner=np.array(inner, dtype=np.uint64), height=height)
