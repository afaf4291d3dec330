"""Files that are whole, or not there, whoever else writes to the same folder."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

UNFINISHED = ".unfinished-"  # begins the name of a file that a killed process may leave


@contextlib.contextmanager
def replacing(file: str | Path) -> Iterator[BinaryIO]:
    """A context with a new binary file, which replaces `file` once it is written.

    Until then it has a name that nobody can guess, in the same folder, because a file cannot be
    renamed across file systems. Several processes may write one file: each of its versions is
    whole. What is written goes through no link, because the new file is created here, by mode "x",
    and never opened by its name again.

    Args:
        file: Path of the file.

    Raises:
        OSError: If it cannot be written; the message names `file`, which stays as it was.
    """
    file = Path(file)
    unfinished = file.with_name(f"{UNFINISHED}{secrets.token_hex(8)}")
    try:
        with open(unfinished, "xb") as content:
            yield content
        unfinished.replace(file)
    except OSError as error:
        if error.filename not in (None, str(unfinished)):
            raise
        # A full disk is told by writing, which knows of no name.
        if error.errno is None:
            raise OSError(f"{error}: {str(file)!r}") from error
        raise OSError(error.errno, error.strerror, str(file)) from error
    finally:
        with contextlib.suppress(OSError):
            os.unlink(unfinished)
