"""Soak test: one endless drive over ever-changing fields, with random sensor faults.

`python tests/soak.py` drives 2.3 days at 5 Hz.

The drive is scanned leg by leg, five minutes each: a leg has its own terrain, noise, tuning and
faults, a pure function of (seed, leg), and starts from the robot, the estimator and the controller
as the leg before left them.
"""

import argparse
import dataclasses
import json
import resource
import time

import numpy as np

from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi.build import select_inputs
from rhec.core.estimator.innovation_gate import patience
from rhec.simulation import closed_loop, faults
from rhec.simulation.columns import COLUMNS, COMMAND, ESTIMATE, TRUTH
from rhec.simulation.faults import Fault
from rhec.simulation.scenario import Scenario

LEG = 1500  # samples
CHECK = 500  # samples between two looks at the arrival covariance
FAILURES = "not_finite", "out_of_bounds", "not_definite", "stuck"
COUNTS = "done", *FAILURES, "not_ok", "outside"


def random_fault(rng, duration_s):
    """Any kind of fault, anywhere in a leg, for up to 30 s."""
    kind = str(rng.choice(faults.KINDS))
    channels = faults.OWN_CHANNELS.get(kind, tuple(faults.CHANNELS))
    sizes = dict(
        size_m=10 ** rng.uniform(-0.5, 3),
        delay_s=rng.uniform(0, faults.DELAY_MAX_S),
        rate_hz=rng.uniform(0.2, 4),
    )
    size = {faults.SIZES[kind]: float(sizes[faults.SIZES[kind]])} if kind in faults.SIZES else {}
    return Fault(
        kind=kind,
        channel=str(rng.choice(channels)),
        start_s=rng.uniform(0, duration_s),
        duration_s=rng.uniform(0, 30),
        **size,
    )


def leg(base, seed, number):
    """The scenario of a leg: what does not change the shape of the loop is drawn anew; one leg in
    four has no faults.
    """
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, 3, number))))
    duration_s = LEG * paper.DT_S
    mu, kappa = rng.uniform(0.4, 0.95, 2)
    spread = rng.uniform(0, 0.5, 2) * np.sqrt([mu * (1 - mu), kappa * (1 - kappa)])
    box_m = (base.row_length_m, 2 * base.headland_radius_m)
    patches = tuple(
        (*rng.uniform(0, box_m), rng.uniform(0.5, 5), *rng.uniform(0.05, 1, 2))
        for _ in range(rng.integers(3))
    )
    return dataclasses.replace(
        base,
        seed=int(rng.integers(2**31)),
        duration_s=duration_s,
        process_noise=str(rng.choice(["printed", "prediction"])),
        q=tuple(rng.uniform(0.1, 3, 3)),
        r=rng.uniform(1, 20),
        qn_factor=rng.uniform(1, 10),
        omega_max_radps=rng.uniform(0.05, 0.3),
        look_ahead_m=rng.uniform(0, 0.5),
        command_delay=int(rng.integers(2)),
        speed_mps=rng.uniform(0.1, 1.2),
        mu_mean=mu,
        kappa_mean=kappa,
        mu_deviation=spread[0],
        kappa_deviation=spread[1],
        correlation_length_m=rng.uniform(1, 8),
        patches=patches,
        gnss_sigma_m=rng.uniform(0, 0.1),
        gnss_slow_share=rng.uniform(0, 1),
        encoder_sigma_mps=rng.uniform(0, 0.05),
        speed_sigma_mps=rng.uniform(0, 0.1),
        bump_sigma_radps=rng.uniform(0, 0.1),
        faults=tuple(random_fault(rng, duration_s) for _ in range(rng.choice([0, 1, 2, 4])))
        or (Fault(kind="missing", duration_s=0.0),),
    )


def lowest_eigenvalue(P):
    """Lowest eigenvalue of P scaled to a unit diagonal; -Inf if P is not finite, not symmetric to
    the last bit, or has a variance that is not above 0.
    """
    if not (np.isfinite(P).all() and np.array_equal(P, P.T) and np.all(np.diag(P) > 0)):
        return -np.inf
    scale = np.sqrt(np.diag(P))
    return np.linalg.eigvalsh(P / scale / scale[:, None])[0]


