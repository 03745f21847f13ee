# SPDX-License-Identifier: Apache-2.0
"""Laws and plants as users write them, named own_code:Class in the tests; FAULTY ones are to be refused or stopped."""

from __future__ import annotations

import sys
import time

import numpy as np
from numpy.typing import NDArray

import fjr_core as fjr
from fjr_design.baselines.pd_gravity import PdGains, PdGravity

Array = NDArray[np.float64]


class Pd:
    """Motor PD about a motor reference that is constant between samples, with an option of each kind."""

    def __init__(
        self,
        robot: fjr.Robot,
        K_p: float = 60.0,
        K_d: float = 2.0,
        weights: tuple[float, ...] = (1.0,),
        gravity: bool = True,
        note: str = "",
    ) -> None:
        self.robot, self.K_p, self.K_d = robot, K_p, K_d
        self.weights, self.gravity, self.note = np.array(weights), gravity, note

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        n, gravity = self.robot.n, self.robot.grad_P_l(jets[0])
        theta = jets[0] + np.linalg.solve(self.robot.K, gravity)
        feedback = self.K_p * (position[n:] - theta) + self.K_d * (velocity[n:] - jets[1])
        return gravity * self.gravity - self.weights * feedback


class Wrapped:
    """v-dPBC with the paper's gains as a law in Python, with its storage and rate."""

    def __init__(self, robot: fjr.Robot, claimed: float = 1.0) -> None:
        self.law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
        self.rate = claimed * self.law.rate().beta

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return self.law.measured_command(position, velocity, jets)[0]

    def storage(self, position: Array, velocity: Array, jets: Array) -> float:
        return self.law.measured_command(position, velocity, jets)[1]


class Symbolic(PdGravity):
    """A law of expressions, which is compiled as the built-in ones are."""

    def __init__(self, robot: fjr.Robot, K_p: float = 60.0) -> None:
        super().__init__(robot, PdGains(K_p, 2.0))


class Fails(Pd):
    """Raises an exception when the motors are beyond 0.7 rad."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        if position[-1] > 0.7:
            raise ZeroDivisionError("too far")
        return super().effort(position, velocity, jets)


class FailsAtSpeed(Pd):
    """Returns two efforts for one joint when the motors move backwards."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return np.zeros(2) if velocity[-1] < 0 else super().effort(position, velocity, jets)


class NanBeyond(Pd):
    """Returns an effort that is not finite when the motors are beyond 0.7 rad."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return super().effort(position, velocity, jets) * (np.nan if 0.7 < position[-1] < 0.9 else 1.0)


class Changes(Pd):
    """Changes its argument."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        velocity -= jets[1]
        return np.zeros(self.robot.n)


class Noisy(Pd):
    """Differs from call to call, but at rest."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return np.array(position[:1] * np.random.default_rng().normal())


class Stops(Pd):
    """Raises an exception a little beside the reference."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        if abs(position[0] - jets[0, 0]) > 1e-3:
            raise ValueError("too far from the reference")
        return np.zeros(1)


class Counts(Pd):
    """Depends on the number of its calls."""

    calls = 0

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        self.calls += 1
        return np.full(self.robot.n, 1e-9 * self.calls)


class Complex(Pd):
    """Returns a complex effort."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return super().effort(position, velocity, jets) + 0.1j  # type: ignore[return-value]


class Exits(Pd):
    """Ends the process."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        sys.exit("enough")


class Slow(Pd):
    """Takes 3 ms at rest at 0.5 rad, where the paper's joint begins; a check evaluates it at thousands of others."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        if position[0] == 0.5 and not velocity.any():
            time.sleep(3e-3)
        return super().effort(position, velocity, jets)


class NotFinite(Pd):
    """Returns no finite effort."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return np.full(self.robot.n, np.inf)


class WrongShape(Pd):
    """Returns one effort too many."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return np.zeros(self.robot.n + 1)


class Text(Pd):
    """Returns no number."""

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        return "much"  # type: ignore[return-value]


class WrongArguments:
    """Its method takes a state."""

    def __init__(self, robot: fjr.Robot) -> None:
        pass

    def effort(self, x: Array) -> Array:
        return x


class NoMethod:
    """Has no method."""

    def __init__(self, robot: fjr.Robot) -> None:
        pass


class NoDefault(Pd):
    """Has an option without a default."""

    def __init__(self, robot: fjr.Robot, K: float) -> None:
        super().__init__(robot, K)


class NoneDefault(Pd):
    """Has an option whose type cannot be known."""

    def __init__(self, robot: fjr.Robot, K: float | None = None) -> None:
        super().__init__(robot)


class NoRobot(Pd):
    """Takes no robot."""

    def __init__(self) -> None:
        pass


class Refuses(Pd):
    """Raises an exception in its constructor."""

    def __init__(self, robot: fjr.Robot) -> None:
        raise KeyError("K_p")


class Ideal:
    """Eq. (36) as a plant in Python, with viscous damping of its own on the links."""

    def __init__(self, robot: fjr.Robot, damping: float = 0.0) -> None:
        self.robot, self.ideal, self.damping = robot, fjr.Plant(robot), damping

    def derivative(self, x: Array, u: Array) -> Array:
        n = self.robot.n
        dx = self.ideal.derivative(x, u)
        dx[2 * n : 3 * n] -= self.damping * dx[:n]
        return dx

    def hamiltonian(self, x: Array) -> float:
        return self.robot.hamiltonian(x)


class PlantFails(Ideal):
    """Raises an exception once the motors are beyond 0.7 rad."""

    def derivative(self, x: Array, u: Array) -> Array:
        if x[self.robot.n] > 0.7:
            raise ValueError("too far")
        return super().derivative(x, u)


class PlantCounts(Ideal):
    """Depends on the number of its calls."""

    calls = 0

    def derivative(self, x: Array, u: Array) -> Array:
        self.calls += 1
        return super().derivative(x, u) + 1e-9 * self.calls


class OtherVelocities(Ideal):
    """Takes the momenta for velocities."""

    def derivative(self, x: Array, u: Array) -> Array:
        dx = super().derivative(x, u)
        dx[: 2 * self.robot.n] = x[2 * self.robot.n :]
        return dx
