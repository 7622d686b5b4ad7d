# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Ways into a rosbag2: the indexed reader, and streaming for mcap files that were cut off."""

from __future__ import annotations

import struct
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from hybridreg_ros.core.errors import BagError, DependencyError

try:
    import apsw
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag2 import ReaderError
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
except ImportError as missing:
    raise DependencyError(
        f"bags need {missing.name}: pip install 'hybridreg_ros[replay]'"
    ) from None

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from rosbags.typesys.store import Typestore

DAMAGE = (
    AnyReaderError,
    ReaderError,
    McapError,
    SerdeError,
    TypesysError,
    apsw.Error,
    OSError,
    EOFError,
    RuntimeError,
    AssertionError,
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


class BagTopic(NamedTuple):
    """One topic of a bag: name, message type ('sensor_msgs/msg/PointCloud2'), messages."""

    name: str
    msgtype: str
    messages: int


class RawMessage(NamedTuple):
    """One message as stored: topic, message type, log time (ns), CDR bytes."""

    topic: str
    msgtype: str
    log_time: int
    raw: bytes


class Source(Protocol):
    """An opened bag."""

    topics: dict[str, BagTopic]
    recovered: int | None
    typestore: Typestore

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics in stored order."""

    def close(self) -> None:
        """Release the file."""


def open_source(path: Path) -> Source:
    """Open a bag file or directory, whatever its state.

    Raises:
        BagError: nothing there, not a bag, damaged beyond streaming, or a ROS 1 bag.
    """
    if not path.exists():
        raise BagError(f'no bag at {path}')
    if path.is_dir():
        _check_directory(path)
    elif path.suffix == '.bag':
        raise BagError(
            f'{path} is a ROS 1 bag: convert it first, rosbags-convert --src {path} --dst DIR'
        )
    elif path.suffix not in ('.mcap', '.db3'):
        raise BagError(f'{path} is not a bag: expected a .mcap or .db3 file, or a bag directory')
    try:
        return IndexedSource(path)
    except DAMAGE as error:
        reason = ' '.join(str(error).split())
        files = _mcap_files(path)
        if not files:
            raise BagError(_sqlite_message(path, reason)) from None
    return StreamedSource(files, reason)


def _check_directory(path: Path) -> None:
    if (path / 'metadata.yaml').exists():
        return
    files = sorted(f.name for f in path.iterdir() if f.suffix in ('.mcap', '.db3'))
    if not files:
        raise BagError(f'{path} is not a bag: it holds neither metadata.yaml nor a .mcap or .db3')
    raise BagError(
        f'{path} has no metadata.yaml: name its file instead ({path / files[0]}), '
        f'or restore it with: ros2 bag reindex {path}'
    )


def _mcap_files(path: Path) -> list[Path]:
    return [path] if path.suffix == '.mcap' and path.is_file() else sorted(path.glob('*.mcap'))


def _sqlite_message(path: Path, reason: str) -> str:
    files = [path] if path.is_file() else sorted(path.glob('*.db3'))
    magic = b''
    if files:
        with files[0].open('rb') as stream:
            magic = stream.read(15)
    if files and magic != b'SQLite format 3':
        return f'{files[0]} is not a bag: it does not begin like an sqlite3 file'
    return f'cannot read bag {path} ({reason}): {SQLITE_ADVICE if files else "not a bag"}'


class IndexedSource:
    """A complete bag, read through its index."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        self._reader.open()
        self.recovered: int | None = None
        self.typestore: Typestore = self._reader.typestore
        counts: Counter[tuple[str, str]] = Counter()
        for connection in self._reader.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
        self.topics = {topic: BagTopic(topic, kind, n) for (topic, kind), n in counts.items()}

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics in log-time order.

        Raises:
            BagError: the file is damaged at the place reached.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        try:
            for connection, log_time, raw in self._reader.messages(connections=chosen):
                yield RawMessage(connection.topic, connection.msgtype, log_time, bytes(raw))
        except DAMAGE as error:
            reason = ' '.join(str(error).split())
            files = _mcap_files(self._path)
            advice = 'recover it with: mcap recover FILE' if files else SQLITE_ADVICE
            raise BagError(f'bag {self._path} is damaged ({reason}): {advice}') from None

    def close(self) -> None:
        """Close the reader."""
        self._reader.close()


class StreamedSource:
    """An mcap bag without a usable end: every message before the cut, in file order."""

    def __init__(self, files: list[Path], reason: str) -> None:
        self._files = files
        types: dict[str, Any] = {}
        counts: Counter[tuple[str, str]] = Counter()
        for schema, channel, _ in self._stream(None):
            name = str(schema.name)
            if not counts[channel.topic, name] and schema.encoding == 'ros2msg':
                types.update(get_types_from_msg(schema.data.decode(), name))
            counts[channel.topic, name] += 1
        self.recovered: int | None = counts.total()
        if not self.recovered:
            raise BagError(f'cannot read bag {files[0]} ({reason}): no complete message in it')
        self.topics = {topic: BagTopic(topic, kind, n) for (topic, kind), n in counts.items()}
        self.typestore = get_typestore(Stores.EMPTY)
        self.typestore.register(types or get_typestore(Stores.ROS2_JAZZY).fielddefs)

    def _stream(self, topics: Collection[str] | None) -> Iterator[tuple[Any, Any, Any]]:
        for file in self._files:
            with file.open('rb') as stream:
                reader = NonSeekingReader(stream)
                try:
                    for schema, channel, message in reader.iter_messages(
                        topics=topics, log_time_order=False
                    ):
                        if schema is not None and channel.message_encoding == 'cdr':
                            yield schema, channel, message
                except DAMAGE:
                    continue  # the cut: everything before it has been yielded

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics up to the cut, in file order."""
        for schema, channel, message in self._stream(topics):
            yield RawMessage(channel.topic, schema.name, message.log_time, message.data)

    def close(self) -> None:
        """Nothing stays open between reads."""
