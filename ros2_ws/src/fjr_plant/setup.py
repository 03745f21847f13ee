# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_plant"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "native/*.[ch]"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"lib/{package_name}", ["scripts/plant_node", "scripts/plant_node.py"]),
    ],
    python_requires=">=3.10",
    install_requires=["fjr_core", "fjr_msgs_py", "numpy>=1.26"],  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Simulated flexible-joint robot as a ROS 2 node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["plant_node = fjr_plant.executable:main"]},
)
