# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One bag from start to finish: front end, output files, scores, report."""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from hybridreg_ros.core.config import load_yaml, to_dict
from hybridreg_ros.core.heap import one_heap
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.metrics.extrinsic import extrinsic_of, follow
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.replay import outputs, runner
from hybridreg_ros.replay.clean_map import CleanMap, MapReport, MapSink
from hybridreg_ros.replay.folder_log import between, open_log
from hybridreg_ros.replay.frame_errors import frame_errors
from hybridreg_ros.replay.interrupt import StopRequest
from hybridreg_ros.replay.page.pictures import Album, Film
from hybridreg_ros.replay.page.report import ReportRun, write_report
from hybridreg_ros.replay.page.scene import SceneSink
from hybridreg_ros.replay.rerun_sink import RerunSink

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.odometry.frontend import HybridOdometry
    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.replay.folder_log import Log
    from hybridreg_ros.replay.page.pictures import FrameView
    from hybridreg_ros.replay.page.scene import Scene
    from hybridreg_ros.replay.runner import FrameLog, ReplayLog


@dataclass(frozen=True)
class Job:
    """What to do with one bag.

    Attributes:
        bag: bag file or directory, or folder of recorded files.
        out: folder of the results.
        config: settings of the front end.
        weights: checkpoint, None for the packaged one.
        topic: PointCloud2 topic, None for the only one.
        truth_topic: topic with true poses, None for /ground_truth/odom.
        extrinsic: pose x y z qx qy qz qw of the sensor in the body of the true poses, None = same.
        time_unit: unit of per-point times.
        time_field: field of per-point times, '' = by the usual names.
        stride: take every n-th cloud.
        max_frames: stop after so many.
        start_s: begin so many seconds after the first cloud.
        duration_s: end so many seconds later, None = at the end.
        clouds: write dynamic and static clouds into dynamic.mcap.
        compare: run kiss-icp alone beside it.
        map: file (.ply, .pcd, ...) for the cleaned map, None for none.
        moving: file for the points that moved.
        video: .gif, .webp or .mp4 of what the sensor saw, with its moving points.
        rerun: 'live', the address of a viewer or a .rrd file for Rerun, '' for none.
    """

    bag: Path
    out: Path
    config: OdometryConfig = OdometryConfig()
    weights: Path | None = None
    topic: str | None = None
    truth_topic: str | None = None
    extrinsic: tuple[float, ...] | None = None
    time_unit: str = 'auto'
    time_field: str = ''
    stride: int = 1
    max_frames: int | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    clouds: bool = True
    compare: bool = True
    map: Path | None = None
    moving: Path | None = None
    video: Path | None = None
    rerun: str = ''


def asked(job: Job) -> dict[str, Any]:
    """What decides the results of a job, as plain values; equal ones need not be done again."""
    file = job.bag.stat() if job.bag.exists() else None
    return {
        **{f.name: getattr(job, f.name) for f in dataclasses.fields(job) if f.name != 'config'},
        'out': None,
        'config': to_dict(job.config),
        'changed_ns': None if file is None else file.st_mtime_ns,
    }


def odometry_config(path: Path | None, registrar: str | None = None) -> OdometryConfig:
    """Settings of the front end from a YAML file (or defaults), with --registrar on top.

    Raises:
        ConfigError: unreadable file, unknown key, or a value out of range.
    """
    from hybridreg_ros.odometry.config import OdometryConfig

    config = OdometryConfig() if path is None else load_yaml(OdometryConfig, path)
    return config if registrar is None else dataclasses.replace(config, registrar=registrar)


def open_front_end(config: OdometryConfig, weights: Path | None) -> HybridOdometry:
    """Front end of the settings, threads on one heap; the network is loaded only when it leads.

    Raises:
        WeightsError: the checkpoint is missing, damaged or foreign.
    """
    from hybridreg_ros.odometry.frontend import HybridOdometry

    one_heap()
    if config.registrar == 'kiss-icp' or weights is None:
        return HybridOdometry(config)
    from hybridreg_ros.model.register import HybridReg

    return HybridOdometry(config, model=HybridReg.from_pretrained(weights))


def truth_of(job: Job, bag: Log) -> Trajectory | None:
    """True poses of the sensor, None without.

    Raises:
        BagError: the topic asked for is not there, or of another type.
        ConfigError: the extrinsic is no pose.
    """
    truth = bag.ground_truth(job.truth_topic)
    if truth is None or job.extrinsic is None:
        return truth
    return follow(truth, extrinsic_of(job.extrinsic))


class Plan(NamedTuple):
    """Topic of the clouds of a log, how many of them will be taken, and what was chosen."""

    topic: str
    clouds: int
    note: str