def counted(scenario, setup, rows, memory):
    """Failures in these samples and in the arrival covariance after them, and the lowest eigenvalue
    of that.
    """
    log = dict(zip(COLUMNS, rows.T))
    finite = np.isfinite([log[name] for name in (*TRUTH, *ESTIMATE, *COMMAND)])
    traction = np.stack([log["mu_hat"], log["kappa_hat"]])
    out_of_bounds = ((traction < 0) | (traction > 1)).any(axis=0)
    out_of_bounds |= np.abs(log["omega_cmd_radps"]) > scenario.omega_max_radps
    lowest = lowest_eigenvalue(setup.unpack(memory)["estimator"]["P"])
    distance_m, _ = setup.path.project(np.column_stack([log["x_m"], log["y_m"]]))
    not_ok = log["ok"] != 1
    longest = patience(scenario.estimation_horizon)
    recent = np.convolve(not_ok, np.ones(longest + 1))  # how many of the last longest + 1
    counts = dict(
        done=len(rows),
        not_finite=int((~finite).any(axis=0).sum()),
        out_of_bounds=int(out_of_bounds.sum()),
        not_definite=int(not lowest > 0),
        stuck=int((recent > longest).sum()),
        not_ok=int(not_ok.sum()),
        outside=int((distance_m > paper.TOLERANCE_M).sum()),
    )
    return counts, lowest


def run_on(step, memory, stream, settings):
    """The memory after the samples of a stream, and their rows: the loop, one call a sample."""
    call = compiled.BufferedFunction(step)
    call.set(**select_inputs(step, settings))
    memory_in, stream_in, *_ = step.name_in()
    memory_out, row_out, *_ = step.name_out()
    rows = []
    for sample in stream:
        call.set(**{memory_in: memory, stream_in: sample})
        call.call()
        memory = call.results[memory_out].copy()
        rows.append(call.results[row_out].copy())
    return memory, np.array(rows)


def drive(base, seed, legs):
    """Drive so many legs; yield after each the counts and the lowest eigenvalue so far."""
    found, lowest = dict.fromkeys(COUNTS, 0), np.inf
    memory = closed_loop.set_up(leg(base, seed, 0)).memory
    for number in range(legs):
        scenario = leg(base, seed, number)
        setup = closed_loop.set_up(scenario)
        functions = compiled.load(closed_loop.build_sample, *setup.structure)
        stream = closed_loop.noise_and_faults(scenario.seed, scenario.faults, LEG, setup.draws)
        for piece in np.split(stream, LEG // CHECK):
            memory, rows = run_on(functions["step"], memory, piece, setup.settings)
            counts, eigenvalue = counted(scenario, setup, rows, memory)
            found |= {name: found[name] + count for name, count in counts.items()}
            lowest = min(lowest, float(eigenvalue))
        yield found, lowest


def resident_mb():
    """The most memory this process ever had [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--legs", type=int, default=667, help="of five minutes: 667 are 2.3 days")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.legs < 1:
        parser.error(f"--legs was {options.legs}; it should be at least 1")
    began, memory_mb = time.monotonic(), []
    for found, lowest in drive(Scenario(), options.seed, options.legs):
        memory_mb.append(resident_mb())
        if len(memory_mb) % 30 == 0:
            print(f"{found['done']:>12,} samples, memory {memory_mb[-1]:.1f} MB", flush=True)
    seconds = time.monotonic() - began
    report = found | dict(lowest_eigenvalue=lowest, seconds=round(seconds, 1))
    report |= dict(samples_per_s=round(found["done"] / seconds))
    report |= dict(
        memory_mb_at_one_tenth=memory_mb[len(memory_mb) // 10], memory_mb_at_the_end=memory_mb[-1]
    )
    print(json.dumps(report, indent=1))
    raise SystemExit(any(found[name] for name in FAILURES))


if __name__ == "__main__":
    main()
