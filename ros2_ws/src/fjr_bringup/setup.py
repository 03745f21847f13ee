# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

package_name = "fjr_bringup"
setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"lib/{package_name}", ["scripts/lib/fjr"]),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
        (f"share/{package_name}/scenarios", glob("scenarios/*.yaml")),
        (f"share/{package_name}/sweeps", glob("sweeps/*.yaml")),
        (f"share/{package_name}/suites", glob("suites/*.yaml")),
        (f"share/{package_name}/robots", [*glob("robots/*.yaml"), *glob("robots/*.urdf")]),
        (f"share/{package_name}/config", glob("config/*")),
        ("bin", ["scripts/fjr"]),
    ],
    python_requires=">=3.10",
    install_requires=[
        "fjr_core[tables]",
        "fjr_msgs_py[commands]",
        "fjr_monitor[commands]",
        "fjr_plant",
        "fjr_controller",
        "fjr_design[commands]",
        "PyYAML>=6.0.1",
        "click>=8.2",
        "numpy>=1.26",
    ],  # rclpy and messages: from ROS 2, or its wheels
    extras_require={
        "all": ["fjr_identification[commands]", "fjr_proofs[commands]", "fjr_engines[commands]"],
        "plot": ["matplotlib>=3.6"],
    },
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Scenarios, launch files, runner and the fjr command",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["fjr = fjr_bringup.cli.app:program"],
        "fjr.commands": ["bringup = fjr_bringup.cli.commands"],
    },
)
