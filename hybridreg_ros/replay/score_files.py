# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scores of recorded results: trajectory files or bags against a reference, masks from bags."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.core.pointcloud2 import field_values, has_field
from hybridreg_ros.metrics import mask, trajectory
from hybridreg_ros.metrics.extrinsic import extrinsic_of, follow, other_body
from hybridreg_ros.replay.bag_reader import POSES, open_bag
from hybridreg_ros.replay.outputs import DYNAMIC_TOPIC, ODOM_TOPIC, STATIC_TOPIC, Scores
from hybridreg_ros.replay.runner import LABEL_FIELD
from hybridreg_ros.replay.trajectory_io import read_trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.replay.bag_reader import Bag

BAG_SUFFIXES = ('.mcap', '.db3', '.bag')


def is_bag(path: Path) -> bool:
    """True for a bag by its name: a directory, .mcap or .db3."""
    return path.is_dir() or path.suffix in BAG_SUFFIXES


def load_poses(path: Path, topic: str | None, usual: str) -> Trajectory:
    """Trajectory of a TUM or KITTI file, or of a topic of a bag with poses.

    Args:
        path: file or bag.
        topic: topic asked for; None takes `usual`, or the only topic with poses there is.
        usual: topic preferred.

    Raises:
        FileFormatError: a trajectory file is malformed.
        BagError: the bag cannot be read or lacks the topic.
    """
    if not is_bag(path):
        return read_trajectory(path)
    with open_bag(path) as bag:
        if topic is None:
            found = [t.name for t in bag.topics.values() if t.msgtype in POSES]
            topic = found[0] if len(found) == 1 else usual
        return bag.trajectory(topic)


def mask_counts(bag: Bag) -> mask.MaskCounts | None:
    """Counts of the dynamic and static clouds of a bag that carry true labels.

    Points of the dynamic cloud were called moving, those of the static cloud were not; a frame
    whose two clouds were not both recorded still counts with the one there is.

    Returns:
        None when the bag holds no such cloud with labels.
    """
    total: mask.MaskCounts | None = None
    present = [t for t in (DYNAMIC_TOPIC, STATIC_TOPIC) if t in bag.topics]
    for message in bag.messages(present) if present else ():
        cloud = bag.decode(message)
        if not has_field(cloud, LABEL_FIELD):
            continue
        moves = int((field_values(cloud, LABEL_FIELD) > 0).sum())
        still = int(cloud.width * cloud.height) - moves
        counts = (
            mask.MaskCounts(tp=moves, fp=still)
            if message.topic == DYNAMIC_TOPIC
            else mask.MaskCounts(fn=moves, tn=still)
        )
        total = counts if total is None else total + counts
    return total


def score_paths(
    estimate: Path,
    reference: Path,
    topic: str | None = None,
    ref_topic: str | None = None,
    tolerance_s: float = trajectory.DEFAULT_TOLERANCE_S,
    extrinsic: Sequence[float] | None = None,
) -> Scores:
    """Score a recorded estimate against a reference.

    Args:
        estimate: TUM or KITTI file, or a bag with poses (and labelled clouds).
        reference: TUM or KITTI file, or a bag with poses.
        topic: topic of the estimate's poses.
        ref_topic: topic of the reference's poses.
        tolerance_s: largest difference of stamps, seconds.
        extrinsic: pose x y z qx qy qz qw of the body estimated in that of the reference.

    Raises:
        BagError, FileFormatError: what a file holds cannot be used.
        ConfigError: the extrinsic is no pose.
    """
    poses = load_poses(estimate, topic, ODOM_TOPIC)
    truth = load_poses(reference, ref_topic, '/ground_truth/odom')
    if extrinsic is not None:
        truth = follow(truth, extrinsic_of(extrinsic))
    score = trajectory.score(poses, truth, tolerance_s)
    warning = other_body(poses, truth, tolerance_s)
    counts = None
    if is_bag(estimate):
        with open_bag(estimate) as bag:
            counts = mask_counts(bag)
    return Scores(score, None if counts is None else mask.score(counts), '', warning)
