"""The files of a bag, opened so that a hostile one can neither fill the memory nor never end."""

import bz2
import re
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

SUFFIXES = (".bag", ".db3", ".mcap")
# What a bag may unpack to: compressed sensor data shrink to a tenth at best, zeros to a millionth.
_MOST_RATIO = 100
_LEAST_LIMIT = 2**26  # [bytes] for small bags, most of which is the definitions of their types
_LARGEST_CHUNK = 2**28  # [bytes]; recorders write chunks of about a megabyte
_ZSTD = b"\x28\xb5\x2f\xfd"  # the first bytes of what zstd has packed; no message begins so
# A table or index of plain columns. Views, triggers and computed columns would run SQL of the file.
_PLAIN = re.compile(r"CREATE (TABLE|(UNIQUE )?INDEX) [^()]*\([^()]*\)\s*")
_one_at_a_time = threading.Lock()


def files_of(path: Path) -> list[Path]:
    """The files with the messages of a bag, which is a file or a folder."""
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.suffix in SUFFIXES)
    return [path]


class _Unpacker:
    """Unpacks the parts of a bag, up to a total size.

    Args:
        size: The size of the bag's files [bytes].
    """

    def __init__(self, size):
        self._left = max(_LEAST_LIMIT, _MOST_RATIO * size)
        self._left_of_index = size

    def unpack(self, make: Callable, packed: bytes, *_: Any) -> bytes:
        """The content of a part.

        Args:
            make: Makes a decompressor as that of the module bz2.
            packed: The part.

        Raises:
            ValueError: If it is larger than what is left.
        """
        most = min(self._left, _LARGEST_CHUNK)
        return self.count(make().decompress(packed, max_length=most + 1))

    def count(self, part: bytes, *_: Any) -> bytes:
        """A part that is not packed, and may be read again and again."""
        self._left -= len(part)
        if self._left < 0 or len(part) > _LARGEST_CHUNK:
            raise ValueError("its parts unpack to far more than those of a recording")
        return part

    def count_index(self, size: int) -> None:
        """Refuse an index of which the same bytes are read for several chunks."""
        self._left_of_index -= size
        if self._left_of_index < 0:
            raise ValueError("its index is larger than the file")


def _refuse_sql(file):
    """Raise a ValueError for an SQLite file that would run SQL of its own when it is read.

    With equal identifiers, a table of topics would multiply the messages.
    """
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
        for name, sql in database.execute("SELECT name, sql FROM sqlite_master"):
            if sql is not None and not _PLAIN.fullmatch(sql):
                raise ValueError(f"{name!r} in it is no plain table, and a bag has nothing else")
        identifiers = [row[0] for row in database.execute("SELECT id FROM topics")]
        if len({*identifiers}) < len(identifiers):
            raise ValueError("two of its topics have the same identifier")


class Bag:
    """A bag that rosbags can open.

    Args:
        reader: The rosbags AnyReader, opened.
        unpack: Function that unpacks what zstd has packed.

    Attributes:
        types: {topic: type of its messages}.
    """

    def __init__(self, reader: Any, unpack: Callable[[bytes], bytes]) -> None:
        self._reader = reader
        self._unpack = unpack
        self.types = {name: topic.msgtype or "" for name, topic in reader.topics.items()}

    def messages(self, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of reception [ns], message) of each message of these topics.

        Raises:
            ValueError: For a type whose definition is not in the bag.
        """
        chosen = [each for each in self._reader.connections if each.topic in topics]
        known = self._reader.typestore.fielddefs
        for each in chosen:
            if each.msgtype not in known:
                raise ValueError(
                    f"{each.topic} has messages of type {each.msgtype}, whose definition is not in "
                    "the bag; an .mcap, or a bag by ROS 2 Iron or later, has the definitions"
                )
        # No topics would be all topics.
        for connection, received_ns, raw in self._reader.messages(chosen) if chosen else ():
            # `ros2 bag record --compression-mode message`
            raw = self._unpack(raw) if raw[:4] == _ZSTD else raw
            yield connection.topic, received_ns, self._reader.deserialize(raw, connection.msgtype)


@contextmanager
def opened(files: list[Path]) -> Iterator[Bag]:
    """A context with the Bag of files that are one recording.

    The metadata.yaml beside them is not read: the files have all of it.

    Args:
        files: The files, of one kind.

    Raises:
        ValueError: For a file that would run SQL of its own, or that unpacks to too much; or, if
            rosbags is not installed.
    """
    from unittest.mock import patch  # it imports asyncio

    try:
        from lz4.frame import LZ4FrameDecompressor
        from rosbags.highlevel import AnyReader
        from rosbags.rosbag1 import reader
        from rosbags.rosbag2 import storage_mcap
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise ValueError("a bag needs the package rosbags: pip install 'rhec[logs]'") from None
    unpacker = _Unpacker(sum(file.stat().st_size for file in files))
    by_lz4 = partial(unpacker.unpack, LZ4FrameDecompressor)
    by_bz2 = partial(unpacker.unpack, bz2.BZ2Decompressor)
    by_zstd = partial(unpacker.unpack, storage_mcap.zstd.ZstdDecompressor)
    of_bag = dict(none=unpacker.count, lz4=by_lz4, bz2=by_bz2)
    of_mcap = {"": unpacker.count, "lz4": by_lz4, "zstd": by_zstd}
    read_index = reader.Reader.read_index_data

    def read_index_data(self, place, indexes):
        begin = self.bio.tell()
        read_index(self, place, indexes)
        unpacker.count_index(self.bio.tell() - begin)

    # rosbags has no limits of its own, and its functions are those of all threads.
    with (
        _one_at_a_time,
        patch.dict(reader.decompressors, of_bag),
        patch.dict(storage_mcap.DECOMPRESSORS, of_mcap),
        patch.object(reader.Reader, "read_index_data", read_index_data),
    ):
        for file in files:
            if file.suffix == ".db3":
                _refuse_sql(file)
        with AnyReader(files, default_typestore=get_typestore(Stores.LATEST)) as opened_reader:
            yield Bag(opened_reader, by_zstd)
