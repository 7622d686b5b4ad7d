# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""NodeProcess: the real odometry node in a process of its own, found by nobody else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from hybridreg_ros.core.config import to_dict
from hybridreg_ros.core.errors import HybridRegError

if TYPE_CHECKING:
    from collections.abc import Mapping

LOCALHOST = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


def waits_for_signals(pid: int) -> bool:
    """Whether an executable of this package has come as far as to take signals.

    Before, while the interpreter starts (a tenth of a second), the system's defaults hold.
    """
    text = Path(f'/proc/{pid}/status').read_text(encoding='utf-8')
    blocked = next(line for line in text.splitlines() if line.startswith('SigBlk:'))
    return bool(int(blocked.split()[1], 16) >> (signal.SIGINT - 1) & 1)


class NodeProcess:
    """Starts odometry_node with a config and ends it; use it as a context manager."""

    def __init__(
        self,
        configs: tuple[Any, ...],
        namespace: str,
        domain_id: int,
        extra: Mapping[str, str] | None = None,
        managed: bool = False,
    ) -> None:
        """Say what to start.

        Args:
            configs: OdometryConfig and NodeConfig; they become a parameter file.
            namespace: ROS namespace of the node, with leading '/'.
            domain_id: ROS domain.
            extra: further environment variables.
            managed: whether it is the managed node.
        """
        self._configs = configs
        self._namespace, self._managed = namespace, managed
        self._environment = {
            **os.environ,
            **LOCALHOST,
            'ROS_DOMAIN_ID': str(domain_id),
            **(extra or {}),
        }
        self._folder = tempfile.TemporaryDirectory(prefix='hybridreg_node_')
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def log(self) -> Path:
        """File with everything the node wrote."""
        return Path(self._folder.name) / 'node.log'

    @property
    def pid(self) -> int:
        """Process id, 0 before the start."""
        return 0 if self._process is None else self._process.pid

    def __enter__(self) -> NodeProcess:
        """Start the process."""
        parameters = Path(self._folder.name) / 'parameters.yaml'
        values: dict[str, Any] = {}
        for config in self._configs:
            values.update(to_dict(config))
        content = {'/**': {'ros__parameters': values}}
        parameters.write_text(yaml.safe_dump(content), encoding='utf-8')
        command = [
            sys.executable,
            '-m',
            'hybridreg_ros.ros.odometry_node',
            *(['--managed'] if self._managed else []),
            '--ros-args',
            '--params-file',
            str(parameters),
            '-r',
            f'__ns:={self._namespace}',
        ]
        with self.log.open('wb') as log:
            self._process = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
            )
        return self

    def __exit__(self, *_: object) -> None:
        """End the process and remove its folder."""
        self.stop()
        self._folder.cleanup()

    def stop(self, timeout_s: float = 10.0) -> int:
        """Interrupt the node as Ctrl-C does; returns its exit code."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        return self.ended(timeout_s)

    def ended(self, timeout_s: float) -> int:
        """Exit code of the node; it is killed when it does not end within the time."""
        if self._process is None:
            return 0
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        return self._process.returncode

    def check(self) -> None:
        """Make sure that the node is alive.

        Raises:
            HybridRegError: it ended; the message quotes its last line.
        """
        if self._process is not None and self._process.poll() is not None:
            raise HybridRegError(
                f'odometry_node exited with code {self._process.returncode}: {self.last_line()}'
            )

    def last_line(self) -> str:
        """Last line the node wrote."""
        lines = self.log.read_text(encoding='utf-8', errors='replace').strip().splitlines()
        return lines[-1] if lines else 'no output'

    def wait_until(self, condition: Any, timeout_s: float, what: str) -> None:
        """Wait for a condition while the node lives.

        Args:
            condition: called without arguments until it is true.
            timeout_s: longest wait.
            what: for the error text.

        Raises:
            HybridRegError: the node ended, or the time is over.
        """
        end = time.monotonic() + timeout_s
        while not condition():
            self.check()
            if time.monotonic() > end:
                raise HybridRegError(
                    f'waited {timeout_s:g} s for {what}; last line of the node: {self.last_line()}'
                )
            time.sleep(0.01)
