"""What `pip install rhec` installs, and what each extra adds, in packages and megabytes.

    python -m docs.site.packages

It measures the environment that it runs in, and writes data/results/benchmark/packages.csv, from
which docs/systems.md has its table.
"""

import functools
from importlib import metadata

import pandas as pd
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from benchmark.tables import FOLDER

NAME = "rhec"
EXTRAS = ("", "plots", "logs", "campaigns", "all")


def closure(name, extra=""):
    """The names of all packages that a package needs, with one of its extras.

    Args:
        name: Of an installed package.
        extra: Of its extras; "" for none.

    Returns:
        Set of names, without the package itself.
    """
    found = set()  # of (package, one of its extras)

    def add_needs(package, with_extra):
        for text in metadata.requires(package) or ():
            wanted = Requirement(text)
            if wanted.marker and not wanted.marker.evaluate({"extra": with_extra}):
                continue
            for needed in ((canonicalize_name(wanted.name), each) for each in ("", *wanted.extras)):
                if needed not in found:
                    found.add(needed)
                    add_needs(*needed)

    add_needs(name, extra)
    return {package for package, _ in found} - {name}


@functools.cache  # most packages are needed by several extras
def megabytes(name):
    """The size [MB] of the files that an installed package has brought, without compiled bytes."""
    files = metadata.files(name) or ()
    places = (each.locate() for each in files if each.suffix != ".pyc")
    return sum(place.stat().st_size for place in places if place.is_file()) / 1e6


def measure():
    """Table by extra: packages and MB that it adds to what rhec alone needs."""
    base = closure(NAME)
    rows = []
    for extra in EXTRAS:
        needed = closure(NAME, extra) | base
        added = needed - base if extra else base
        rows.append(dict(extra=extra, packages=len(added), megabytes=sum(map(megabytes, added))))
    return pd.DataFrame(rows)


if __name__ == "__main__":
    table = measure()
    FOLDER.mkdir(parents=True, exist_ok=True)
    table.to_csv(FOLDER / "packages.csv", index=False, float_format="%.1f")
    print(table.to_string(index=False, float_format="{:.1f}".format))