def plan_of(job: Job) -> Plan:
    """What will be taken of a job's log.

    Raises:
        BagError: the log cannot be read, or has no such topic.
    """
    with open_log(job.bag) as bag:
        topic = bag.cloud_topic(job.topic)
        count = -(-bag.topics[topic].messages // job.stride)
        kind = bag.topics[topic].msgtype
        others = sorted(t.name for t in bag.topics.values() if t.msgtype == kind)
    others.remove(topic)
    note = f'clouds of {topic}; --topic chooses another one ({", ".join(others)})'
    most = job.max_frames or count
    return Plan(topic, min(count, most), note if others and job.topic is None else '')


class Beside:
    """Another front end on the same clouds: a sink that keeps a log of its own.

    Args:
        name: in the report.
        front_end: takes one scan after the other.
    """

    def __init__(self, name: str, front_end: runner.FrontEnd) -> None:
        self.name = name
        self.log = runner.ReplayLog()
        self._front_end = front_end

    def add(self, message: Any, result: OdometryResult) -> None:
        """Let it take the scan of a result."""
        self.take(message, result.scan)

    def take(self, message: Any, scan: Scan) -> None:
        """Let it take a scan and the message it came from."""
        self.log.frames.append(runner.log_frame(message, self._front_end.step(scan)))

    def run(self, truth: Trajectory | None) -> ReportRun:
        """Its part of the report; it says nothing about moving points."""
        scores = dataclasses.replace(outputs.score_log(self.log, truth), mask=None)
        return ReportRun(self.name, self.log, scores, truth)


def replay(
    job: Job,
    tick: Callable[[FrameLog | None], None] | None = None,
    beside: Beside | None = None,
) -> ReportRun:
    """Send a bag through the front end offline and write all results.

    After Ctrl-C or at a damaged place of the bag, the results so far are written all the same.

    Args:
        job: what to do.
        tick: called after each cloud.
        beside: a front end to compare with, None for none.

    Raises:
        BagError: the bag cannot be opened or has no usable topic.
        WeightsError: the checkpoint cannot be used.
    """
    topic, count, chosen = plan_of(job)
    threshold = job.config.dynamics.threshold
    front_end = open_front_end(job.config, job.weights)
    job.out.mkdir(parents=True, exist_ok=True)
    album, seen = Album(count, threshold=threshold), SceneSink(threshold)
    also = () if beside is None else (beside,)
    wanted = job.map is not None or job.moving is not None
    film = [Film(threshold)] if job.video is not None else []
    with contextlib.ExitStack() as stack:
        bag = open_log(job.bag)
        stack.enter_context(bag)
        truth = truth_of(job, bag)
        files = outputs.OutputFiles(job.out, job.clouds, threshold)
        stack.enter_context(contextlib.closing(files))
        mapped = [MapSink(job.out, threshold, job.config)] if wanted else []
        shown = [RerunSink(job.rerun, job.bag.stem, threshold)] if job.rerun else []
        for sink in mapped:
            stack.enter_context(contextlib.closing(sink))
        for view in shown:
            stack.enter_context(contextlib.closing(view))
        stop = stack.enter_context(StopRequest())
        every = bag.frames(topic, job.time_unit, job.time_field)
        frames = between(every, job.start_s, job.duration_s)
        log = runner.run(
            (f if f.scan is None else f._replace(scan=front_end.seen(f.scan)) for f in frames),
            front_end,
            (files, album, seen, *mapped, *film, *shown, *also),
            job.stride,
            job.max_frames,
            threshold,
            tick,
            stop,
        )
        about: dict[str, Any] = {'map': _write_map(job, mapped[0].make())} if mapped else {}
        if job.video is not None:
            film[0].write(job.video)
        log.notes += [chosen] if chosen else []
        if bag.recovered is not None:
            log.notes.append(f'the bag is cut off, {bag.recovered} messages were recovered')
        if job.config.registrar == 'hybridreg' and not front_end.has_network:
            log.notes.append('no network weights: kiss-icp registers every scan')
        about |= {'topic': topic, 'stride': job.stride, 'live': False, 'recovered': bag.recovered}
        runs = [b.run(truth) for b in also]
        return finish(job, log, truth, album.views(), about, seen.scene(), runs, (files, *shown))


def _write_map(job: Job, made: CleanMap) -> MapReport:
    for path, points in ((job.map, made.still), (job.moving, made.moving)):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_cloud(path, points)
    return made.report


def finish(
    job: Job,
    log: ReplayLog,
    truth: Trajectory | None,
    views: list[FrameView],
    about: dict[str, Any],
    scene: Scene,
    beside: Sequence[ReportRun],
    sinks: Sequence[outputs.Ending],
) -> ReportRun:
    """Score a run, live or offline, end its files, and write metrics.json and report.html.

    Args:
        job: what was done.
        log: its frames.
        truth: reference, None without.
        views: frames for the pictures.
        about: further entries of metrics.json.
        scene: what the 3D view shows.
        beside: other runs on the same clouds.
        sinks: take the paths.
    """
    scores, made = outputs.score_log(log, truth), log.trajectory()
    errors = None if truth is None or scores.trajectory is None else frame_errors(log, truth)
    for sink in sinks:
        sink.end(made, scene.optical, truth, None if errors is None else errors.T_odom_world)
    metrics = outputs.metrics_of(
        log,
        scores,
        to_dict(job.config),
        job.bag,
        errors,
        registrar=job.config.registrar,
        asked=asked(job),
        beside={r.name: r.scores.trajectory for r in beside},
        **about,
    )
    run = ReportRun(job.config.registrar, log, scores, truth, views, metrics, scene, tuple(beside))
    mode = 'through the node, live' if about.get('live') else 'offline'
    write_report(
        job.out / 'report.html',
        f'Replay of {job.bag.name}',
        f'{len(log.frames)} frames {mode}, front end {job.config.registrar}, '
        f'{log.wall_s:.1f} s of computation',
        [run, *beside],
    )
    outputs.write_trajectories(job.out, made, truth)
    # Last, since it is the sign that a run is finished.
    outputs.write_json(job.out / 'metrics.json', metrics)
    return run
