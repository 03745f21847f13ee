# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_design"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={
        package_name: ["py.typed", "batch/*.[ch]", "exports/*/*.in", "exports/*/*/*.in", "exports/*/*/*/*.in"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["fjr_core", "casadi>=3.6.5", "numpy>=1.26", "scipy>=1.11"],
    extras_require={
        "commands": [
            "fjr_msgs_py[commands]",
            "fjr_monitor[commands]",
            "PyYAML>=6.0.1",
            "click>=8.2",
            "cma>=4.0",
            "jinja2>=3.1",
            "pyarrow>=15",
            "tqdm>=4.66",
        ],
        "plot": ["matplotlib>=3.6"],
    },  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Check, synthesis and tuning of gains, laws to compare with, studies by simulation and exported code",
    license="Apache-2.0",
    entry_points={
        "fjr.commands": ["design = fjr_design.cli.commands"],
        "fjr.laws": ["baselines = fjr_design.baselines.kinds:BASELINES"],
    },
)
