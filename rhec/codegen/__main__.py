"""`make embedded`: the default scenario as C in build/embedded, and what it needs."""

from rhec import Scenario, export
from rhec.studies.embedded import report


def main():
    folder = export(Scenario())
    made = report.measure(folder)
    for name in ("sizes", "nonsense", "counted"):
        made[name].to_csv(folder / f"{name}.csv", index=False)
        if not made[name].empty:
            print(made[name].to_string(index=False), end="\n\n")
    if (
        not made["sizes"].empty
        and not (made["sizes"]["largest_difference"] <= report.TOLERANCE).all()
    ):
        raise SystemExit(
            f"embedded: the answers differ from Python's by more than {report.TOLERANCE:g}"
        )
    print(f"embedded: {folder}; its README.txt says how to go on")


if __name__ == "__main__":
    main()
