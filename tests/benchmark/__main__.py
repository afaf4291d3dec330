"""`python -m benchmark [part …]`: measure, print, and leave tables and pictures in figures/."""

import argparse

from benchmark import (
    acados_peer,
    any_robot,
    batches,
    drawings,
    growth,
    horizon,
    instructions,
    peers,
    processes,
    step,
    tails,
)
from notebooks.studies import timing
from rhec import style


def report(table, name, caption, drawing=None):
    """Print a table and save it, and its picture."""
    text = table.to_string(index=False, float_format="{:.4g}".format, na_rep="")
    print(f"\n{caption}\n{text.replace('<NA>', '    ')}", flush=True)
    style.save_table(
        table, f"bench_{name}", f"{caption}, on {timing.machine()}", notebook="benchmark"
    )
    if drawing:
        style.save(drawing(table), f"bench_{name}", notebook="benchmark")


def measure_step(_):
    if step.REFERENCE not in peers.PEERS:
        print(
            f"{step.REFERENCE} is not installed (make bench does that), "
            "so rhec is compared with Opti + IPOPT and FATROP only."
        )
    if not acados_peer.command():
        print("acados is missing: its wheel could not be installed, ACADOS_SOURCE_DIR is not set.")
    agreeing, table = step.measure()
    report(
        agreeing,
        "agreement",
        f"Difference from the optimum over {step.SAMPLES} problems "
        f"(peers must stay within {step.TOLERANCE:g})",
    )
    report(
        table,
        "step",
        "Time of one step in microseconds, quartiles over blocks that take turns, and instructions",
        drawings.step,
    )
    if not instructions.available():
        print("\nvalgrind is not installed, so no instructions were counted.")


def measure_any_robot(_):
    if not any_robot.do_mpc:
        print(
            "\ndo-mpc is not installed (make bench does that), so other robots were not measured."
        )
        return
    agreeing, table = any_robot.measure()
    report(
        agreeing,
        "any_robot_agreement",
        f"Other robots: largest difference from the optimum over {any_robot.SAMPLES} problems",
    )
    report(
        table,
        "any_robot",
        "Other robots: time of one step in microseconds, quartiles over blocks that take turns",
    )


def measure_batches(_):
    report(
        batches.measure(),
        "batches",
        f"CPU time of a sample in microseconds: {batches.RUNS} runs in a batch, single objects",
    )


def measure_horizon(_):
    report(
        horizon.measure(),
        "horizon",
        "Time of one step in microseconds by number of intervals",
        drawings.horizon,
    )


def measure_tails(arguments):
    report(
        tails.measure(arguments.steps),
        "tails",
        "Distribution of computation times in microseconds, called from Python",
    )


def measure_start(_):
    report(
        processes.starts(), "start", "Seconds from the beginning of import rhec in a fresh process"
    )


def measure_campaign(arguments):
    counts = [count for count in growth.RUNS if count <= arguments.runs]
    report(
        growth.by_runs(counts),
        "campaign",
        "Closed-loop samples per second and memory of campaigns, everything included",
        drawings.campaign,
    )
    report(
        growth.by_kind(),
        "campaign_kinds",
        "What a run of 1,200 samples costs in a campaign, by estimator, model and horizon",
        drawings.kinds,
    )


PARTS = dict(
    step=measure_step,
    any_robot=measure_any_robot,
    batches=measure_batches,
    horizon=measure_horizon,
    tails=measure_tails,
    start=measure_start,
    campaign=measure_campaign,
)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmark", description=__doc__)
    parser.add_argument(
        "parts",
        nargs="*",
        metavar="part",
        help=f"which to measure, of {', '.join(PARTS)}; all unless told",
    )
    parser.add_argument(
        "--steps",
        type=int,
        default=100_000,
        help="how many steps the worst case is the worst of (default: %(default)s)",
    )
    parser.add_argument(
        "--runs",
        type=int,
        default=1_000,
        help="of the largest campaign, at most 100,000 (default: %(default)s)",
    )
    arguments = parser.parse_args()
    if unknown := set(arguments.parts) - set(PARTS):
        parser.error(f"there is no part {unknown.pop()!r}; it should be one of {', '.join(PARTS)}")
    for part in arguments.parts or PARTS:
        PARTS[part](arguments)
