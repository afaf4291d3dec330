"""`python -m rhec`: the command `rhec`."""

import sys

from rhec.cli import main

if __name__ == "__main__":
    sys.exit(main())
