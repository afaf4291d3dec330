"""`make embedded`: the default scenario, robust, as C in build/embedded, its size and times."""

from notebooks.embedded_measurements import report
from rhec import Scenario, export

__all__ = ["main"]


def main():
    """Export the default scenario, measure the export, fail if its answers differ."""
    folder = export(Scenario(robust=True)).resolve()  # the compiler runs elsewhere
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
