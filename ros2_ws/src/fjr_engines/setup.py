# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_engines"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "native/*.[ch]"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["fjr_core", "fjr_plant", "casadi>=3.6.5", "numpy>=1.26"],
    extras_require={
        "commands": ["fjr_design[commands]"],
        "mujoco": ["mujoco>=3.17"],
        "drake": ["drake>=1.40"],
    },  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Simulators of others behind the topics of the plant, and robots in their formats",
    license="Apache-2.0",
    entry_points={
        "fjr.engines": [
            "mujoco = fjr_engines.mujoco:MujocoEngine",
            "drake = fjr_engines.drake:DrakeEngine",
        ],
    },
)
