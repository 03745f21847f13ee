# SPDX-License-Identifier: Apache-2.0
"""Taylor models contain the values of CasADi functions, exactly evaluated, and are as tight as their order says."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_core.errors import StateError
from fjr_core.motions.sine import MultiSine
from fjr_proofs.verification.taylor_models import NUMBER, Shape, TaylorFunction, TaylorModels

SHAPES = [Shape(2, 5, 2), Shape(2, 2, 1), Shape(1, 3, 3), Shape(0, 4, 2), Shape(3, 1, 1), NUMBER]
A, B = ca.SX.sym("a"), ca.SX.sym("b")
EVERY_OPERATION = TaylorFunction(
    ca.Function(
        "every", [A, B], [ca.vertcat(A * B - ca.sin(A), ca.cos(B) / (4 + A * A), 2 * A + 1 / (3 + B), -A + 0.1, A)]
    )
)


def exact(a: mp.mpf, b: mp.mpf) -> list[mp.mpf]:
    return [a * b - mp.sin(a), mp.cos(b) / (4 + a * a), 2 * a + 1 / (3 + b), -a + mp.mpf(0.1), a]


def value(model: Sequence[float], shape: Shape, t: float, y: Sequence[float]) -> mp.mpf:
    """Return the polynomial of a model (width,) at t and y, in high precision."""
    powers = [mp.mpf(t) ** k for k in range(max(shape.order, shape.mixed))]
    terms = powers[: shape.order] + [power * mp.mpf(each) for power in powers[: shape.mixed] for each in y]
    return mp.fsum(mp.mpf(c) * term for c, term in zip(model[:-1], terms, strict=True))


def random_models(rng: np.random.Generator, shape: Shape, scale: float) -> TaylorModels:
    """Return models of two arguments in one box, about numbers up to 1, with coefficients up to `scale`."""
    values = scale * rng.uniform(-1, 1, (1, 2, shape.width)) / shape.width
    values[:, :, 0] = rng.uniform(-1, 1, (1, 2))
    values[:, :, -1] = rng.choice([0.0, 1e-9, 1e-2], 2) * scale
    return TaylorModels(values, shape)


@given(st.sampled_from(SHAPES), st.sampled_from([0.0, 1e-8, 1e-3, 0.5]), st.integers(0, 2**32))
def test_exact_values_lie_in_the_models(shape: Shape, scale: float, seed: int) -> None:
    """The function of any two numbers within the models of its arguments lies in the model of the result."""
    rng = np.random.default_rng(seed)
    given_models = random_models(rng, shape, scale)
    (result,) = EVERY_OPERATION(*(TaylorModels(given_models.values[:, [i]], shape) for i in range(2)))
    with mp.workdps(40):
        for _ in range(3):
            t, y = float(rng.choice([-1, 1, rng.uniform(-1, 1)])), rng.choice([-1.0, 1.0, 0.3], shape.symbols)
            a, b = (
                value(each, shape, t, y) + mp.mpf(each[-1]) * int(rng.choice([-1, 0, 1]))
                for each in given_models.values[0]
            )
            for model, expected in zip(result.values[0], exact(a, b), strict=True):
                assert abs(value(model, shape, t, y) - expected) <= mp.mpf(model[-1])


@pytest.mark.parametrize(("shape", "power"), [(Shape(0, 4, 1), 4), (Shape(0, 2, 1), 2), (Shape(2, 4, 1), 2)])
def test_the_rest_falls_with_the_order_of_the_polynomial(shape: Shape, power: int) -> None:
    """Half the width: 1 / 2^K of the rest in time alone, a quarter with deviations."""

    def rest(scale: float) -> np.ndarray:
        values = np.zeros((1, 2, shape.width))
        values[:, :, 0] = 0.4, -0.7
        values[:, :, 1] = scale
        values[:, :, shape.order : -1] = scale
        (result,) = EVERY_OPERATION(*(TaylorModels(values[:, [i]], shape) for i in range(2)))
        return np.asarray(result.values[0, :3, -1])

    assert rest(0.01) / rest(0.005) == pytest.approx(2.0**power, rel=0.05)


def test_the_polynomial_is_the_taylor_series() -> None:
    shape = Shape(1, 3, 2)
    values = np.zeros((1, 2, shape.width))
    values[0, :, :4] = [[0.3, 0.5, 0, 0], [0.2, 0, 0, 1.0]]  # a = 0.3 + 0.5 t, b = 0.2 + y
    (result,) = EVERY_OPERATION(*(TaylorModels(values[:, [i]], shape) for i in range(2)))
    sine, cosine = np.sin(0.3), np.cos(0.3)
    expected = [0.06 - sine, 0.1 - 0.5 * cosine, 0.125 * sine, 0.3, 0.5]  # 1, t, t^2, y, t y of a b - sin a
    assert result.values[0, 0, :-1] == pytest.approx(expected, rel=1e-14)


def test_rounding_of_exact_numbers_is_bounded() -> None:
    (result,) = EVERY_OPERATION(*(TaylorModels.exact([[x]], Shape(0)) for x in (0.15, 0.7)))
    assert np.all(result.values[0, :4, -1] > 0)
    assert np.all(result.values[0, :, -1] < 1e-14)


def test_derivatives_of_sums_of_sines_are_enclosed() -> None:
    reference = MultiSine([[0.2, 0.1], [0.3, 0.4]], [[1.0, 2.0], [3.0, -4.0]], [[0.1, 0.2], [0.3, 0.4]], [0.5, -0.5])
    t, shape = np.linspace(0, 7, 40), Shape(0, 2, 1)
    models = TaylorModels.sines(reference, t, 1e-3, 7, shape).values
    for share in (0.0, 1.0, -0.4):
        jets = reference.jets(t + share * 1e-3).reshape(len(t), 10)
        assert np.all(np.abs(jets - models[:, :10, 0] - share * models[:, :10, 1]) <= models[:, :10, 2])
    later, earlier = (TaylorModels.sines(reference, t + step, 0.0, 7, shape).values[..., 0] for step in (1e-5, -1e-5))
    assert (later - earlier)[:, :12] / 2e-5 == pytest.approx(models[:, 2:, 0], abs=1e-5 * np.abs(models[..., 0]).max())


def test_sines_of_large_angles_are_enclosed() -> None:
    """At 1e7 rad a rounding of the angle is 1e-9 rad, more than that of a sum."""
    t, phase = np.linspace(0.0, 1.0, 50), 1e7 + 0.3
    values = TaylorModels.sines(MultiSine([[1.0]], [[3.0]], [[phase]], [0.0]), t, 0.0, 1, Shape(0)).values[:, 0]
    with mp.workdps(40):
        exact_values = [mp.sin(3 * mp.mpf(each) + mp.mpf(phase)) for each in t.tolist()]
        errors = [float(abs(mp.mpf(model[0]) - true)) for model, true in zip(values, exact_values, strict=True)]
    assert np.all(errors <= values[:, -1])
    assert max(errors) > 1e-11


def test_a_divisor_that_may_be_zero_is_refused() -> None:
    function = TaylorFunction(ca.Function("f", [A], [1 / A]))

    def about_one(radius: float) -> TaylorModels:
        return TaylorModels.linear([[[radius]]], Shape(1, 2, 1)).minus(np.array([[-1.0]]))

    with pytest.raises(ZeroDivisionError):
        function(about_one(1.1))
    (result,) = function(about_one(0.9))
    assert result.magnitude[0, 0] >= 10.0


def test_numbers_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ZeroDivisionError):
        EVERY_OPERATION(*(TaylorModels.exact([[x]], Shape(0)) for x in (1e200, 1e200)))


def test_an_operation_without_a_model_is_named() -> None:
    with pytest.raises(StateError, match="f contains OP_TANH, which has no Taylor model"):
        TaylorFunction(ca.Function("f", [A], [ca.tanh(A)]))
