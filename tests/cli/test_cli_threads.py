# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""numpy works with one thread in our processes, unless asked for more; all share one heap."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.replay import session

COMMAND = "from hybridreg_ros.cli.main import main; main(['score', 'none.tum', 'none.tum'])"


@pytest.mark.parametrize('start', ['import hybridreg_ros.ros', COMMAND])
@pytest.mark.parametrize(('given', 'kept'), [(None, '1'), ('3', '3')])
def test_one_thread_unless_told(start: str, given: str | None, kept: str) -> None:
    env = {k: v for k, v in os.environ.items() if k != 'OPENBLAS_NUM_THREADS'}
    env |= {} if given is None else {'OPENBLAS_NUM_THREADS': given}
    code = f"import os; {start}; print(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run(
        [sys.executable, '-c', code], env=env, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-1] == kept


def test_threads_of_a_replay_share_one_heap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where its front end is made, so in the processes of --workers too."""
    asked: list[int] = []
    monkeypatch.setattr(session, 'one_heap', lambda: asked.append(1))
    session.open_front_end(OdometryConfig(registrar='kiss-icp'), None)
    assert asked == [1]
