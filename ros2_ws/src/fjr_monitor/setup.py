# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_monitor"
setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "report/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["fjr_core", "casadi>=3.6.5", "numpy>=1.26"],
    extras_require={
        "commands": [
            "fjr_msgs_py[commands]",
            "PyYAML>=6.0.1",
            "click>=8.2",
            "jinja2>=3.1",
            "jupyter-threejs-sage>=130",
            "mcap>=1.1",
            "rich>=13",
            "rosbags>=0.10",
            "scipy>=1.11",
            "uplot-python>=1.1",
        ],
        "plot": ["matplotlib>=3.6"],
    },  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Diagnosis, recording, metrics, reports and displays of a running or recorded loop",
    license="Apache-2.0",
    entry_points={"fjr.commands": ["monitor = fjr_monitor.cli.commands"]},
)
