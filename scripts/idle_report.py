# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""CPU time that a node takes while no cloud comes, thread by thread.

python scripts/idle_report.py --seconds 60
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.flow import Flow
from hybridreg_ros.ros.playback.live import own_node
from hybridreg_ros.ros.playback.node_process import NodeProcess
from hybridreg_ros.ros.playback.playing import spinning

_SETTLED_S = 3.0


def cpu_s(pid: int) -> dict[str, float]:
    """CPU seconds so far of each thread of a process, by number and name."""
    found = {}
    for task in Path(f'/proc/{pid}/task').iterdir():
        name = (task / 'comm').read_text('utf-8').strip()
        found[f'{task.name} {name}'] = (
            int((task / 'schedstat').read_text('ascii').split()[0]) / 1e9
        )
    return found


def main() -> int:
    """Print share of one core by thread, and the sum."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', maxsplit=1)[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument(
        '--qos', default='sensor_data', choices=('sensor_data', 'reliable', 'auto')
    )
    args = parser.parse_args()
    space, domain = f'/idle_{os.getpid()}', 1 + os.getpid() % 99
    process = NodeProcess((OdometryConfig(), NodeConfig(input_qos=args.qos)), space, domain)
    with process, own_node(space, domain) as node:
        flow = Flow(node, 'hybridreg', window=0)
        with spinning(node):
            process.wait_until(
                lambda: flow.seen and 'starting' not in flow.message, 300.0, 'the node'
            )
        time.sleep(_SETTLED_S)
        before = cpu_s(process.pid)
        time.sleep(args.seconds)
        after = cpu_s(process.pid)
    shares = {n: (s - before.get(n, 0.0)) / args.seconds for n, s in after.items()}
    for name, share in sorted(shares.items(), key=lambda item: -item[1]):
        if share > 1e-5:
            print(f'{100 * share:7.3f} %  {name}')
    print(f'{100 * sum(shares.values()):7.3f} %  of one core')
    return 0


if __name__ == '__main__':
    sys.exit(main())
