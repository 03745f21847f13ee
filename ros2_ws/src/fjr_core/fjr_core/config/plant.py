# SPDX-License-Identifier: Apache-2.0
"""The plant node's own parameters, and the initial state of their values."""

from __future__ import annotations

from ..numerics.checks import Array
from ..numerics.integrators import INTEGRATORS
from ..robot.robot import Robot
from .nonidealities import imperfection_parameters
from .parameter import Parameter, Values, vector
from .process import process_parameters


def plant_parameters(n: int) -> list[Parameter]:
    """The plant node's own parameters for n joints."""
    return [
        Parameter("publish_rate", 1000.0, "Rate of /joint_states", "Hz", minimum=1.0, maximum=10000.0),
        Parameter("inner_steps", 4, "Integrator steps per published state", minimum=1, maximum=1000),
        Parameter("integrator", "rk4", "Integrator", choices=tuple(INTEGRATORS)),
        Parameter("initial_link_position", (0.5,) * n, "q_l at the start and after a reset", "rad"),
        Parameter("initial_motor_position", (0.5,) * n, "q_m at the start and after a reset", "rad"),
        Parameter("initial_link_velocity", (0.0,) * n, "dq_l at the start and after a reset", "rad/s"),
        Parameter("initial_motor_velocity", (0.0,) * n, "dq_m at the start and after a reset", "rad/s"),
        Parameter("wait_for_command", True, "Hold the initial state until the first command comes"),
        Parameter("command_timeout", 0.1, "Zero effort when commands stop for longer", "s", minimum=1e-3, maximum=1e3),
        Parameter("lockstep", False, "Advance one sample per stamped /joint_commands instead of with the clock"),
        Parameter("start_paused", False, "Publish nothing until ~/pause is called with false"),
        Parameter("publish_description", True, "Publish the robot as a URDF on robot_description, for viewers"),
        *plant_timing_parameters(),
        *imperfection_parameters(n),
        *process_parameters(),
    ]


def initial_state(values: Values, robot: Robot) -> Array:
    """The plant's initial state (4n,) of the values; raises ParameterError."""
    names = [f"initial_{side}_{what}" for what in ("position", "velocity") for side in ("link", "motor")]
    return robot.state(*(vector(values, name, robot.n) for name in names))


def plant_timing_parameters() -> list[Parameter]:
    """Return the parameters of the plant's lock-step, of its silence after a restart and of ~/advance."""
    return [
        Parameter(
            "lockstep_timeout",
            10.0,
            "Lock-step: end when a state is not answered for longer, from the first answer on; 0: wait for ever",
            "s",
            minimum=0.0,
            maximum=1e6,
        ),
        Parameter(
            "restart_silence",
            1.0,
            "Silence after a reset or a pause, longer than the controller's state_timeout; not in lock-step",
            "s",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "advance_samples",
            1,
            "Samples by which ~/advance moves a paused robot",
            minimum=1,
            maximum=1_000_000,
            dynamic=True,
        ),
    ]
