# SPDX-License-Identifier: Apache-2.0
"""Public robots of the survey: a name, the distribution that holds the URDF, and the path in it."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

EXAMPLE = "cmeel.prefix/share/example-robot-data/robots"
AIRO, XACRO = "airo_models", "rtbdata/xacro"


@dataclass(frozen=True)
class PublicRobot:
    """A robot: its name, the distribution with its URDF, the path there, and the options that `fjr new` gets."""

    name: str
    package: str
    path: str
    options: tuple[str, ...] = ()

    @property
    def urdf(self) -> Path:
        """Path of the URDF; raises PackageNotFoundError if the distribution is not installed."""
        return Path(str(distribution(self.package).locate_file(self.path)))


def _example(name: str, path: str, *options: str) -> PublicRobot:
    return PublicRobot(name, "example-robot-data", f"{EXAMPLE}/{path}", options)


def _rtb(name: str, path: str) -> PublicRobot:
    return PublicRobot(name, "rtb-data", f"{XACRO}/{path}")


ROBOTS = (
    PublicRobot("Universal Robots UR3e", "airo-models", f"{AIRO}/arms/ur3e/ur3e.urdf"),
    PublicRobot("Universal Robots UR5e", "airo-models", f"{AIRO}/arms/ur5e/ur5e.urdf"),
    _example("Universal Robots UR10", "ur_description/urdf/ur10_robot.urdf"),
    _example("Franka Panda", "panda_description/urdf/panda.urdf"),
    _example("UFACTORY xArm 7", "xarm_description/urdf/xarm7.urdf"),
    _rtb("KUKA KR 16-2", "kuka_description/kuka_kr16/urdf/kr16_2.urdf"),
    _rtb("ABB IRB 140", "abb_irb140_description/urdf/irb140.urdf"),
    _rtb("Unimation Puma 560", "unimation_puma560_description/urdf/puma560_robot.urdf"),
    _rtb("KUKA LBR iiwa 14", "kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf"),
    _example("SO-ARM100", "so_arm_description/urdf/so100.urdf"),
    _example("SO-ARM101", "so_arm_description/urdf/so101.urdf"),
    _example("Kinova Jaco 2", "kinova_description/robots/kinova.urdf"),
    _example("Unitree Z1", "z1_description/urdf/z1.urdf"),
    _rtb("Lynxmotion AL5D", "lynxmotion_al5d_description/urdf/al5d_robot.urdf"),
    _example("Unitree A1, a leg", "a1_description/urdf/a1.urdf"),
    _example("Unitree Go2, a leg", "go2_description/urdf/go2.urdf"),
    _example("HyQ, a leg", "hyq_description/robots/hyq_no_sensors.urdf"),
    _example("Solo 12, a leg", "solo_description/robots/solo12.urdf"),
    _example("Bolt, a leg", "bolt_description/robots/bolt.urdf"),
    _example("Two joints (ASR)", "asr_twodof_description/urdf/TwoDofs.urdf"),
    _example("Double pendulum", "double_pendulum_description/urdf/double_pendulum.urdf"),
    _example("Borinot arm 2", "borinot_description/urdf/borinot_flying_arm_2.urdf"),
    _example("Hextilt arm 5", "hextilt_description/urdf/hextilt_flying_arm_5.urdf"),
    _example("Allegro hand", "allegro_hand_description/urdf/allegro_left_hand.urdf"),
    _example("PAL TALOS, left arm", "talos_data/robots/talos_left_arm.urdf"),
    _example("Rethink Baxter", "baxter_description/urdf/baxter.urdf"),
    _example("Simple humanoid", "simple_humanoid_description/urdf/simple_humanoid.urdf"),
    _rtb("KUKA KR 210", "kuka_description/kuka_kr210/urdf/kr210l150.urdf"),
    _rtb("KUKA KR 120", "kuka_description/kuka_kr120/urdf/kr120r2500pro.urdf"),
    _example("IIT Centauro", "centauro_description/urdf/centauro.urdf"),
    _example("ANYmal B with Kinova arm", "anymal_b_simple_description/robots/anymal-kinova.urdf"),
    _example("Willow Garage PR2", "pr2_description/urdf/pr2.urdf"),
    _example("PAL TIAGo Pro", "tiago_pro_description/robots/tiago_pro.urdf"),
    _example("Aldebaran Romeo", "romeo_description/urdf/romeo_small.urdf"),
    _example("Unitree G1", "g1_description/urdf/g1_29dof_rev_1_0.urdf"),
    _example("iCub", "icub_description/robots/icub_reduced.urdf"),
)
