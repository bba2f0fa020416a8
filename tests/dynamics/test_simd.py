"""SIMD arithmetic in compiled code against NumPy: equal to the bit where both round once."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from hframe_gym.dynamics import LANES, simd_math
from hframe_gym.dynamics.simd import (
    absolute,
    any_of,
    copysign,
    floor,
    fma,
    load,
    maximum,
    minimum,
    pow2,
    rint,
    sqrt,
    store,
    where,
)

pytestmark = pytest.mark.unit

NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=LANES, max_size=LANES)


@njit(error_model="numpy")
def arithmetic(A, out):  # type: ignore[no-untyped-def]
    a, b = load(A, 0), load(A, 1)
    store(out, 0, a + b)
    store(out, 1, a - b)
    store(out, 2, a * b)
    store(out, 3, a / b)
    store(out, 4, -a)
    store(out, 5, absolute(a))
    store(out, 6, copysign(a, b))
    store(out, 7, where((a < b) & (a != 0.0), a, 2.0))
    store(out, 8, rint(a))
    store(out, 9, floor(a))
    store(out, 10, 3.0 * a + 1)
    store(out, 11, where((a > b) | (a == b), 1.0, 0.0))
    store(out, 12, minimum(a, b))
    store(out, 13, maximum(a, 0.5))
    store(out, 14, sqrt(absolute(a)))
    return any_of(a > b)


@settings(max_examples=60, deadline=None)
@given(NUMBERS, NUMBERS)
def test_arithmetic_agrees_with_numpy(first: list[float], second: list[float]) -> None:
    """Every instruction rounds once, hence exactly like NumPy."""
    a, b = np.array(first), np.array(second)
    out = np.empty((15, LANES))
    any_larger = arithmetic(np.array([a, b]), out)
    with np.errstate(all="ignore"):
        expected = [
            a + b,
            a - b,
            a * b,
            a / b,
            -a,
            np.abs(a),
            np.copysign(a, b),
            np.where((a < b) & (a != 0.0), a, 2.0),
            np.rint(a),
            np.floor(a),
            3.0 * a + 1,
            (a >= b).astype(float),
            np.minimum(a, b),
            np.maximum(a, 0.5),
            np.sqrt(np.abs(a)),
        ]
    np.testing.assert_array_equal(out, expected)
    assert any_larger == bool((a > b).any())


@njit
def smaller_and_larger(A, out, numbers):  # type: ignore[no-untyped-def]
    a, b = load(A, 0), load(A, 1)
    store(out, 0, minimum(a, b))
    store(out, 1, maximum(a, b))
    for k in range(A.shape[1]):
        numbers[0, k] = minimum(A[0, k], A[1, k])
        numbers[1, k] = maximum(A[0, k], A[1, k])


def test_minimum_and_maximum_of_numbers_agree_with_those_of_registers() -> None:
    """Bit for bit, also with NaN and negative zero."""
    special = [(1.0, np.nan), (np.nan, 1.0), (0.0, -0.0), (-0.0, 0.0), (np.inf, np.nan), (2.0, 3.0), (3.0, 2.0)]
    for first in range(len(special)):
        A = np.array([special[(first + k) % len(special)] for k in range(LANES)]).T.copy()
        out, numbers = np.empty((2, 2, LANES))
        smaller_and_larger(A, out, numbers)
        np.testing.assert_array_equal(out.view(np.int64), numbers.view(np.int64))


@njit
def fused(A, out):  # type: ignore[no-untyped-def]
    store(out, 0, fma(load(A, 0), load(A, 1), load(A, 2)))
    store(out, 1, pow2(load(A, 3)))


def test_fma_rounds_once_and_pow2_is_exact() -> None:
    """(1 + e)(1 - e) - 1 = -e^2 survives only if the product is not rounded."""
    e = 2.0**-30
    A = np.empty((4, LANES))
    A[0], A[1], A[2], A[3] = 1 + e, 1 - e, -1.0, np.linspace(-1000, 1000, LANES).round()
    out = np.empty((2, LANES))
    fused(A, out)
    np.testing.assert_array_equal(out[0], -(e**2))
    np.testing.assert_array_equal(out[1], 2.0 ** A[3])


@njit
def elementary(A, out):  # type: ignore[no-untyped-def]
    for i in range(A.shape[0]):
        x = load(A, i)
        store(out, 3 * i, simd_math.exp(x))
        store(out, 3 * i + 1, simd_math.sin(x))
        store(out, 3 * i + 2, simd_math.cos(x))


def test_elementary_functions_are_accurate_to_a_few_ulp() -> None:
    """Compare exp, sin and cos with NumPy over small and large arguments."""
    rng = np.random.default_rng(0)
    A = np.concatenate([rng.uniform(-5, 5, (200, LANES)), rng.uniform(-600, 600, (200, LANES)), np.zeros((1, LANES))])
    out = np.empty((3 * len(A), LANES))
    elementary(A, out)
    np.testing.assert_allclose(out[0::3], np.exp(A), rtol=1e-15)
    np.testing.assert_allclose(out[1::3], np.sin(A), atol=5e-16)
    np.testing.assert_allclose(out[2::3], np.cos(A), atol=5e-16)


def test_sine_and_cosine_of_large_angles() -> None:
    """The error limit that `elementwise` states holds up to 1e12 rad, also near multiples of pi/2."""
    sizes = np.geomspace(1e3, 1e12, 200)[:, None] * np.random.default_rng(0).uniform(-1.0, 1.0, (200, LANES))
    A = np.concatenate([sizes, np.rint(sizes / (0.5 * np.pi)) * 0.5 * np.pi])
    out = np.empty((3 * len(A), LANES))
    elementary(A, out)
    np.testing.assert_allclose(out[1::3], np.vectorize(math.sin)(A), rtol=0.0, atol=5e-16)
    np.testing.assert_allclose(out[2::3], np.vectorize(math.cos)(A), rtol=0.0, atol=5e-16)


@njit
def hyperbolic(A, out):  # type: ignore[no-untyped-def]
    for i in range(A.shape[0]):
        store(out, 2 * i, simd_math.tanh(load(A, i)))
        store(out, 2 * i + 1, simd_math.sign(load(A, i)))


def test_tanh_and_sign() -> None:
    """The relative error of tanh is a few units in the last place, for small arguments too."""
    sizes = np.geomspace(1e-300, 1e3, 3000 * LANES).reshape(-1, LANES)
    special = np.resize([0.0, -0.0, 0.4, -0.4, np.nextafter(0.4, 0.0), np.inf, -np.inf, 1e-320], (1, LANES))
    A = np.concatenate([sizes, -sizes, special])
    out = np.empty((2 * len(A), LANES))
    hyperbolic(A, out)
    np.testing.assert_allclose(out[0::2], np.tanh(A), rtol=1e-15)
    np.testing.assert_array_equal(out[1::2], np.sign(A))


@njit
def one_exp(A, out):  # type: ignore[no-untyped-def]
    store(out, 0, simd_math.exp(load(A, 0)))


def test_exp_saturates() -> None:
    """Arguments below -700 give zero, those above 700 give e**700."""
    A = np.full((1, LANES), -700.001)
    A[0, :3] = 700.0, 700.001, 1e4
    out = np.empty((1, LANES))
    one_exp(A, out)
    np.testing.assert_allclose(out[0, :3], np.exp(700.0), rtol=1e-15)
    np.testing.assert_array_equal(out[0, 3:], 0.0)
