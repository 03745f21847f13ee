# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from runpy import run_path

from setuptools import find_packages, setup

package_name = "fjr_core"
version = run_path(str(Path(__file__).parent / package_name / "version.py"))["__version__"]
extras = {
    "tables": ["pyarrow>=15"],  # motions in Parquet
    "plot": ["matplotlib>=3.6"],
}

setup(
    name=package_name,
    version=version,
    packages=find_packages(),
    package_data={
        package_name: [
            "py.typed",
            "__init__.pyi",
            "runtime/*.[ch]",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["numpy>=1.26", "scipy>=1.11", "casadi>=3.6.5", "PyYAML>=6.0.1", "cffi>=1.17"],
    extras_require={
        **extras,
        "all": sorted(sum(extras.values(), [])),
        "compiler": ["ziglang>=0.13"],
        "sweep": extras["tables"],  # the earlier name, for one version
    },
    zip_safe=True,
    maintainer="The fjr authors",
    maintainer_email="fjr@example.org",
    description="Mathematics of virtual differential passivity based control for flexible-joint robots, without ROS",
    license="Apache-2.0",
)
