# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The front end: scans in, poses, confidence and dynamic probability out. No ROS here."""
