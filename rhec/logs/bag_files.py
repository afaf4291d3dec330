"""The files of a bag, opened by rosbags so that a hostile one does not fill the memory."""

import bz2
import re
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

SUFFIXES = (".bag", ".db3", ".mcap")
_LARGEST_CHUNK = 2**26  # [bytes]; recorders write chunks of about a megabyte
_OF_URI = {*"#?%"}  # letters that end a path in a URI, or stand for others
_ZSTD = b"\x28\xb5\x2f\xfd"  # the first bytes of what zstd has packed; no message begins so
# A table or index of plain columns. Views, triggers and computed columns would run SQL of the file.
_PLAIN = re.compile(r"CREATE (TABLE|(UNIQUE )?INDEX) [^()]*\([^()]*\)\s*")


def files_of(path: Path) -> list[Path]:
    """The files with the messages of a bag, which is a file or a folder."""
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.suffix in SUFFIXES)
    return [path]


def _unpacker(make):
    """A function that unpacks a part of a bag.

    Args:
        make: Makes a decompressor as that of the module bz2.
    """

    def unpack(packed, *_):
        part = make().decompress(packed, max_length=_LARGEST_CHUNK + 1)
        if len(part) > _LARGEST_CHUNK:
            raise ValueError("its parts unpack to far more than those of a recording")
        return part

    return unpack


def _refuse_sql(file):
    """Raise a ValueError for an SQLite file that would run SQL of its own when it is read."""
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
        for name, sql in database.execute("SELECT name, sql FROM sqlite_master"):
            if sql is not None and not _PLAIN.fullmatch(sql):
                raise ValueError(f"{name!r} in it is no plain table, and a bag has nothing else")


@contextmanager
def _plainly_named(files):
    """A context with files whose paths have no letter that means something in a URI.

    rosbags opens an SQLite file by a URI that it does not quote: of `log #3/a.db3` it would open
    `log `. Links in a private folder stand for such files.
    """
    with ExitStack() as stack:
        plain = []
        for file in files:
            if _OF_URI & {*str(file)}:
                folder = stack.enter_context(TemporaryDirectory())
                if _OF_URI & {*folder}:
                    raise ValueError(
                        f"the folder for temporary files is {folder!r}; TMPDIR should name one "
                        "without #, ? and %"
                    )
                link = Path(folder, f"bag{file.suffix}")
                link.symlink_to(file.absolute())
                file = link
            plain.append(file)
        yield plain


@contextmanager
def opened(files: list[Path]) -> Iterator[Any]:
    """A context with the rosbags AnyReader of files that are one recording.

    The metadata.yaml beside them is not read: the files have all of it.

    Args:
        files: The files, of one kind.

    Raises:
        ValueError: For a file that would run SQL of its own, or that unpacks to too much; or, if
            rosbags is not installed.
    """
    try:
        from lz4.frame import LZ4FrameDecompressor
        from rosbags.highlevel import AnyReader
        from rosbags.rosbag1 import reader
        from rosbags.rosbag2 import storage_mcap
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise ValueError("a bag needs the package rosbags: pip install 'rhec[logs]'") from None
    # rosbags has no limits of its own.
    by_lz4 = _unpacker(LZ4FrameDecompressor)
    reader.decompressors |= dict(lz4=by_lz4, bz2=_unpacker(bz2.BZ2Decompressor))
    by_zstd = _unpacker(storage_mcap.zstd.ZstdDecompressor)
    storage_mcap.DECOMPRESSORS |= dict(lz4=by_lz4, zstd=by_zstd)
    with _plainly_named(files) as plain:
        for file in plain:
            if file.suffix == ".db3":
                _refuse_sql(file)
        with AnyReader(plain, default_typestore=get_typestore(Stores.LATEST)) as bag:
            yield bag


def messages(bag: Any, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
    """(topic, time of reception [ns], message) of each message of these topics.

    Args:
        bag: As of `opened`.
        topics: Their names.

    Raises:
        ValueError: For a type whose definition is not in the bag.
    """
    chosen = [each for each in bag.connections if each.topic in topics]
    for each in chosen:
        if each.msgtype not in bag.typestore.fielddefs:
            raise ValueError(
                f"{each.topic} has messages of type {each.msgtype}, whose definition is not in "
                "the bag; an .mcap, or a bag by ROS 2 Iron or later, has the definitions"
            )
    from rosbags.rosbag2 import storage_mcap  # only some have it

    # No topics would be all topics.
    for connection, received_ns, raw in bag.messages(chosen) if chosen else ():
        if raw[:4] == _ZSTD:  # `ros2 bag record --compression-mode message`
            raw = storage_mcap.DECOMPRESSORS["zstd"](raw)
        yield connection.topic, received_ns, bag.deserialize(raw, connection.msgtype)
