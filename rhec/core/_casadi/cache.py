"""Compiled code that outlasts a process, one folder for each library, in a private folder.

Loaded code runs with the rights of whoever loads it, so the private folder belongs to the user and
nobody else can write to it. A library's folder is filled under a temporary name and then renamed:
processes may build at the same time, or be killed, and no half-made folder is ever found.
"""

import contextlib
import functools
import hashlib
import json
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path

import platformdirs

with contextlib.suppress(ImportError):  # on Windows nothing is compiled, see `compiler`
    import fcntl

_CONTENT = "content.json"  # {file: its digest}, written last, of all other files in a folder


class UnusableError(Exception):
    """A folder could not be made, or its content could not be loaded."""


@functools.cache
def warn_once(line):
    """Print a line to stderr, once in a process."""
    print(f"rhec: {line}", file=sys.stderr, flush=True)


def contains(name):
    """Return whether `load_or_build` has nothing to build."""
    return any(_is_private(root) and _is_whole(root / name) for root in _roots())


def load_or_build(name, build, load):
    """Return load(folder) of the folder called `name`, filled by build(folder) if it is missing.

    The folder is in the user's cache. Where that cannot be used, it is among the temporary files,
    and one line on stderr says so. If neither can be used, UnusableError is raised.
    """
    reasons = []
    for root in _roots():
        try:
            root.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not _is_private(root):
                raise OSError(f"{root} belongs to another user or others can write to it")
            if not _is_whole(root / name):
                _build(root, name, build)
            loaded = _load_or_remove(root, name, load)
        except (OSError, RuntimeError) as error:
            reasons.append(" ".join(str(error).split())[:300])
        else:
            if reasons:
                warn_once(f"compiled code is kept in {root}, since {reasons[0]}")
            return loaded
    raise UnusableError(reasons[0])


def _load_or_remove(root, name, load):
    """Return load(folder); a folder that cannot be loaded goes, so that it is built again."""
    try:
        return load(root / name)
    except (OSError, RuntimeError):
        with contextlib.suppress(OSError), locked(root / f"building-{name}.lock"):
            shutil.rmtree(root / name)
        raise


def _roots():
    """The private folders that may be used, the preferred one first."""
    cache = os.environ.get("RHEC_CACHE") or platformdirs.user_cache_path("rhec")
    temporary = Path(os.environ.get("TMPDIR") or tempfile.gettempdir())
    return Path(os.path.realpath(cache)), temporary.resolve() / f"rhec-{os.geteuid()}"


def _is_private(root):
    """Whether the folder exists, is the user's own, and nobody else can write to it."""
    with contextlib.suppress(OSError):
        status = os.lstat(root)  # not of what a link leads to: its owner chose that
        others_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        return status.st_uid == os.geteuid() and not others_write
    return False


def _is_whole(folder):
    """Whether the folder has all its files as they were built; a full disk may have cut one."""
    with contextlib.suppress(OSError, ValueError):
        return json.loads((folder / _CONTENT).read_text()) == _digests(folder)
    return False


def _digests(folder):
    files = (path for path in folder.iterdir() if path.name != _CONTENT)
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _build(root, name, build):
    """Fill the folder, unless another process does so meanwhile."""
    folder = root / name
    with locked(root / f"building-{name}.lock"):
        if _is_whole(folder):
            return
        for unfinished in root.glob(f"building-{name}-*"):  # by a process that was killed
            shutil.rmtree(unfinished)
        building = Path(tempfile.mkdtemp(dir=root, prefix=f"building-{name}-"))
        try:
            build(building)
            (building / _CONTENT).write_text(json.dumps(_digests(building)))
            if folder.exists():  # broken
                shutil.rmtree(folder)
            building.rename(folder)
        finally:
            shutil.rmtree(building, ignore_errors=True)


@contextlib.contextmanager
def locked(path):
    """Be the only process that holds the lock of this file; the lock ends with its process."""
    while True:
        with path.open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not os.fstat(lock.fileno()).st_nlink:  # its previous holder removed the file
                continue
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
            return
