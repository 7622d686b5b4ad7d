# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 node and the bag player; the only place that imports rclpy."""

import os

# Threads on numpy's small matrices cost a quarter of a registration; before numpy loads.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
