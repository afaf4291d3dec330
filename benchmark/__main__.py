"""`python -m benchmark`: measure, print, and leave tables in figures/."""

from benchmark import acados_peer, instructions, peers, step
from notebooks.studies import timing
from rhec import style


def report(table, name, caption):
    """Print a table and save it."""
    text = table.to_string(index=False, float_format="{:.4g}".format, na_rep="")
    print(f"\n{caption}\n{text.replace('<NA>', '    ')}", flush=True)
    style.save_table(
        table, f"bench_{name}", f"{caption}, on {timing.machine()}", notebook="benchmark"
    )


def say_what_is_missing():
    """A line for each contestant, or means of counting, that is not installed."""
    if step.REFERENCE not in peers.PEERS:
        print(f"{step.REFERENCE} is not installed (make bench does that), so it is left out.")
    if not acados_peer.command():
        print("acados is missing: its wheel could not be installed, ACADOS_SOURCE_DIR is not set.")
    if not instructions.available():
        print("valgrind is not installed, so no instructions are counted.")


if __name__ == "__main__":
    say_what_is_missing()
    agreeing, times = step.measure()
    report(
        agreeing,
        "agreement",
        f"Difference from the optimum over {step.SAMPLES} problems "
        f"(peers must stay within {step.TOLERANCE:g})",
    )
    report(
        times,
        "step",
        "Time of one step in microseconds, quartiles over blocks that take turns, and instructions",
    )
