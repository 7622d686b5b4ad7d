# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg convert`: recorded files as a bag with clouds and true poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.convert import ConvertOptions, open_recording
from hybridreg_ros.replay.recording import write_recording

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Convert; an unfinished bag is removed after an error."""
    options = ConvertOptions(
        poses=args.poses,
        rate_hz=args.rate,
        stride=args.stride,
        pixel_step=args.pixel_step,
        max_depth_m=args.max_depth,
        columns=args.columns,
    )
    recording = open_recording(args.format, args.directory, options)
    with BagWriter(args.out, args.storage, args.overwrite) as bag:
        clouds, poses = write_recording(
            progress(recording, recording.frames, args.directory.name), bag
        )
    print(f'{args.out}: {clouds} clouds on /points, {poses} poses on /ground_truth/odom')
    write_result(args, {'bag': args.out, 'clouds': clouds, 'poses': poses})
    return 0
