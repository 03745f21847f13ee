# SPDX-License-Identifier: Apache-2.0
"""Prolonged system: virtual closed loop and its variations, with the exact differential storage (34), (43).

The closed loop is dx_v = Gamma(x_v, x, u(x_v, x, t)), eq. (38) under (42); its prolongation adds the variational
dynamics d(delta) = J(x_v, x, t) delta, eq. (28). With the variation of the errors,
delta_e = Theta delta = (delta q_tilde_l, delta q_tilde_m, delta sigma_l, delta sigma_m), the differential storage is

    W = delta_e' P delta_e / 2,    P = diag(Pi_l, Pi_m, M_l(q_l)^-1, M_m^-1)    along any x(t) of the plant's links,

and dW/dt is exactly minus the dissipation of `storage`. P depends only on the measured q_l. The metric is therefore
flat in the errors: the distance of two virtual states is that of their errors.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.law.gains import terms
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.virtual_system import derivative_expression
from fjr_core.motions.reference import JETS
from fjr_core.numerics import symbolic
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled
from fjr_core.numerics.symbolic import NumericFunction, dense_function


class ProlongedSystem:
    """Virtual closed loop of a law and its variations, as pure functions that are built once.

    x_v, x, delta (4n,): states with momenta; jets (5, n). Raises StateError for wrong shapes.
    compile: build the derivative as machine code if a C compiler is available.
    """

    def __init__(self, law: TrackingLaw, compile: bool = False) -> None:
        self.law = law
        self._compile = compile

    def errors(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike) -> Array:
        """Return (q_tilde_l, q_tilde_m, sigma_l, sigma_m) (4n,), eqs. (30), (39)."""
        return self._errors(x_v, x, jets)[0]

    def storage(self, x_v: ArrayLike, x: ArrayLike, delta: ArrayLike, jets: ArrayLike) -> tuple[float, float]:
        """Return W [J] of a variation and its exact rate dW [W], which is never positive."""
        W, dW = self._storage(x_v, x, delta, jets)
        return float(W[0]), float(dW[0])

    def in_metric(self, errors: Array, x: ArrayLike) -> Array:
        """Return errors (..., 4n) at one measured x in coordinates in which P is the identity."""
        n, gains = self.law.robot.n, self.law.gains
        upper = [np.linalg.cholesky(Pi).T for Pi in (gains.Pi_l, gains.Pi_m)]
        inertias = self.law.robot.M_l(np.asarray(x, dtype=float)[:n]), self.law.robot.M_m
        lower = [np.linalg.inv(np.linalg.cholesky(M)) for M in inertias]
        parts = np.split(errors, 4, axis=-1)
        return np.concatenate([part @ W.T for part, W in zip(parts, [*upper, *lower], strict=True)], axis=-1)

    @cached_property
    def function(self) -> ca.Function:
        """Return the CasADi function (x_v, x, delta, jets (n, 5)) -> dx_v, d_delta."""
        symbols = self._symbols()
        x_v, x, delta, jets = symbols.values()
        u = self.law.function(x_v, x, jets, 0)
        dx_v = derivative_expression(self.law.robot, x_v, x, u)
        outputs = {"dx_v": dx_v, "d_delta": symbolic.directional(dx_v, x_v, delta)}
        function = dense_function("prolonged", symbols, outputs, cse=True)
        return compiled(function) if self._compile else function

    def _symbols(self) -> dict[str, ca.SX]:
        n = self.law.robot.n
        return {**symbolic.symbols(x_v=4 * n, x=4 * n, delta=4 * n), "jets": ca.SX.sym("jets", n, JETS)}

    def _error_expression(self, x_v: ca.SX, x: ca.SX, jets: ca.SX) -> ca.SX:
        q_tilde_l, sigma_l, q_tilde_m, sigma_m = self.law.errors_function(x_v, x, jets, 0)
        return ca.vertcat(q_tilde_l, q_tilde_m, sigma_l, sigma_m)

    def _storage_expressions(self, x_v: ca.SX, x: ca.SX, delta: ca.SX, jets: ca.SX) -> tuple[ca.SX, ca.SX]:
        robot, g = self.law.robot, terms(self.law.gains)
        e = self._error_expression(x_v, x, jets)
        qt_l, qt_m, _, _ = symbolic.blocks(e, robot.n)
        dqt_l, dqt_m, dsigma_l, dsigma_m = symbolic.blocks(symbolic.directional(e, x_v, delta), robot.n)
        ds_l = symbolic.solve(robot.links.M_l(x[: robot.n]), dsigma_l)
        ds_m = ca.DM(np.linalg.inv(robot.M_m)) @ dsigma_m
        W = (ca.dot(dqt_l, g.Pi_l @ dqt_l) + ca.dot(dqt_m, g.Pi_m @ dqt_m)) / 2
        W += (ca.dot(ds_l, dsigma_l) + ca.dot(ds_m, dsigma_m)) / 2
        dissipation = ca.dot(dqt_l, g.Pi_l @ _variation(g.phi_l, qt_l, dqt_l))
        dissipation += ca.dot(dqt_m, g.Pi_m @ _variation(g.phi_m, qt_m, dqt_m))
        dissipation += ca.dot(ds_l, (robot.D_l + g.K_ld) @ ds_l) + ca.dot(ds_m, (robot.D_m + g.K_md) @ ds_m)
        return W, -dissipation

    @cached_property
    def _errors(self) -> NumericFunction:
        symbols = self._symbols()
        del symbols["delta"]
        return NumericFunction(dense_function("errors", symbols, {"e": self._error_expression(**symbols)}, cse=True))

    @cached_property
    def _storage(self) -> NumericFunction:
        symbols = self._symbols()
        W, dW = self._storage_expressions(*symbols.values())
        return NumericFunction(dense_function("storage", symbols, {"W": W, "dW": dW}, cse=True))


def _variation(phi: object, at: ca.SX, direction: ca.SX) -> ca.SX:
    """Return the directional derivative of phi at `at`."""
    z = ca.SX.sym("z", at.numel())
    (value,) = ca.substitute([symbolic.directional(phi(z), z, direction)], [z], [at])  # type: ignore[operator]
    return value
