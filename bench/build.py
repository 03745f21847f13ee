# SPDX-License-Identifier: Apache-2.0
"""Time to build law, certificate, prediction and plant for arms of 2 to 12 joints with an empty cache.

Times are processor times of this process and its C compilers, which run one after the other: wall times on a free core.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from tempfile import TemporaryDirectory
from unittest.mock import patch

import casadi as ca
import numpy as np

from bench.figures import Figure, one_core
from fjr_core import Gains, Plant, TrackingLaw, robot_from_urdf
from fjr_core.monitoring.certificate import Certificate, Prediction
from fjr_core.numerics.jit import compiled

JOINTS = (2, 4, 6, 7, 8, 10, 12)
GAINS = Gains(Lambda_l=8.0, Pi_l=20.0, K_ld=10.0, Lambda_m=20.0, Pi_m=200.0, K_md=2.0)
BOUND = 10.0  # s, law of 12 joints
DERIVED, COMPILED, OPERATIONS = "derivation [s]", "C and compiler [s]", "operations"
LARGEST_RATIO = 2.5  # operations of the certificate, which contains the law, relative to those of the law
LINK = """<link name="link{i}"><inertial><origin xyz="{com}"/><mass value="2.0"/>
  <inertia ixx="0.03" iyy="0.025" izz="0.02" ixy="0.002" ixz="-0.001" iyz="0.003"/></inertial></link>
"""
JOINT = """<joint name="joint{i}" type="continuous"><origin xyz="{xyz}" rpy="{rpy}"/>
  <parent link="link{parent}"/><child link="link{i}"/><axis xyz="0 0 1"/></joint>
"""


def arms() -> list[Figure]:
    """Measure arms of all sizes."""
    return [figure for n in JOINTS for figure in _arm(n)]


def _arm(n: int) -> Iterator[Figure]:
    with one_core(), TemporaryDirectory() as cache, patch.dict(os.environ, {"XDG_CACHE_HOME": cache}):
        start = _processor_time()
        robot = robot_from_urdf(chain_urdf(n), joint_names(n), stiffness=5000.0, motor_inertia=0.3)
        law = TrackingLaw(robot, GAINS)
        loaded = _processor_time() - start
        plant = Plant(robot, compile=True)
        functions: dict[str, Callable[[], ca.Function]] = {  # that `fjr run` compiles before it starts the nodes
            "law": lambda: law.measured_expression,
            "certificate": lambda: Certificate(law).function,
            "prediction": lambda: Prediction(law).function,
            "plant": lambda: plant.step_function,
        }
        parts = {name: _built(build) for name, build in functions.items()}
    seconds = {name: part[DERIVED] + part[COMPILED] for name, part in parts.items()}
    to_law, bound = loaded + seconds["law"], BOUND if n == max(JOINTS) else None
    yield Figure(f"{n} joints, URDF to law, nothing cached", to_law, "s", bound, parts=parts["law"])
    certificate = parts["certificate"]
    yield Figure(f"{n} joints, certificate, nothing cached", seconds["certificate"], "s", parts=certificate)
    yield Figure(f"{n} joints, law, certificate, prediction and plant", loaded + sum(seconds.values()), "s")
    ratio = certificate[OPERATIONS] / parts["law"][OPERATIONS]
    yield Figure(f"{n} joints, operations of the certificate / law", ratio, "", bound=LARGEST_RATIO)


def _built(build: Callable[[], ca.Function]) -> dict[str, float]:
    """Return the processor time to derive a function and to compile it, and its number of operations."""
    start = _processor_time()
    function = build()
    derived = _processor_time()
    if function.class_name() != "External" and compiled(function).class_name() != "External":
        raise RuntimeError(f"{function.name()} was not compiled; expected a C compiler")
    operations = function.n_instructions() if function.is_a("SXFunction") else 0
    return {DERIVED: derived - start, COMPILED: _processor_time() - derived, OPERATIONS: operations}


def _processor_time() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def joint_names(n: int) -> list[str]:
    """Return the names of the n joints from base to tip."""
    return [f"joint{i}" for i in range(1, n + 1)]


def chain_urdf(n: int) -> str:
    """Return the URDF: no joint axes are parallel or intersect, so that no term of the dynamics vanishes."""
    random = np.random.default_rng(12)
    parts = ['<robot name="chain">\n<link name="link0"/>\n']
    for i in range(1, n + 1):
        vectors = (random.uniform(-size, size, 3) for size in (0.05, 0.2, 1.5))
        com, xyz, rpy = (" ".join(f"{value:.4f}" for value in vector) for vector in vectors)
        parts += [LINK.format(i=i, com=com), JOINT.format(i=i, parent=i - 1, xyz=xyz, rpy=rpy)]
    return "".join([*parts, "</robot>\n"])
