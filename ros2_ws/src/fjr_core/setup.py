# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_core"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "simulation/batch/*.c", "codegen/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Mathematics of virtual differential passivity based control for flexible-joint robots, without ROS",
    license="Apache-2.0",
)
