# SPDX-License-Identifier: Apache-2.0
"""Write the files of the package for ros2_control."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from xml.sax.saxutils import escape

import casadi as ca
import yaml

from fjr_core.config.scenario import Scenario
from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import AsSampledLaw
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate
from fjr_core.monitoring.thresholds import LONGEST
from fjr_core.numerics.checks import MOTOR, Array
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.version import __version__

from ..c_code import comment, number, numbers
from ..filled_template import filled
from ..recorded_steps import as_text, recorded_steps
from ..step_code import Controller, controller_of, step_code
from .arm import Arm, arm_of, not_exported
from .parameter_tables import arm_rows, controller_rows, event_table, gain_table, plant_table, wiring_table
from .urdf import with_hardware

SAMPLES = 400
LONGEST_NAME = 60
CERTIFIED = ("V", "H", "dissipation", "dissipated", "u_law", "drive")
"""Outputs of the certificate's function that fjr_certify reads; the last, its gradient, would double the code."""
FILES = {
    "package.xml": "package.xml",
    "CMakeLists.txt": "CMakeLists.txt",
    "README.md": "README.md",
    "controller.xml": "controller.xml",
    "hardware.xml": "hardware.xml",
    "step.hpp": "src/step.hpp",
    "casadi_function.hpp": "src/casadi_function.hpp",
    "certificate.hpp": "src/certificate.hpp",
    "events.hpp": "src/events.hpp",
    "queue.hpp": "src/queue.hpp",
    "reports.hpp": "src/reports.hpp",
    "reports.cpp": "src/reports.cpp",
    "parameters.hpp": "src/parameters.hpp",
    "parameters.cpp": "src/parameters.cpp",
    "tracking_controller.hpp": "src/tracking_controller.hpp",
    "tracking_controller.cpp": "src/tracking_controller.cpp",
    "delay_line.hpp": "src/delay_line.hpp",
    "elastic_arm.hpp": "src/elastic_arm.hpp",
    "elastic_arm.cpp": "src/elastic_arm.cpp",
    "controllers.yaml": "config/controllers.yaml",
    "launch.py": "launch/{package}.launch.py",
    "step_replay.hpp": "test/step_replay.hpp",
    "test_step.cpp": "test/test_step.cpp",
}
"""Templates and the files that they become."""


def package_name_of(scenario: str) -> str:
    """Convert the name of a scenario to that of a package: "Arm-7 b" gives arm_7_b_ros2_control."""
    plain = re.sub(r"[^a-z0-9]+", "_", scenario.lower()).strip("_")
    return f"{plain if plain[:1].isalpha() else f'robot_{plain}'.rstrip('_')}_ros2_control"


def export_package(scenario: Scenario, package: str, samples: int = SAMPLES) -> dict[str, str]:
    """Return the texts of all files by their path in the package.

    Raises ParameterError for an invalid name of the package, StateError for a law or plant in Python and for a loop
    that diverges within the samples of the test, TrajectoryError for a reference that is not built in.
    """
    if not re.fullmatch(r"[a-z](_?[a-z0-9])*", package) or len(package) > LONGEST_NAME:
        raise ParameterError(
            f"package is '{package}'; expected a lower-case letter, then letters, digits or single '_', "
            f"at most {LONGEST_NAME}"
        )
    controller, arm = controller_of(scenario), arm_of(scenario)
    functions = {**_certificate(controller), **arm.functions}
    texts = {f"step/{name}": text for name, text in step_code(controller, functions).items()}
    values = _values(scenario, controller, arm, package) | {"samples": str(samples)}
    texts |= {
        path.format(package=package): filled(name, values, "ros2_control/templates") for name, path in FILES.items()
    }
    parameters = {
        "initial_link_position": tuple(arm.start[: controller.n].tolist()),
        "initial_motor_position": tuple(arm.start[controller.n :].tolist()),
        **arm.given,
    }
    texts[f"urdf/{package}.urdf"] = with_hardware(arm.urdf, package, controller.joints, values["clock"], parameters)
    inner_steps = round(scenario.sample_period * 1e9 / arm.inner_step)
    steps = recorded_steps(controller, scenario.plant, scenario.x0, inner_steps, samples)
    return texts | {"test/case.txt": as_text(steps)}


def _certificate(controller: Controller) -> dict[str, ca.Function]:
    """Return the function of the certificate with the outputs of CERTIFIED, if the law has one."""
    law = controller.certified_law
    if law is None:
        return {}
    function = Certificate(law).function
    outputs = [function.index_out(name) for name in CERTIFIED]
    return {"certificate": function.slice("certificate", list(range(function.n_in())), outputs)}


def _values(scenario: Scenario, controller: Controller, arm: Arm, package: str) -> dict[str, str]:
    """Return the values of the names in the templates."""
    joints = controller.joints
    motors = [f"{joint}{MOTOR}" for joint in joints]
    chained = [f"tracking_controller/{joint}" for joint in joints]
    return {
        "package": package,
        "PACKAGE": package.upper(),
        "title": comment(scenario.name),
        "title_xml": escape(scenario.name),
        "version": __version__,
        "rate": str(round(1 / controller.sample_period)),
        "clock": f"{package}_clock",
        "joint_yaml": _yaml(joints),
        "motor_yaml": _yaml(motors),
        "chained_yaml": _yaml(chained),
        "inner_step": number(arm.inner_step),
        **_certificate_values(scenario, controller),
        **_plant_values(arm),
        **gain_table(controller),
        "kinds": event_table(),
        "wiring_sentences": wiring_table(),
        "controller_rows": controller_rows(),
        "arm_rows": arm_rows(),
        "not_exported": _left_out(scenario),
    }


def _yaml(names: Sequence[str]) -> str:
    """Format names as a list of YAML on one line."""
    return str(yaml.safe_dump(list(names), default_flow_style=True, allow_unicode=True, width=math.inf)).strip()


def _certificate_values(scenario: Scenario, controller: Controller) -> dict[str, str]:
    """Return the values of certificate.hpp; without a certificate its function is never called."""
    law, robot = controller.certified_law, controller.law.robot
    name = "fjr_casadi_certificate"
    declaration = f"int {name}(const double ** arg, double ** res, long long int * iw, double * w, int mem);"
    return {
        "certificate_declaration": declaration if law else "",
        "certificate_function": name if law else "nullptr",
        "certified": "true" if law else "false",
        "bounded": "1" if law and isinstance(controller.sampled_law, AsSampledLaw) else "0",
        "beta": number(law.rate(_configurations(scenario, law)).beta if law else 0.0),
        "longest": number(LONGEST),
        "B_numbers": numbers(robot.B_m),
    }


def _configurations(scenario: Scenario, law: TrackingLaw) -> Array | None:
    """Return the configurations at which the rate is evaluated; None where it is proven."""
    return None if law.robot.links.M_l_vertices is not None else scenario.configurations()


def _plant_values(arm: Arm) -> dict[str, str]:
    """Return the values of elastic_arm.cpp; the parameters of the scenario are in the tag."""
    ideal = Imperfections(arm.plant.robot.n).vector
    return {
        "parameters": str(len(ideal)),
        "plant_table": plant_table(arm),
        "plant_numbers": numbers(ideal).replace("INFINITY", "HUGE_VAL"),
        "start_numbers": numbers(arm.start),
    }


def _left_out(scenario: Scenario) -> str:
    """Describe in Markdown what the scenario asks of its plant that the arm does not have."""
    names = ", ".join(f"`{name}`" for name in not_exported(scenario))
    return f"\nThe scenario also sets {names}: not in this arm.\n" if names else ""
