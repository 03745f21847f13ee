# SPDX-License-Identifier: Apache-2.0
"""Real time: robot time follows the steady clock or, with use_sim_time, an external /clock. See real_time.c."""

from __future__ import annotations

from std_msgs.msg import Float64MultiArray

from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import deserialised
from fjr_msgs_py.node.parameters import ParameterNode
from fjr_msgs_py.node.reports import Health

from .channel import Transport
from .host import RclpyPlantHost
from .native import NO_TIME
from .simulated_robot import SimulatedRobot
from .time_base import TimeBase, steady


class RealTime(TimeBase):
    """Time base that applies /effort_controller/commands at once and publishes a state at every tick of the clock.

    Robot time stands still until the first command (wait_for_command), while paused, and while the clock stands still
    or is 0. After a reset or a pause no state is published for restart_silence.
    """

    moving = "moving: the first command has arrived"

    def __init__(self, node: ParameterNode, robot: SimulatedRobot, transport: Transport, health: Health) -> None:
        super().__init__(node, robot, transport, health)
        plant, values, lib = self.plant, node.values, self._lib
        plant.simulated = bool(node.get_parameter("use_sim_time").value)
        plant.wait_for_command = values["wait_for_command"]
        plant.silence = round(values["restart_silence"] * 1e9)
        command, tick = lib.fjr_real_time_command, lib.fjr_real_time_tick
        self._serve(Float64MultiArray, names.EFFORT_COMMANDS, command, tick, bool(plant.simulated))
        lib.fjr_real_time_catch_up(plant, self._now())  # start the clock
        self.host.start()

    @property
    def origin(self) -> int | None:
        """Clock time of robot time 0 [ns]; None while that stands still."""
        return None if self.plant.origin == NO_TIME else int(self.plant.origin)

    def _now(self) -> int:
        return self.host.now() if isinstance(self.host, RclpyPlantHost) else steady()

    def _catch_up(self) -> int:
        return int(self._lib.fjr_real_time_catch_up(self.plant, self._now()))

    def _restart(self) -> int:
        return int(self._lib.fjr_real_time_restart(self.plant, self._now()))

    def _resume(self) -> int:
        return int(self._lib.fjr_real_time_resume(self.plant, self._now()))

    def _begin_advance(self) -> int:
        """Advance all samples at once under the held effort."""
        return int(self._lib.fjr_real_time_advance(self.plant))

    def _refusal(self) -> str:
        return super()._refusal() or (
            "" if self.plant.started else "no time has been received on /clock; expected one first"
        )

    def _read(self, data: bytes) -> None:
        self._reader.read_array(deserialised(data, Float64MultiArray))
