# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "fjr_identification"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["py.typed", "estimation/*.[ch]"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=[
        "fjr_core",
        "fjr_msgs_py",
        "fjr_monitor[all]",
        "fjr_design",
        "casadi>=3.6.5",
        "click>=8.2",
        "mcap>=1.1",
        "numpy>=1.26",
        "pyarrow>=15",
        "scipy>=1.11",
    ],
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Excite a robot, identify it from recorded motion and write its robot file",
    license="Apache-2.0",
    entry_points={"fjr.commands": ["identification = fjr_identification.cli.commands"]},
)
