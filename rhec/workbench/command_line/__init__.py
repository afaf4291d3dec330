"""The command `rhec`: the functions of the package from a shell.

Its help is made of the texts that `help()` shows, so each text stands once. A mistake in an
argument gives one sentence and exit code 2, a failure of the system one sentence and 1, Ctrl-C one
line and 130; `rhec doctor` returns 1 where it found something.
"""

from rhec.workbench.command_line.parser import main

__all__ = ["main"]
