# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The live side of `replay` and `demo`: the only door from the commands to the ROS part."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import ConfigError, require
from hybridreg_ros.core.progress import bar
from hybridreg_ros.replay import session
from hybridreg_ros.replay.bag_reader import open_bag
from hybridreg_ros.replay.live_log import LiveRecorder
from hybridreg_ros.replay.outputs import OutputFiles
from hybridreg_ros.replay.runner import INTERRUPTED, Drop

if TYPE_CHECKING:
    import argparse

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.replay.page.report import ReportRun

OFFLINE = (
    *('stride', 'max_frames', 'start', 'duration', 'time_unit', 'time_field', 'weights'),
    *('no_clouds', 'map', 'moving', 'video', 'rerun'),
)
"""Options that only an offline replay has."""


@dataclass(frozen=True)
class LiveOptions:
    """How a bag is played into the node.

    Attributes:
        rate: speed, 1 = as recorded, 0 = as fast as the node can.
        domain_id: ROS domain, None for one of our own.
        timeout_s: longest silence of the node.
    """

    rate: float = 1.0
    domain_id: int | None = None
    timeout_s: float = 60.0


def check_options(args: argparse.Namespace) -> None:
    """Refuse what only an offline replay can do.

    Raises:
        ConfigError: names the option.
    """
    for name in OFFLINE:
        if getattr(args, name) != args.parser.get_default(name):
            option = f'--{name.replace("_", "-")}'
            raise ConfigError(f'{option} cannot be combined with --live: leave one of them out')
    check_ros()


def check_ros() -> None:
    """Find rclpy before the work begins.

    Raises:
        DependencyError: it is not installed.
    """
    require('--live', 'ros', 'rclpy')


def _said(diagnostics: str) -> list[str]:
    """Findings of the node's last diagnostics; that the bag has ended is none."""
    findings = diagnostics.split('; ')
    return [f for f in findings if f not in ('', 'ok') and not f.startswith('no cloud for')]


def replay_live(
    job: session.Job, options: LiveOptions, beside: session.Beside | None = None
) -> ReportRun:
    """Play a bag into the real node over DDS; record, score and report what it publishes.

    Args:
        job: bag, output folder and settings.
        options: speed, domain, patience.
        beside: a front end that takes the same clouds afterwards, offline.

    Raises:
        DependencyError: rclpy is not installed.
        HybridRegError: the node did not start or went silent.
    """
    check_ros()
    from hybridreg_ros.ros.playback import live

    topic, count, chosen = session.plan_of(job)
    with open_bag(job.bag) as bag:  # a folder of files cannot be played
        truth = session.truth_of(job, bag)
    job.out.mkdir(parents=True, exist_ok=True)
    files = OutputFiles(job.out)
    recorder = LiveRecorder(files, count)
    about: dict[str, Any] = {'topic': topic, 'stride': 1, 'live': True, 'rate': options.rate}
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.closing(files))
        stack.enter_context(contextlib.closing(recorder))
        shown = stack.enter_context(bar(count, job.bag.name))

        def on_odom(msg: Any) -> None:
            recorder.on_odom(msg)
            shown.update()

        try:
            report = live.run_live(
                job.bag,
                topic,
                job.config,
                on_odom,
                recorder.on_dynamic,
                recorder.on_static,
                recorder.on_frame,
                rate=options.rate,
                domain_id=options.domain_id,
                timeout_s=options.timeout_s,
            )
            about['transport'] = report
            recorder.log.notes += [f'the node says: {text}' for text in _said(report.diagnostics)]
            recorder.log.drops += [
                Drop(0, f'{cause}: {n} clouds dropped by the node')
                for cause, n in report.dropped.items()
            ]
        except KeyboardInterrupt:
            recorder.log.interrupted = INTERRUPTED
        shown.close()
        recorder.close()
        recorder.log.notes += [chosen] if chosen else []
        runs = [] if beside is None else [_afterwards(job, topic, beside, truth)]
        views, seen = recorder.album.views(), recorder.seen.scene()
        return session.finish(job, recorder.log, truth, views, about, seen, runs, [files])


def _afterwards(
    job: session.Job, topic: str, beside: session.Beside, truth: Trajectory | None
) -> ReportRun:
    with open_bag(job.bag) as bag:
        for frame in bag.frames(topic):
            if frame.scan is not None:
                beside.take(frame.message, frame.scan)
    return beside.run(truth)
