# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Single bag files: mcap, whole or cut off, and what rosbags reads (sqlite3, ROS 1)."""

from __future__ import annotations

import contextlib
import struct
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

from hybridreg_ros.core.errors import BagError, DependencyError

try:
    import apsw
    from backports.zstd import ZstdError
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader, SeekingReader
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import Reader, ReaderError
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, TypesysError, get_typestore
    from zstandard import ZstdError as ChunkError
except ImportError as missing:
    raise DependencyError(
        f"bags need {missing.name}: pip install 'hybridreg_ros[replay]'"
    ) from None

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from mcap.records import Channel, Message, Schema

    Stored = tuple[Schema | None, Channel, Message]

DAMAGE = (
    ReaderError,
    McapError,
    SerdeError,
    TypesysError,
    ZstdError,
    ChunkError,
    apsw.Error,
    OSError,
    EOFError,
    MemoryError,
    RuntimeError,
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    TypeError,
    ValueError,
    struct.error,
)
"""What the bag libraries raise on damaged files; all of it becomes one BagError here."""

SQLITE_ADVICE = (
    'a cut-off sqlite3 bag cannot be streamed; try: '
    'sqlite3 BROKEN.db3 .recover | sqlite3 FIXED.db3, then ros2 bag reindex'
)
ROS1_ADVICE = 'convert it first, rosbags-convert --src FILE.bag --dst DIR'


class RawMessage(NamedTuple):
    """One message as stored: topic, message type, log time (ns), CDR bytes."""

    topic: str
    msgtype: str
    log_time: int
    raw: bytes


def one_line(error: BaseException) -> str:
    """Text of an error on one line, its type where it has none."""
    return ' '.join(str(error).split()) or type(error).__name__


def type_name(name: str) -> str:
    """Message type with its middle part: 'sensor_msgs/msg/PointCloud2'."""
    package, slash, rest = name.partition('/')
    return f'{package}/msg/{rest}' if slash and '/' not in rest else name


class McapFile:
    """One mcap file, by its index, or message by message up to the place where it is cut off.

    What a file says of message types is not needed to read the standard ones, so it may be
    missing or wrong.

    Attributes:
        counts: messages of each (topic, message type).
        definitions: text of each message type that the file explains.
        recovered: messages before the cut, None for a whole file.

    Raises:
        BagError: no message of ROS 2 can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counts: Counter[tuple[str, str]] = Counter()
        self.definitions: dict[str, str] = {}
        self.recovered: int | None = None
        self._ros1 = False
        self._indexed = False
        self._limit = max(path.stat().st_size, 1)
        try:
            self._look()
        except DAMAGE as error:
            self._scan(one_line(error))
        if self._ros1 and not self.counts:
            raise BagError(f'{path} holds messages of ROS 1: {ROS1_ADVICE}')

    def _look(self) -> None:
        """Topics and counts from the index at the end of the file."""
        with self.path.open('rb') as stream:
            summary = SeekingReader(stream, record_size_limit=self._limit).get_summary()
        if summary is None or summary.statistics is None:
            return self._scan('')
        self._indexed = bool(summary.chunk_indexes)
        for channel in summary.channels.values():
            self._note(
                summary.schemas.get(channel.schema_id),
                channel,
                summary.statistics.channel_message_counts.get(channel.id, 0),
            )
        return None

    def _scan(self, why: str) -> None:
        """Topics and counts from the messages themselves; `why` says what is wrong, if anything.

        Raises:
            BagError: there is none.
        """
        self.counts.clear()
        self._indexed = False
        try:
            for schema, channel, _ in self._stream(None):
                self._note(schema, channel, 1)
        except DAMAGE as error:
            why = why or one_line(error)
        if not why:
            return
        self.recovered = self.counts.total()
        if not self.recovered and not self._ros1:
            raise BagError(f'cannot read bag {self.path} ({why}): no complete message in it')

    def _note(self, schema: Schema | None, channel: Channel, count: int) -> None:
        if channel.message_encoding == 'ros1':
            self._ros1 = True
        if channel.message_encoding != 'cdr':
            return
        name = type_name(schema.name) if schema is not None else 'of unknown type'
        self.counts[channel.topic, name] += count
        if schema is not None and schema.encoding == 'ros2msg' and name not in self.definitions:
            self.definitions[name] = schema.data.decode(errors='replace')

    def _stream(self, topics: Collection[str] | None) -> Iterator[Stored]:
        """Messages in file order, checksums compared; raises one of DAMAGE where it is damaged."""
        with self.path.open('rb') as stream:
            reader = NonSeekingReader(stream, validate_crcs=True, record_size_limit=self._limit)
            yield from reader.iter_messages(topics, log_time_order=False)

    def _by_index(self, topics: Collection[str]) -> Iterator[Stored]:
        """Messages in log-time order."""
        with self.path.open('rb') as stream:
            reader = SeekingReader(stream, validate_crcs=True, record_size_limit=self._limit)
            yield from reader.iter_messages(topics)

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics, in log-time order where the file has an index.

        Raises:
            BagError: a file that seemed whole is damaged at the place reached.
        """
        stored = self._by_index(topics) if self._indexed else self._stream(topics)
        try:
            for schema, channel, message in stored:
                if schema is not None and channel.message_encoding == 'cdr':
                    name = type_name(schema.name)
                    yield RawMessage(channel.topic, name, message.log_time, message.data)
        except DAMAGE as error:
            if self.recovered is None:
                raise BagError(
                    f'bag {self.path} is damaged ({one_line(error)}): recover it with: '
                    'mcap recover FILE'
                ) from None

    def close(self) -> None:
        """Nothing stays open between reads."""


