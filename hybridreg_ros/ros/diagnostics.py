# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""/diagnostics: one status that says whether the odometry can be trusted, and if not, why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from hybridreg_ros.odometry.result import Source

if TYPE_CHECKING:
    from collections.abc import Mapping

    from builtin_interfaces.msg import Time

    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.ros.monitor import Snapshot

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

TWINS = (
    'of this name publish the same odometry and /tf: give each node a name or namespace of its '
    'own (-r __node:=NAME, -r __ns:=/NAME)'
)


@dataclass(frozen=True)
class Setting:
    """What does not come from the clouds.

    Attributes:
        name: name of the status, with the node's name.
        hardware_id: topic the clouds come from.
        weights: state of the network's weights.
        has_weights: False when the network cannot be used although it was asked for.
        transport: what fastdds.prepare decided.
        transport_warning: True when large clouds may be lost.
        input_timeout_s: silence that is worth a warning.
        paused: True between ~/pause and ~/resume.
        starting: what the node does before it subscribes, '' once it has.
        waiting_for: text while outputs are held back (extrinsic unknown), else ''.
        guides: state of what corrects the prediction (guess, imu), by name.
        twins: other nodes that publish odometry under the same name.
        queue: clouds waiting.
        tf: state of the /tf output.
    """

    name: str
    hardware_id: str
    weights: str
    has_weights: bool
    transport: str
    transport_warning: bool
    input_timeout_s: float
    paused: bool
    starting: str
    waiting_for: str
    guides: Mapping[str, str]
    twins: int
    queue: int
    tf: str


def findings(state: Snapshot, setting: Setting) -> list[tuple[bytes, str]]:
    """What is wrong now, as (level, text), the most severe first."""
    found = _about_clouds(state) + _about_node(state, setting)
    return sorted(found, key=lambda item: -item[0][0])


def _about_clouds(state: Snapshot) -> list[tuple[bytes, str]]:
    found = []
    last = state.last
    if last is not None and last.source is Source.LOST:
        found.append((ERROR, f'lost: {last.reason.value}; the pose must not be used'))
    elif state.recent_poor:
        found.append((WARN, f'pose only predicted: {_listing(state.recent_poor)}'))
    if last is not None and last.weak_direction is not None:
        text = f'nothing holds the position along {_weak_direction(last)} (axes of the cloud)'
        found.append((WARN, text))
    if last is not None and last.adrift:
        text = 'a new map has begun: poses are as far off as their covariance says, until ~/reset'
        found.append((WARN, text))
    if state.recent_drops:
        unasked = set(state.recent_drops) - {'paused', 'reset'}
        severe = 'internal_error' in unasked or (unasked and not state.processed)
        text = f'clouds dropped: {_listing(state.recent_drops)}; last: {state.last_drop}'
        found.append((ERROR if severe else WARN, text))
    if last is not None and last.load:
        found.append((WARN, f'behind its sensor: less is done per cloud (load {last.load})'))
    if state.note:
        found.append((WARN, state.note))
    return found


def _about_node(state: Snapshot, setting: Setting) -> list[tuple[bytes, str]]:
    found = []
    if not setting.has_weights:
        found.append((WARN, f'no weights, kiss-icp alone: {setting.weights}'))
    if setting.starting:
        found.append((WARN, f'starting, no cloud is taken yet: {setting.starting}'))
    elif setting.paused:
        found.append((WARN, 'paused'))
    elif state.idle_s > setting.input_timeout_s:
        found.append((WARN, f'no cloud for {state.idle_s:.1f} s on {setting.hardware_id}'))
    elif state.odometry_age_s > setting.input_timeout_s:
        text = f'no odometry for {state.odometry_age_s:.1f} s, although clouds come'
        told = state.recent_drops or not state.last_drop
        found.append((WARN, text if told else f'{text}; last: {state.last_drop}'))
    if setting.twins:
        found.append((ERROR, f'{setting.twins} more {TWINS}'))
    for name, state_of in setting.guides.items():
        if state_of.startswith('no '):
            found.append((WARN, f'without {name}: {state_of}'))
    if setting.waiting_for:
        found.append((WARN, setting.waiting_for))
    if setting.transport_warning:
        found.append((WARN, setting.transport))
    return found


def _listing(counts: Mapping[str, int]) -> str:
    return ', '.join(f'{n} {cause}' for cause, n in sorted(counts.items()))


def _told(result: OdometryResult) -> dict[str, str]:
    return {
        'source': result.source.value,
        'reason': result.reason.value,
        'confidence': f'{result.confidence:.6f}',
        'weak_direction': _weak_direction(result),
        'load': str(result.load),
        'deskewed': str(result.deskewed).lower(),
        'point_times': result.scan.times_from,
        **{f'{stage}_ms': f'{1e3 * s:.3f}' for stage, s in result.timings_s.items()},
    }


def _weak_direction(result: OdometryResult) -> str:
    """Direction along which nothing holds the position, axes of the cloud; 'none' if held."""
    if result.weak_direction is None:
        return 'none'
    return ' '.join(f'{v:.2f}' for v in result.pose[:3, :3].T @ result.weak_direction)


def status(state: Snapshot, setting: Setting) -> DiagnosticStatus:
    """Build the diagnostic status of this instant."""
    found = findings(state, setting)
    values = {
        **({'source': 'none', 'reason': 'none'} if state.last is None else _told(state.last)),
        'weights': setting.weights,
        'input_rate_hz': f'{state.input_rate_hz:.2f}',
        'received': str(state.received),
        'processed': str(state.processed),
        'dropped': str(sum(state.dropped.values())),
        **{f'dropped.{cause}': str(n) for cause, n in sorted(state.dropped.items())},
        **{f'poor.{reason}': str(n) for reason, n in sorted(state.poor.items())},
        'last_drop': state.last_drop or 'none',
        'invalid_points': str(state.invalid_points),
        'near_points': str(state.near_points),
        'odometry_age_s': f'{state.odometry_age_s:.1f}',
        'waiting': str(setting.queue),
        'latency_ms': f'{1e3 * state.latency_s:.1f}',
        'worst_latency_ms': f'{1e3 * state.worst_latency_s:.1f}',
        'last_switch': state.last_switch,
        'tf': setting.tf,
        **setting.guides,
        'transport': setting.transport,
    }
    return DiagnosticStatus(
        level=found[0][0] if found else OK,
        name=setting.name,
        message='; '.join(text for _, text in found) or 'ok',
        hardware_id=setting.hardware_id,
        values=[KeyValue(key=k, value=v) for k, v in values.items()],
    )


def to_array(state: Snapshot, setting: Setting, stamp: Time) -> DiagnosticArray:
    """Build the diagnostics message."""
    array = DiagnosticArray(status=[status(state, setting)])
    array.header.stamp = stamp
    return array


def of_frame(result: OdometryResult, name: str, stamp: Time) -> DiagnosticArray:
    """What one result says about itself: branch, reason, confidence, time per stage.

    Args:
        result: of one cloud.
        name: name of the status, with the node's name.
        stamp: of the cloud, by which the message is joined with the odometry.
    """
    values = {
        **_told(result),
        'keyframe': str(result.keyframe_id),
        'is_keyframe': str(result.is_keyframe).lower(),
    }
    status = DiagnosticStatus(
        level=ERROR if result.source is Source.LOST else OK,
        name=name,
        message=result.reason.value,
        values=[KeyValue(key=k, value=v) for k, v in values.items()],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp = stamp
    return array
