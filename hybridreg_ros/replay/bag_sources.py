# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Ways into a bag: a file, a directory, or the files of a directory without metadata."""

from __future__ import annotations

import contextlib
import logging
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from natsort import natsorted
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hybridreg_ros.core.errors import BagError
from hybridreg_ros.data.loaders import clouds
from hybridreg_ros.replay.bag_files import (
    DAMAGE,
    McapFile,
    RawMessage,
    Ros1File,
    RosbagsFile,
    one_line,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from rosbags.typesys.store import Typestore

logger = logging.getLogger(__name__)

File = McapFile | RosbagsFile | Ros1File
METADATA = 'metadata.yaml'
NEWEST_METADATA = 9
SUFFIXES = ('.mcap', '.db3')
HINTS = {'.pcap': 'play it with the driver of the sensor, and record its PointCloud2 topic'}
"""What to do with other files."""
HINTS |= dict.fromkeys(clouds.SUFFIXES, 'name its folder, or use `hybridreg register` with two')


class BagTopic(NamedTuple):
    """One topic of a bag: name, message type ('sensor_msgs/msg/PointCloud2'), messages."""

    name: str
    msgtype: str
    messages: int


class Source:
    """An opened bag: its files one after the other.

    Attributes:
        topics: topic name to BagTopic.
        recovered: messages rescued from cut-off files, None when all are whole.
        typestore: types of ROS 2 Jazzy, and those that only the bag explains.
    """

    def __init__(self, files: list[File]) -> None:
        self._files = files
        counts: Counter[tuple[str, str]] = Counter()
        for file in files:
            counts.update(file.counts)
        self.topics = {topic: BagTopic(topic, kind, n) for (topic, kind), n in counts.items()}
        rescued = [file.recovered for file in files if file.recovered is not None]
        self.recovered = sum(rescued) if rescued else None
        self.typestore: Typestore = get_typestore(Stores.ROS2_JAZZY)
        for file in files:
            for name, text in file.definitions.items():
                if name not in self.typestore.fielddefs:
                    with contextlib.suppress(*DAMAGE):
                        self._learn(name, text)

    def _learn(self, name: str, text: str) -> None:
        """Take types over that are not standard; the standard ones are known better here."""
        types = get_types_from_msg(text, name)
        known = self.typestore.fielddefs
        self.typestore.register({k: v for k, v in types.items() if k not in known})

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics in stored order.

        Raises:
            BagError: a file is damaged at the place reached.
        """
        for file in self._files:
            yield from file.read(topics)

    def close(self) -> None:
        """Release the files."""
        for file in self._files:
            file.close()


def open_source(path: Path) -> Source:
    """Open a bag file or directory, whatever its state.

    Raises:
        BagError: nothing there, not a bag, or damaged beyond streaming.
    """
    if not path.exists():
        raise BagError(f'no bag at {path}')
    if path.is_dir():
        return _open_directory(path)
    if path.suffix not in (*SUFFIXES, '.bag'):
        hint = HINTS.get(path.suffix.lower(), 'expected a .mcap, .db3 or .bag file, or a folder')
        raise BagError(f'{path} is not a bag: {hint}')
    return Source([_open_file(path)])


def _open_file(path: Path) -> File:
    if path.suffix == '.mcap':
        return McapFile(path)
    return Ros1File(path) if path.suffix == '.bag' else RosbagsFile(path)


def _open_directory(path: Path) -> Source:
    """A bag with metadata as it says; else all files of the folder in the order of their names.

    Raises:
        BagError: nothing readable is in it.
    """
    files: list[Path] = []
    if (path / METADATA).exists():
        about = _metadata(path)
        if about.get('compression_mode', '').lower() in ('file', 'message'):
            return Source([RosbagsFile(path)])
        files = [path / name.rsplit('/', 1)[-1] for name in about.get('relative_file_paths', [])]
        gone = [file.name for file in files if not file.exists()]
        if gone:
            raise BagError(f'{path} lacks {", ".join(gone)} of its metadata.yaml')
    files = files or _files_of(path)
    if any(file.suffix not in (*SUFFIXES, '.bag') for file in files):
        raise BagError(f'{path}: expected .mcap or .db3 files, found {files[0].name}')
    return Source(_open_files(files))


def _open_files(files: list[Path]) -> list[File]:
    """Those of several files that can be read; the last one of a recording is often empty.

    Raises:
        BagError: that of the first file, when none can be read.
    """
    opened: list[File] = []
    errors: list[BagError] = []
    for file in files:
        try:
            opened.append(_open_file(file))
        except BagError as error:
            errors.append(error)
    if not opened:
        raise errors[0]
    for found in errors:
        logger.warning('left out: %s', found)
    return opened


def _metadata(path: Path) -> dict[str, Any]:
    """Content of metadata.yaml; empty, with a warning, where it cannot be used."""
    try:
        text = (path / METADATA).read_text('utf-8')
        about = yaml.safe_load(text)['rosbag2_bagfile_information']
        version = int(about['version'])
        paths = [str(name) for name in about['relative_file_paths']]
        mode = str(about.get('compression_mode') or '')
    except (yaml.YAMLError, RecursionError, *DAMAGE) as error:
        logger.warning(
            '%s/%s cannot be used (%s): read without it', path, METADATA, one_line(error)
        )
        return {}
    if version > NEWEST_METADATA and not mode:
        logger.warning(
            '%s/%s has version %d, newer than %d: the files are read without it',
            path,
            METADATA,
            version,
            NEWEST_METADATA,
        )
        return {}
    if version > NEWEST_METADATA:
        raise BagError(
            f'{path}/{METADATA} has version {version}, newer than {NEWEST_METADATA}, and its '
            'files are compressed: decompress them (zstd -d), then name the files'
        )
    return {'relative_file_paths': paths, 'compression_mode': mode}


def _files_of(path: Path) -> list[Path]:
    """Bag files of a folder in the order of their names.

    Raises:
        BagError: there is none, or there are files of both kinds.
    """
    found = [p for p in path.iterdir() if p.is_file()]
    files = natsorted(p for p in found if p.suffix in SUFFIXES)
    kinds = sorted({p.suffix for p in files})
    if len(kinds) > 1:
        raise BagError(f'{path} holds .db3 and .mcap files and no {METADATA}: name the file')
    if files:
        return files
    if old := natsorted(p for p in found if p.suffix == '.bag'):
        return old
    if any(p.name.endswith(('.mcap.zstd', '.db3.zstd')) for p in found):
        raise BagError(
            f'{path} holds compressed files and no {METADATA}: decompress them (zstd -d)'
        )
    known = 'a .mcap, .db3 or .bag, velodyne/*.bin, *depth*.png, depth.txt, or clouds (*.ply, ...)'
    raise BagError(f'{path} is not a log: expected {known}')
