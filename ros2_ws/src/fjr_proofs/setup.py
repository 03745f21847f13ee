# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_proofs"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "error_bound/*.[ch]", "verification/*.[ch]"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["fjr_core", "casadi>=3.6.5", "numpy>=1.26", "scipy>=1.11"],
    extras_require={"commands": ["fjr_msgs_py[commands]"]},  # rclpy and messages: from ROS 2, or its wheels
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Proven rates, error bounds and contraction of the sampled loop, by verified numerics",
    license="Apache-2.0",
)
