"""The command line: which command is named, and what its errors become."""

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial

from rhec import __version__
from rhec.workbench.command_line.commands import COMMANDS

__all__ = ["main", "parser_of"]

_ABOUT = """Receding horizon estimation and control of a tracked field robot with unknown traction,
and of any robot."""


def parser_of(named: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """The parser of `rhec`.

    Args:
        named: Commands that get their options. The options of a command import what it needs,
            which takes time. By default all commands get them.

    Returns:
        An argparse.ArgumentParser.
    """
    parser = argparse.ArgumentParser("rhec", description=_ABOUT, allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"rhec {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        own = commands.add_parser(
            name,
            help=command.text,
            description=command.text,
            usage=f"rhec {name} {command.usage}",
            allow_abbrev=False,
        )
        if named is None or name in named:
            command.add_options(own)
    return parser


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        words: Its words after `rhec`; those of the process, by default.

    Returns:
        The exit code.
    """
    words = sys.argv[1:] if words is None else list(words)
    named = words[:1] if words[:1] != ["completion"] else None
    parser = parser_of(named)
    given = parser.parse_args(words)
    with warnings.catch_warnings():
        # A warning is a sentence for the user, who has no use for its place in the source.
        warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
        if given.command == "completion":
            return _run(partial(_print_completion, parser), given)
        return _run(COMMANDS[given.command].run, given)


def _run(run, given):
    """The exit code of a command; its errors become one line."""
    try:
        return run(given) or 0
    except ValueError as error:
        return _said(error, 2)
    except BrokenPipeError:
        # What reads the output has ended, as in `rhec … | head`; nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ImportError, OSError, RuntimeError) as error:
        return _said(error, 1)
    except MemoryError as error:
        return _said(f"there was not enough memory {error}".rstrip(), 1)
    except KeyboardInterrupt as error:
        return _said(error.args[0] if error.args else "interrupted", 130)


def _said(error, code):
    print(f"rhec: {error}", file=sys.stderr)
    return code


def _print_completion(parser, given):
    """Print the completion script of a shell."""
    import shtab  # only this command needs it

    print(shtab.complete(parser, shell=given.shell), flush=True)
