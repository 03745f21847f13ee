# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_controller"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "native/*.[ch]"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"lib/{package_name}", ["scripts/controller_node", "scripts/controller_node.py"]),
    ],
    python_requires=">=3.10",
    install_requires=[
        "fjr_core",
        "fjr_msgs_py",
        "fjr_monitor",
        "casadi>=3.6.5",
        "numpy>=1.26",
    ],  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="The v-dPBC tracking controller as a ROS 2 node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["controller_node = fjr_controller.executable:main"]},
)
