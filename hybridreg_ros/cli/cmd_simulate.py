# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg simulate`: a procedural dynamic sequence as a bag with true poses and labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.recording import simulated, write_recording

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Simulate and write."""
    frames = simulated(args.scene, args.frames, args.rate, args.seed, args.moving)
    with BagWriter(args.out, args.storage, args.overwrite) as bag:
        clouds, poses = write_recording(progress(frames, args.frames, args.scene), bag)
    print(f'{args.out}: {clouds} clouds on /points, {poses} poses on /ground_truth/odom')
    write_result(args, {'bag': args.out, 'clouds': clouds, 'poses': poses, 'seed': args.seed})
    return 0
