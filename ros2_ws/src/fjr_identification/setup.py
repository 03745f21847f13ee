# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_identification"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "estimation/*.[ch]", "templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["fjr_core", "fjr_design", "casadi>=3.6.5", "numpy>=1.26", "scipy>=1.11"],
    extras_require={
        "commands": [
            "fjr_msgs_py[commands]",
            "fjr_monitor[commands]",
            "fjr_design[commands]",
            "click>=8.2",
            "jinja2>=3.1",
            "mcap>=1.1",
            "pyarrow>=15",
        ]
    },  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Excite a robot, identify it from recorded motion and write its robot file",
    license="Apache-2.0",
    entry_points={"fjr.commands": ["identification = fjr_identification.cli.commands"]},
)
