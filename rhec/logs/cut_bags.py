"""Bags whose recording was cut off: their messages until there, read without an index.

A recorder writes the index of a bag when it ends. After a power failure the index is missing, and
libraries refuse the file. The records before it are read here one after the other:

- .mcap: records of 1 byte operation, 8 bytes length, content (mcap.dev/spec), in chunks or not;
- .bag: records of a header of fields and of data (wiki.ros.org/Bags/Format/2.0), in chunks;
- .db3: rows of the table `messages` in their order, until the first page that is missing.
"""

import bz2
import io
import mmap
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA = 3  # these four are operations in an .mcap
_CHANNEL = 4
_MESSAGE = 5
_CHUNK = 6
_BAG_MAGIC = b"#ROSBAG V2.0\n"
_BAG_MESSAGE = 2  # these three are operations in a .bag
_BAG_CHUNK = 5
_BAG_CONNECTION = 7
_IDL_LINE = "=" * 80 + "\n"


class _Connection(NamedTuple):
    """Messages of one topic."""

    number: int
    topic: str
    msgtype: str
    definition: str  # empty if the bag has none
    is_idl: bool = False  # whether the definition is in IDL


class _Raw(NamedTuple):
    """A message as it was recorded."""

    number: int  # of its connection
    received_ns: int
    content: bytes


class _End(Exception):
    """The file ends here."""


def _exactly(stream, size):
    content = stream.read(size)
    if len(content) < size:
        raise _End
    return content


def _unpacked(stream, form):
    return struct.unpack(form, _exactly(stream, struct.calcsize(form)))


def _text(stream):
    return _exactly(stream, *_unpacked(stream, "<I")).decode()


def _until_the_end(parts):
    """The parts of an iterator, until one is cut off or is no record."""
    try:
        yield from parts
    except Exception:  # any error that a broken record causes: what follows it cannot be read
        return


# .mcap


def _of_mcap(stream: Any) -> Iterator[_Connection | _Raw]:
    """The connections and messages of an .mcap."""
    if stream.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
        return
    yield from _records_of_mcap(stream, {})


def _records_of_mcap(stream, schemas):
    while head := stream.read(9):
        operation, size = struct.unpack("<BQ", head)
        if operation not in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
            stream.seek(size, io.SEEK_CUR)
            continue
        content = stream.read(size)
        record = io.BytesIO(content)
        if operation == _CHUNK:
            yield from _records_of_mcap(_unpacked_chunk(record), schemas)
        if len(content) < size:
            raise _End
        if operation == _SCHEMA:
            (number,) = _unpacked(record, "<H")
            schemas[number] = (_text(record), _text(record), _text(record))
        if operation == _CHANNEL:
            number, of_schema = _unpacked(record, "<HH")
            name, encoding, definition = schemas.get(of_schema, ("", "", ""))
            yield _Connection(number, _text(record), name, definition, encoding.endswith("idl"))
        if operation == _MESSAGE:
            number, _, received_ns, _ = _unpacked(record, "<HIQQ")
            yield _Raw(number, received_ns, record.read())


def _unpacked_chunk(record):
    """The records in a chunk of an .mcap as a stream; of one cut off only if not compressed."""
    from rosbags.rosbag2.storage_mcap import decompress  # only some have it

    _, _, size, crc = _unpacked(record, "<QQQI")
    compression = _text(record)
    (packed_size,) = _unpacked(record, "<Q")
    content = record.read(packed_size)
    if len(content) < packed_size:
        if compression:
            raise _End
        return io.BytesIO(content)
    return io.BytesIO(decompress(content, compression, size, crc))


# .bag


def _of_bag(stream: Any) -> Iterator[_Connection | _Raw]:
    """The connections and messages of a .bag."""
    if stream.read(len(_BAG_MAGIC)) != _BAG_MAGIC:
        return
    yield from _records_of_bag(stream)


def _fields(content):
    """The fields {name: value} of a header."""
    fields = {}
    stream = io.BytesIO(content)
    while stream.tell() < len(content):
        name, _, value = _exactly(stream, *_unpacked(stream, "<I")).partition(b"=")
        fields[name.decode()] = value
    return fields


