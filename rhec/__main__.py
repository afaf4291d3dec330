"""`python -m rhec`: the command `rhec`."""

import sys

from rhec.workbench.command_line import main

if __name__ == "__main__":
    sys.exit(main())
