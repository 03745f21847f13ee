# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_msgs_py"

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
    install_requires=["fjr_core", "numpy>=1.26", "cffi>=1.17"],  # rclpy and messages: from ROS 2, or its wheels
    extras_require={"commands": ["PyYAML>=6.0.1", "click>=8.2", "tqdm>=4.66"]},  # what the commands of fjr share
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Shared ROS interface: names, QoS, parameters, messages to and from NumPy",
    license="Apache-2.0",
)
