# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Provenance: what a result was made with, so that it can be made again."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

PACKAGES = ('hybridreg_ros', 'numpy', 'torch', 'numba', 'kiss-icp', 'small_gicp', 'rosbags')
_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class Provenance:
    """Where a number comes from.

    Attributes:
        git_hash: commit of the source tree, with '+dirty' when it was changed; '' outside git.
        command: the command line.
        python: version of the interpreter.
        machine: processor architecture and system.
        versions: package name to version, '' when not installed.
        seed: random seed, -1 when none was used.
        config: the whole configuration as nested plain values.
        inputs: file name to SHA-256 of what was read.
    """

    git_hash: str
    command: str
    python: str
    machine: str
    versions: Mapping[str, str]
    seed: int = -1
    config: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain nested values for JSON or weights metadata."""
        return asdict(self)


def collect(
    config: Mapping[str, Any] | None = None,
    inputs: tuple[str | Path, ...] = (),
    seed: int = -1,
) -> Provenance:
    """Provenance of the running process.

    Args:
        config: configuration as plain values (`core.config.to_dict`).
        inputs: files whose checksum belongs to the result; of a folder, its files.
        seed: random seed of the run.

    Raises:
        OSError: an input cannot be read.
    """
    files = [f for path in inputs for f in _files(Path(path))]
    return Provenance(
        git_hash=git_hash(),
        command=' '.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        python=platform.python_version(),
        machine=f'{platform.machine()} {platform.system()}',
        versions={name: version(name) for name in PACKAGES},
        seed=seed,
        config=dict(config or {}),
        inputs={f.name: sha256(f) for f in files},
    )


def git_hash() -> str:
    """Commit of the tree this package is imported from, '+dirty' when changed, '' outside git."""
    here = Path(__file__).resolve().parent
    commit = _git(here, 'rev-parse', 'HEAD')
    if not commit:
        return ''
    return commit + ('+dirty' if _git(here, 'status', '--porcelain', '-uno') else '')


def version(package: str) -> str:
    """Installed version of a package, '' when it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ''


def sha256(path: str | Path) -> str:
    """SHA-256 of a file, hexadecimal; reads it in pieces.

    Raises:
        OSError: the file cannot be read.
    """
    digest = hashlib.sha256()
    with open(path, 'rb') as stream:
        while chunk := stream.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def _files(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]


def _git(folder: Path, *arguments: str) -> str:
    """Output of a git command, '' when git or the repository is missing."""
    try:
        done = subprocess.run(
            ['git', '-C', str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ''
    return done.stdout.strip() if done.returncode == 0 else ''