def _records_of_bag(stream):
    from rosbags.typesys.msg import normalize_msgtype

    while head := stream.read(4):
        fields = _fields(_exactly(stream, *struct.unpack("<I", head)))
        operation = fields["op"][0]
        (size,) = _unpacked(stream, "<I")
        content = stream.read(size)
        if operation == _BAG_CHUNK:
            yield from _records_of_bag(_unpacked_bag_chunk(fields, content, size))
        if len(content) < size:
            raise _End
        if operation == _BAG_CONNECTION:
            (number,) = struct.unpack("<I", fields["conn"])
            described = _fields(content)
            msgtype = normalize_msgtype(described["type"].decode())
            definition = described["message_definition"].decode()
            yield _Connection(number, fields["topic"].decode(), msgtype, definition)
        if operation == _BAG_MESSAGE:
            (number,) = struct.unpack("<I", fields["conn"])
            sec, nanosec = struct.unpack("<II", fields["time"])
            yield _Raw(number, sec * 10**9 + nanosec, content)


def _unpacked_bag_chunk(fields, content, size):
    """The records in a chunk of a .bag as a stream; of one cut off only if not compressed."""
    import lz4.frame  # rosbags needs it, too

    unpack: dict[str, Callable] = dict(bz2=bz2.decompress, lz4=lz4.frame.decompress)
    compression = fields["compression"].decode()
    if compression == "none":
        return io.BytesIO(content)
    if len(content) < size:
        raise _End
    return io.BytesIO(unpack[compression](content))


# .db3


def _of_db3(file: Path) -> Iterator[_Connection | _Raw]:
    """The connections and messages of a .db3."""
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as base:
        # SQLite otherwise refuses a file that is shorter than its first page says.
        base.execute("PRAGMA writable_schema=ON")
        tables = [name for (name,) in base.execute("SELECT name FROM sqlite_master")]
        definitions = {}
        if "message_definitions" in tables:
            columns = "topic_type, encoding, encoded_message_definition"
            rows = base.execute(f"SELECT {columns} FROM message_definitions")
            definitions = {name: (text, code.endswith("idl")) for name, code, text in rows}
        for number, topic, msgtype in base.execute("SELECT id, name, type FROM topics"):
            yield _Connection(number, topic, msgtype, *definitions.get(msgtype, ("", False)))
        for row in base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            yield _Raw(*row)


def _records(file):
    """The connections and messages of a file, until it was cut off."""
    if file.suffix == ".db3":
        yield from _until_the_end(_of_db3(file))
        return
    if not file.stat().st_size:
        return
    # Unlike a file, this stream does not reserve the memory that a broken length asks for.
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as stream,
    ):
        yield from _until_the_end((_of_mcap if file.suffix == ".mcap" else _of_bag)(stream))


class CutBag:
    """A bag that was cut off, with the methods of `rhec.logs.bags.Bag`.

    Args:
        files: Paths of its files, of which one or more were cut off.
        default: The rosbags typestore for a bag without definitions of its types.

    Attributes:
        types: {topic: type of its messages}.
        count: Number of messages that can be read.
    """

    def __init__(self, files: list[Path], default: Any) -> None:
        self._files = files
        self._is_ros1 = files[0].suffix == ".bag"
        connections = []
        self.count = 0
        for file in files:
            for record in _records(file):
                if isinstance(record, _Connection):
                    connections.append(record)
                else:
                    self.count += 1
        self.types = {each.topic: each.msgtype for each in connections}
        self._typestore = _typestore(connections, default)

    def messages(self, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of reception [ns], message) of each message of these topics."""
        store = self._typestore
        unpack = store.deserialize_ros1 if self._is_ros1 else store.deserialize_cdr
        for file in self._files:
            chosen: dict[int, _Connection] = {}
            for record in _records(file):
                if isinstance(record, _Connection):
                    if record.topic in topics:
                        chosen[record.number] = record
                elif record.number in chosen:
                    topic, msgtype = chosen[record.number][1:3]
                    yield topic, record.received_ns, unpack(record.content, msgtype)


def _typestore(connections, default):
    """A rosbags typestore with the definitions in a bag, or else the default one."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    types = {}
    for each in connections:
        if each.is_idl:
            parts = each.definition.split(_IDL_LINE)
            bodies = [part.partition("\n")[2] for part in parts if part.startswith("IDL: ")]
            for body in bodies or [each.definition]:
                types.update(get_types_from_idl(body))
        elif each.definition:
            types.update(get_types_from_msg(each.definition, each.msgtype))
    if not types:
        return default
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store
