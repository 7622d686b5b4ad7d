# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Build and install description; the only home of the version and the entry points."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'hybridreg_ros'
HERE = Path(__file__).parent


def shared(folder: str, pattern: str = '*') -> tuple[str, list[str]]:
    """One data_files row: the files of a folder, installed below share/<package>."""
    files = sorted(str(p.relative_to(HERE)) for p in (HERE / folder).glob(pattern) if p.is_file())
    return (f'share/{PACKAGE}/{folder}', files)


setup(
    name=PACKAGE,
    version='0.2.0',
    description='Odometry and dynamic points from point clouds of scenes in which things move',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='The hybridreg_ros developers',
    maintainer='The hybridreg_ros developers',
    maintainer_email='maintainers@hybridreg.example',
    license='Apache-2.0',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={
        PACKAGE: [
            'py.typed',
            'model/weights/*.safetensors',
            'odometry/dynamics/*.npz',
            'odometry/selection/*.json',
            'ros/*.xml',
            'replay/*.json',
            'replay/page/*.html',
            'replay/page/*.js',
            'replay/page/*.css',
        ],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        shared('config'),
        shared('config/sensors'),
        shared('config/with'),
        shared('launch', '*.launch.py'),
        shared('rviz'),
    ],
    python_requires='>=3.11,<3.13',
    # Lower bounds were tried together; constraints.txt has the versions that `make test` installs.
    install_requires=[
        'numpy>=1.26.4,<3',
        'natsort>=8,<9',
        'numba>=0.61,<1',
        'pyyaml>=6.0.1,<7',
        'torch>=2.6,<3',
        'safetensors>=0.5,<1',
        'scipy>=1.11.4,<2',
        'kiss-icp>=1.3,<2',
    ],
    extras_require={
        'replay': [
            'rosbags>=0.11,<0.12',
            'mcap>=1.6,<2',
            'evo>=1.31',
            'tqdm',
            'pillow',
            'plotly>=6,<8',
            'argcomplete>=3',
        ],
        'data': ['embreex>=4', 'trimesh>=4.5', 'matplotlib>=3.8', 'pillow'],
        'ros': [
            'ros-jazzy-rclpy[fastrtps]>=7.1.6,<8',
            'ros-jazzy-common-interfaces>=5.3.6,<6',
        ],
        'docs': ['mkdocs>=1.6,<2', 'mkdocs-material>=9.6,<10', 'mkdocstrings[python]>=0.29'],
        'scale': ['dask>=2026.8', 'distributed>=2026.8'],
        'view': ['rerun-sdk>=0.24', 'imageio-ffmpeg>=0.6'],
        'bench': [
            'open3d-cpu>=0.20',
            'kiss-matcher>=1.0.2,<2',
            'genz-icp>=0.3.2,<1',
            'small_gicp>=1.0.1',
        ],
        'test': [
            'pytest>=8',
            'pytest-timeout',
            'hypothesis>=6.100',
            'ruff>=0.12',
            'codespell>=2.4',
            'mypy>=1.15',
            'types-PyYAML',
            'types-tqdm',
            'colcon-common-extensions>=0.3.0',
            'ipykernel>=6.29',
            'nbclient>=0.10',
        ],
    },
    zip_safe=False,
    entry_points={
        'console_scripts': [
            'hybridreg = hybridreg_ros.cli.main:main',
            'odometry_node = hybridreg_ros.ros.odometry_node:main',
            'bag_player = hybridreg_ros.ros.playback.bag_player:main',
        ],
    },
)
