# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Shared-memory transport for FastDDS, large enough for full-size clouds; applied by default."""

from __future__ import annotations

import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import MutableMapping

PROFILE = Path(__file__).with_name('fastdds_shm.xml')
SWITCH = 'HYBRIDREG_FASTDDS'
"""Environment variable: 'off' leaves FastDDS as it is."""

_FILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_MIB = 1 << 20
_SEGMENTS_MIB = (64, 32, 16)
_SHARE = 3  # player, node and one more participant must fit into /dev/shm


@dataclass(frozen=True)
class Transport:
    """What was decided about the transport.

    Attributes:
        profile: the XML file in use, or None when FastDDS keeps its own settings.
        reason: one line that says why.
        warning: True when full-size clouds may be lost with best-effort QoS.
    """

    profile: Path | None
    reason: str
    warning: bool = False


def prepare(
    environ: MutableMapping[str, str] | None = None, shared_memory: Path = Path('/dev/shm')
) -> Transport:
    """Point FastDDS to the packaged profile. Call it before `rclpy.init`.

    A profile file set by the user, another RMW, or HYBRIDREG_FASTDDS=off is respected.

    Args:
        environ: variables to read and to set, default those of this process.
        shared_memory: mount point of POSIX shared memory.
    """
    env = os.environ if environ is None else environ
    chosen = next((env[name] for name in _FILE_VARIABLES if env.get(name)), None)
    if chosen is not None and Path(chosen).name.startswith(PROFILE.stem):
        return Transport(Path(chosen), f'FastDDS shared memory, {Path(chosen).name}')
    if chosen is not None:
        return Transport(Path(chosen), f'FastDDS profile of the environment: {chosen}')
    rmw = env.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
    if 'fastrtps' not in rmw:
        return Transport(None, f'{rmw} brings its own transport')
    if env.get(SWITCH, 'on').lower() in ('off', '0', 'false', 'no'):
        reason = f'{SWITCH}={env[SWITCH]}: FastDDS default transport, large clouds may be lost'
        return Transport(None, reason, warning=True)
    free = _free_mib(shared_memory)
    size = next((s for s in _SEGMENTS_MIB if s * _SHARE <= free), None)
    if size is None:
        reason = (
            f'{shared_memory} has {free} MiB free, expected at least '
            f'{_SEGMENTS_MIB[-1] * _SHARE}: FastDDS default transport, large clouds may be lost; '
            f'enlarge it (docker: --shm-size=256m) or set input_qos to reliable'
        )
        return Transport(None, reason, warning=True)
    path = PROFILE if size == _SEGMENTS_MIB[0] else _smaller_profile(size)
    for name in _FILE_VARIABLES:
        env[name] = str(path)
    return Transport(path, f'FastDDS shared memory, segment of {size} MiB')


def _free_mib(mount: Path) -> int:
    """Free space of a mount in MiB; 0 when it does not exist."""
    try:
        status = os.statvfs(mount)
    except OSError:
        return 0
    return status.f_bavail * status.f_frsize // _MIB


def _smaller_profile(size_mib: int) -> Path:
    """Write the profile with another segment size to the temporary folder."""
    text = PROFILE.read_text(encoding='utf-8')
    text = re.sub(r'(?<=<segment_size>)\d+', str(size_mib * _MIB), text)
    text = re.sub(r'(?<=<maxMessageSize>)\d+', str(size_mib * _MIB // 4), text)
    folder = Path(tempfile.mkdtemp(prefix='hybridreg_'))
    path = folder / f'fastdds_shm_{size_mib}.xml'
    path.write_text(text, encoding='utf-8')
    return path