class RosbagsFile:
    """A sqlite3 file, or a directory with compressed files, through rosbags.

    Attributes:
        counts, definitions, recovered: as of McapFile.

    Raises:
        BagError: it cannot be opened.
    """

    faults: tuple[type[Exception], ...] = DAMAGE
    advice = f': {SQLITE_ADVICE}'

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recovered: int | None = None
        self.definitions: dict[str, str] = {}
        self.counts: Counter[tuple[str, str]] = Counter()
        try:
            self._reader = self._opened(path)
        except self.faults as error:
            raise BagError(self._refusal(one_line(error))) from None
        for connection in self._reader.connections:
            self.counts[connection.topic, type_name(connection.msgtype)] += connection.msgcount
            self._note(connection)

    def _opened(self, path: Path) -> Any:
        reader = Reader(path)
        reader.open()
        return reader

    def _refusal(self, reason: str) -> str:
        return _sqlite_message(self.path, reason)

    def _note(self, connection: Any) -> None:
        """Keep the definition of a connection's messages."""
        if connection.msgdef.format == MessageDefinitionFormat.MSG:
            self.definitions[type_name(connection.msgtype)] = connection.msgdef.data

    def _stored(self, raw: bytes, name: str) -> bytes:
        """A message as ROS 2 stores it."""
        del name
        return bytes(raw)

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics in log-time order.

        Raises:
            BagError: the file is damaged at the place reached, or a type is not a standard one.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        try:
            for connection, log_time, raw in self._reader.messages(connections=chosen):
                name = type_name(connection.msgtype)
                yield RawMessage(connection.topic, name, log_time, self._stored(raw, name))
        except self.faults as error:
            text = f'bag {self.path} is damaged ({one_line(error)}){self.advice}'
            raise BagError(text) from None

    def close(self) -> None:
        """Close the reader."""
        with contextlib.suppress(*self.faults):
            self._reader.close()


class Ros1File(RosbagsFile):
    """A bag of ROS 1, whose messages are handed out as ROS 2 stores them."""

    faults = (Ros1Error, *DAMAGE)
    advice = ''

    def _opened(self, path: Path) -> Any:
        self._types = get_typestore(Stores.ROS2_JAZZY)
        reader = Ros1Reader(path)
        reader.open()
        return reader

    def _refusal(self, reason: str) -> str:
        return f'cannot read bag {self.path} ({reason}): try rosbag reindex FILE.bag'

    def _note(self, connection: Any) -> None:
        """Definitions of ROS 1 are not those of ROS 2."""

    def _stored(self, raw: bytes, name: str) -> bytes:
        return bytes(self._types.ros1_to_cdr(raw, name))


def _sqlite_message(path: Path, reason: str) -> str:
    if path.is_file():
        with path.open('rb') as stream:
            if stream.read(15) != b'SQLite format 3':
                return f'{path} is not a bag: it does not begin like an sqlite3 file'
    return f'cannot read bag {path} ({reason}): {SQLITE_ADVICE}'
