"""Folders of compiled code that outlast a process: found again, whole, and nobody else's.

What is loaded runs as whoever loads it, so it must lie where no one else can write. A folder is
made under a name of its own and moved into place in one step: makers may race or be killed.
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

__all__ = ["UnusableError", "holds", "kept", "say"]

_CONTENT = "content.json"  # {file: its digest} of the others in a folder
_POSIX = os.name == "posix"


class UnusableError(Exception):
    """A folder could not be made, or what is in it cannot be loaded."""


@functools.cache
def say(line):
    """Print a line to stderr, once in a process."""
    print(f"rhec: {line}", file=sys.stderr, flush=True)


def holds(name):
    """Return whether `kept` has nothing to make."""
    return any(_find(root, name) for root in _roots())


def kept(name, make, load):
    """Return load(folder) of the folder called `name`, filled by make(folder) if there is none.

    It is in the cache or, where that cannot be used, among temporary files, which is said once.

    Raises:
        UnusableError: in one sentence, if neither can be used.
    """
    reasons = []
    for root in _roots():
        try:
            _make_usable(root)
            loaded = load(_find(root, name) or _make(root, name, make))
        except (OSError, RuntimeError) as error:
            reasons.append(" ".join(str(error).split())[:300])
        else:
            if reasons:
                say(f"compiled code is kept in {root}, since {reasons[0]}")
            return loaded
    raise UnusableError(reasons[0])


def _user():
    return os.geteuid() if _POSIX else 0


def _roots():
    """Where folders may be, the best first."""
    cache = os.environ.get("RHEC_CACHE") or platformdirs.user_cache_path("rhec")
    temporary = Path(os.environ.get("TMPDIR", "/tmp") if _POSIX else tempfile.gettempdir())
    return Path(os.path.realpath(cache)), temporary.resolve() / f"rhec-{_user()}"


def _trusted():
    """The user ids in RHEC_TRUSTED_OWNERS: names or numbers of users with spaces between."""
    named = os.environ.get("RHEC_TRUSTED_OWNERS", "").split()
    try:
        import pwd

        return [int(name) if name.isdigit() else pwd.getpwnam(name).pw_uid for name in named]
    except (ImportError, KeyError):
        was = f"RHEC_TRUSTED_OWNERS was {' '.join(named)!r}"
        raise ValueError(f"{was}; it must be names or numbers of users of this machine") from None


def _make_usable(root):
    """Make the folder. Refuse one without exec, or where others could exchange what is in it.

    Others may make files of their own in it if its sticky bit keeps them from touching ours.
    """
    root.mkdir(mode=0o700, parents=True, exist_ok=True)
    for folder in (root, *root.parents):
        _refuse_others(folder, {_user(), 0, os.stat("/").st_uid, *_trusted()}, stat.S_ISVTX)
    if _POSIX and os.statvfs(root).f_flag & os.ST_NOEXEC:
        raise OSError(f"{root} is mounted noexec")


def _refuse_others(path, owners, sticky=0):
    """OSError for what others own or can write to; a link's mode says that all can."""
    status = os.lstat(path)
    writable = status.st_mode & 0o002 or status.st_mode & 0o020 and not _is_private_group(status)
    if _POSIX and status.st_uid not in owners:
        raise OSError(f"{path} belongs to another user ({status.st_uid})")
    if _POSIX and writable and not status.st_mode & sticky:
        raise OSError(f"others can write to {path}")


def _is_private_group(status):
    """Whether a file's group is its owner's alone, such as many systems give each user."""
    with contextlib.suppress(ImportError, KeyError):
        import grp
        import pwd

        owner = pwd.getpwuid(status.st_uid).pw_name
        group = grp.getgrgid(status.st_gid)
        return group.gr_name == owner and {owner}.issuperset(group.gr_mem)
    return False


def _find(root, name):
    """The folder of one's own, or of a trusted owner, if it is whole; else None."""
    for owner in (_user(), *_trusted()):
        folder = root / f"{name}-{owner}"
        with contextlib.suppress(OSError, ValueError, TypeError):
            content = {_CONTENT: None} | json.loads((folder / _CONTENT).read_text())
            for path in (folder, *(folder / file for file in content)):
                _refuse_others(path, {owner})
            if content == {_CONTENT: None} | _digests(folder, content):
                return folder
    return None


def _digests(folder, files):
    paths = (folder / file for file in files if file != _CONTENT)
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def _make(root, name, make):
    """The folder, filled by make(folder)."""
    folder = root / f"{name}-{_user()}"
    lock = root / f"building-{name}-{_user()}"
    with _locked(lock, os.O_RDWR | os.O_CREAT):
        try:
            return _find(root, name) or _make_alone(folder, make)
        finally:
            lock.unlink(missing_ok=True)


def _make_alone(folder, make):
    """The same; what a killed process left unfinished goes, and what was broken."""
    for left in folder.parent.glob("building-*"):
        with contextlib.suppress(ImportError, OSError), _locked(left, os.O_RDONLY, wait=False):
            shutil.rmtree(left) if left.is_dir() else left.unlink()
    with (
        tempfile.TemporaryDirectory(
            dir=folder.parent, prefix="building-", ignore_cleanup_errors=True
        ) as building,
        _locked(building, os.O_RDONLY),
    ):
        building = Path(building)
        make(building)
        content = json.dumps(_digests(building, os.listdir(building)))
        (building / _CONTENT).write_text(content)
        for file in building.iterdir():
            file.chmod(0o644)
        building.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        return building.rename(folder)


@contextlib.contextmanager
def _locked(path, flags, wait=True):
    """Be the only process that has this file or folder locked; a lock goes with its process.

    Where there are no locks, those who wait do not, and race, which costs time alone.
    """
    lock = os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o600)
    try:
        _refuse_others(path, {_user()})
        with contextlib.suppress((ImportError, OSError) if wait else ()):
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        os.close(lock)
