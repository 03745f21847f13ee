# SPDX-License-Identifier: Apache-2.0
"""Check the sampled loop of one controller on plants that differ from its model, drawn or wrong in one parameter.

The loop is linearised as in sampled_loop, for all draws and configurations at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import StateError
from fjr_core.law.interfaces import SampledLaw
from fjr_core.law.linearized import Equilibria, Indices, equilibria_at
from fjr_core.model.configuration_sampling import checked_configurations
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.numerics.checks import Array
from fjr_core.simulation.deviations import MATRICES
from fjr_core.stability.linear_controller import Controller, Sensing, controller
from fjr_core.stability.linearization import held_maps, map_of_held, on_plant, split
from fjr_design.stability.sampled_loop import contracting

CONFIDENCE = 0.99  # one-sided
MOST_MAPS = 512  # in memory at a time
FIELDS = tuple(MATRICES)
SCREENED, CLOSELY = 16, 8  # draws that choose the worst configurations, and how many these are
FACTORS = (0.7, 0.8, 1.2, 1.3)  # ratios of a plant parameter to its value in the model
QUANTITIES = ("stiffness", "link_inertia", "motor_inertia")
"""Deviations that are changed, for all joints at once; the weight of the links stays."""


@dataclass(frozen=True, eq=False)
class DrawnPlants:
    """Plants whose joints were drawn: stiffness [N m/rad], motor_inertia [kg m^2], damping [N m s/rad], each (k, n).

    delay (k,) [s]: of the effort, in addition to that of the loop. The links are those of the robot. Raises StateError.
    """

    stiffness: Array
    motor_inertia: Array
    link_damping: Array
    motor_damping: Array
    delay: Array

    def __post_init__(self) -> None:
        for name in FIELDS:
            value = getattr(self, name)
            if value.shape != self.stiffness.shape or not np.all(np.isfinite(value)) or value.min() < 0:
                raise StateError(f"{name} of shape {value.shape} is not positive; expected {self.stiffness.shape}")

    def __len__(self) -> int:
        return len(self.stiffness)

    def at(self, which: slice | Indices) -> DrawnPlants:
        """Return the selected draws."""
        return DrawnPlants(*(getattr(self, name)[which] for name in (*FIELDS, "delay")))


def in_common(plants: DrawnPlants, lost: NDArray[np.bool_], joints: Sequence[str] = ()) -> str:
    """Return what the lost draws (k,) have in common, as a sentence.

    It is the drawn number whose mean over the lost draws differs most from that over all, in standard deviations.
    joints: their names, joint1 to jointn if empty.
    """
    n = plants.stiffness.shape[1]
    drawn = np.column_stack([*(getattr(plants, name) for name in FIELDS), plants.delay])
    mean, own, spread = drawn.mean(axis=0), drawn[lost].mean(axis=0), drawn.std(axis=0)
    which = int(np.argmax(np.abs(own - mean) / np.where(spread > 1e-9 * np.abs(mean), spread, np.inf)))
    what = "delay"
    if which < n * len(FIELDS):
        name = joints[which % n] if joints else f"joint{which % n + 1}"
        what = f"{FIELDS[which // n].replace('_', ' ')} of {name}"
    return f"the lost draws differ most in {what}: {own[which]:.3g} on average, {mean[which]:.3g} over all draws"


class DrawnLoops:
    """One linearised controller at the equilibria of its own model, with whatever plants are drawn.

    The loop has a sample_period [s], a delay [s] and the sensing of sampled_loop.check.
    """

    def __init__(
        self,
        law: SampledLaw,
        equilibria: Equilibria,
        sample_period: float,
        delay: float,
        sensing: Sensing | None = None,
    ) -> None:
        self._own, self._period, self._delay, self._sensing = equilibria, sample_period, delay, sensing or Sensing()
        self._controller = controller(law, equilibria, self._sensing)(sample_period)

    def unstable(self, plants: DrawnPlants, progress: Callable[[float], None] = lambda _: None) -> NDArray[np.bool_]:
        """Return which draws (k,) are unstable at any configuration; progress receives the finished share."""
        bad, done = np.zeros(len(plants), dtype=bool), 0
        for chosen, maps in self._groups(plants):
            bad[chosen] = ~contracting(maps).reshape(len(chosen), -1).all(axis=1)
            done += len(chosen)
            progress(done / len(plants))
        return bad

    def radii(self, plants: DrawnPlants) -> Array:
        """Return the spectral radii (k, c) of k draws at c configurations."""
        found = np.empty((len(plants), len(self._own.q_l)))
        for chosen, maps in self._groups(plants):
            found[chosen] = np.abs(np.linalg.eigvals(maps)).max(axis=1).reshape(len(chosen), -1)
        return found

    def worst(self, plants: DrawnPlants) -> Indices:
        """Return the sorted indices of the CLOSELY configurations that are worst for some of the first draws."""
        radii = self.radii(plants.at(slice(0, SCREENED))).max(axis=0)
        return np.sort(np.argsort(-radii, kind="stable")[:CLOSELY])

    def _groups(self, plants: DrawnPlants) -> Iterator[tuple[Indices, Array]]:
        """Yield a few draws of equal whole samples of delay, which determine the size of a map, and their maps."""
        times = [split(max(self._delay + delay, 0.0), self._period) for delay in plants.delay]
        whole, late = np.array([pair[0] for pair in times]), np.array([pair[1] for pair in times])
        size = max(1, MOST_MAPS // len(self._own.q_l))
        for samples in np.unique(whole):
            equal = np.flatnonzero(whole == samples)
            for chosen in np.split(equal, range(size, len(equal), size)):
                yield chosen, self._maps(plants.at(chosen), int(samples), late[chosen])

    def _maps(self, plants: DrawnPlants, whole: int, late: Array) -> Array:
        """Return the one-sample maps (k c, N, N) of k draws at c configurations."""
        k, c, T = len(plants), len(self._own.q_l), self._period
        A, B, frequency = self._plants(plants)
        law = Controller(**{name: np.tile(getattr(self._controller, name), (k, 1, 1)) for name in "FCSGHJ"})
        seen = self._sensing.measured(self._own.robot, plants.stiffness[:, :, None] * np.eye(self._own.robot.n))
        if seen is not None:
            law = law.seeing(np.repeat(seen, c, axis=0))
        late = np.repeat(late, c)
        Phi, Gamma = _held(A, B, (1 - late) * T, frequency)
        if not late.any():
            return map_of_held(Phi, {whole: Gamma}, law)
        Phi_late, Gamma_late = _held(A, B, late * T, frequency)
        return map_of_held(Phi @ Phi_late, {whole: Gamma, whole + 1: Phi @ Gamma_late}, law)

    def _plants(self, plants: DrawnPlants) -> tuple[Array, Array, float]:
        """Return A (k c, 4n, 4n), B (k c, 4n, n) in y = (q_l, q_m, dq_l, dq_m), and the highest frequency [rad/s]."""
        own, n, k, c = self._own, self._own.robot.n, len(plants), len(self._own.q_l)
        W, K = np.linalg.inv(own.M_l), plants.stiffness[:, None] * own.hardening
        A, B = np.zeros((k, c, 4 * n, 4 * n)), np.zeros((k, c, 4 * n, n))
        q_l, q_m, v_l, v_m = (slice(i * n, (i + 1) * n) for i in range(4))
        A[..., q_l, v_l] = A[..., q_m, v_m] = np.eye(n)
        A[..., v_l, q_m] = W * K[:, :, None, :]
        A[..., v_l, q_l] = -A[..., v_l, q_m] - W @ own.N_l
        A[..., v_l, v_l] = -W * plants.link_damping[:, None, None, :]
        joints = np.arange(n)
        spring = K / plants.motor_inertia[:, None]
        A[:, :, 3 * n + joints, joints], A[:, :, 3 * n + joints, n + joints] = spring, -spring
        A[:, :, 3 * n + joints, 3 * n + joints] = -(plants.motor_damping / plants.motor_inertia)[:, None]
        B[..., v_m, :] = own.robot.B_m / plants.motor_inertia[:, None, :, None]
        frequency = float(np.sqrt(np.abs(A[..., 2 * n :, : 2 * n]).sum(axis=-1).max()))
        return A.reshape(k * c, 4 * n, 4 * n), B.reshape(k * c, 4 * n, n), frequency


def _held(A: Array, B: Array, times: Array, frequency: float) -> tuple[Array, Array]:
    """Return Phi and Gamma of each plant over its own time [s], with velocities scaled by the frequency."""
    size = np.repeat([1.0, 1.0 / max(frequency, 1e-9)], A.shape[1] // 2)[:, None]
    durations, scale = times[:, None, None], size / size.T
    Phi, Gamma = held_maps(A * scale * durations, B * size * durations, 1.0)
    return Phi / scale, Gamma / size


def draws_needed(share: float) -> int:
    """Return how many draws, none of which is lost, show with CONFIDENCE that at most this share is."""
    return int(np.ceil(np.log(1 - CONFIDENCE) / np.log(1 - share)))


def largest_share(lost: int, of: int) -> float:
    """Return the upper bound of the share that is lost, with CONFIDENCE (C. Clopper, E. Pearson, 1934)."""
    from scipy.special import betaincinv  # loaded on use: see law/gains.py

    return 1.0 if lost >= of else float(betaincinv(lost + 1, of - lost, CONFIDENCE))


def _changed(at: Equilibria, quantity: str, factor: float) -> Equilibria:
    """Return the equilibria of a robot one of whose QUANTITIES is multiplied by a factor."""
    robot = at.robot
    if quantity == "link_inertia":
        return replace(at, M_l=factor * at.M_l)
    if quantity == "motor_inertia":
        return replace(at, robot=replace(robot, M_m=factor * robot.M_m))
    cubic = None if robot.cubic is None else factor * robot.cubic
    torsion = None if robot.torsion is None else robot.torsion * np.array([1.0, factor])[:, None, None]
    return replace(at, robot=replace(robot, K=factor * robot.K, cubic=cubic, torsion=torsion))


def radii_with_model_errors(
    law: SampledLaw,
    sample_period: float,
    delay: float,
    configurations: ArrayLike,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> dict[tuple[str, float], float]:
    """Return the largest spectral radius at the configurations (k, n) [rad] for each (quantity, factor).

    The law keeps its model. Arguments as in sampled_loop.check. Raises StateError for wrong shapes.
    """
    sensing, q_l = sensing or Sensing(), checked_configurations(law.robot, configurations)
    own, real = equilibria_at(law.robot, q_l), equilibria_at((plant or Plant(law.robot)).robot, q_l)
    at = controller(law, own, sensing)
    plants = {(quantity, factor): _changed(real, quantity, factor) for quantity in QUANTITIES for factor in FACTORS}
    return {
        which: float(on_plant(at, own, plant, sensing).radii(sample_period, delay).max())
        for which, plant in plants.items()
    }
