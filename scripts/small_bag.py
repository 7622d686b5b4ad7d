# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Make bags/room.mcap: a simulated room with people, every fourth pixel, truth and labels."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from hybridreg_ros.core.pointcloud2 import from_arrays, to_scan
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.recording import RecordedFrame, as_message, simulated, write_recording
from hybridreg_ros.replay.runner import true_dynamic

EVERY = 4
STEP_M = 0.002


def small(frame: RecordedFrame) -> RecordedFrame:
    """A frame with every fourth row and column, valid points only, on a grid of 2 mm."""
    height, width = frame.cloud.height, frame.cloud.width
    rows, columns = np.divmod(np.arange(height * width), width)
    message = as_message(frame)
    scan = to_scan(message)
    label = true_dynamic(message, scan)
    assert label is not None
    chosen = ((rows % EVERY == 0) & (columns % EVERY == 0))[scan.rows]
    points = (np.round(scan.points[chosen] / STEP_M) * STEP_M).astype(np.float32)
    cloud = from_arrays(points, {'label': label[chosen].astype(np.uint8)})
    return dataclasses.replace(frame, cloud=cloud)


def compress(path: Path) -> None:
    """Write an mcap file again with chunks of zstd."""
    scratch = path.with_suffix('.writing')
    with path.open('rb') as source, scratch.open('wb') as target:
        reader, writer = make_reader(source), Writer(target, compression=CompressionType.ZSTD)
        writer.start(profile='ros2', library='hybridreg_ros')
        known: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.topic not in known:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.topic] = writer.register_channel(channel.topic, 'cdr', kind)
            writer.add_message(
                known[channel.topic], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    scratch.replace(path)


def main() -> None:
    """Write the bag."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, default=Path('bags/room.mcap'))
    parser.add_argument('--frames', type=int, default=36)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    frames = progress(
        simulated('room', args.frames, 10.0, args.seed, '10-30'), args.frames, 'simulate'
    )
    with BagWriter(args.out, overwrite=True) as bag:
        write_recording(map(small, frames), bag)
    compress(args.out)
    print(f'{args.out}: {args.out.stat().st_size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
