"""Export the default scenario to build/embedded: python -m notebooks.further.c_code.

Prints the size of the code and its estimated times, and fails if its answers differ from Python's.
"""

from notebooks.further.c_code import report
from rhec.embedded import export
from rhec.simulation.scenario import Scenario


def main():
    """Export the default scenario, measure the export, and fail if its answers differ."""
    folder = export(Scenario()).resolve()  # the compiler runs in another folder
    tables = report.measure(folder)
    for name in ("sizes", "nonsense", "counted"):
        tables[name].to_csv(folder / f"{name}.csv", index=False)
        if not tables[name].empty:
            print(tables[name].to_string(index=False), end="\n\n")
    sizes = tables["sizes"]
    if not sizes.empty and not (sizes["largest_difference"] <= report.TOLERANCE).all():
        raise SystemExit(
            f"embedded: the answers differ from Python's by more than {report.TOLERANCE:g}"
        )
    print(f"embedded: {folder}; its README.txt says how to go on")


if __name__ == "__main__":
    main()
