"""Functions of SIMD registers against NumPy: equal to the bit where both round once."""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_gym.dynamics import LANES
from hframe_gym.dynamics.codegen import machine_code
from hframe_gym.dynamics.codegen.kernel import generate_kernel
from hframe_gym.dynamics.codegen.kernel_source import FUNCTIONS, KernelSource
from hframe_gym.dynamics.codegen.lane_compiler import LaneCompileError, compile_lanes
from hframe_gym.dynamics.codegen.lane_program import FORMULAS, LaneProgram
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.dynamics.lanes import call, run

NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=LANES, max_size=LANES)
ARITHMETIC = """
def f(A, out, h: float, n: int):
    a = load(A, 0)
    b = load(A, 1)
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
    store(out, 15, a + h * n / 3.0)
    larger = 0.0 * a
    if any_of(a > b):
        larger = larger + 1.0
    store(out, 16, larger)
    total = 0.0 * a
    for i in range(n):
        total = total + load(A, i * 2 - i)
    store(out, 17, total)
"""


@settings(max_examples=60, deadline=None)
@given(NUMBERS, NUMBERS)
def test_arithmetic_agrees_with_numpy(first: list[float], second: list[float]) -> None:
    """Every instruction rounds once, hence exactly like NumPy."""
    a, b = np.array(first), np.array(second)
    out = np.empty((18, LANES))
    run(ARITHMETIC, np.array([a, b]), out, 0.25, 2)
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
            a + 0.25 * 2 / 3.0,
            np.full(LANES, float((a > b).any())),
            a + b,
        ]
    np.testing.assert_array_equal(out, expected)


def test_minimum_and_maximum_with_nan_and_negative_zero() -> None:
    """If a value is NaN, or both are zero, the second one is returned."""
    special = [
        (1.0, np.nan),
        (np.nan, 1.0),
        (0.0, -0.0),
        (-0.0, 0.0),
        (np.inf, np.nan),
        (2.0, 3.0),
        (3.0, 2.0),
    ]
    a, b = np.array([special[k % len(special)] for k in range(LANES)]).T
    out = np.empty((2, LANES))
    text = """
def f(A, out):
    store(out, 0, minimum(load(A, 0), load(A, 1)))
    store(out, 1, maximum(load(A, 0), load(A, 1)))
"""
    run(text, np.array([a, b]), out)
    expected = np.array([np.where(a < b, a, b), np.where(a > b, a, b)])
    np.testing.assert_array_equal(out.view(np.int64), expected.view(np.int64))


def test_fma_rounds_once_and_pow2_is_exact() -> None:
    """(1 + e)(1 - e) - 1 = -e^2 survives only if the product is not rounded."""
    e = 2.0**-30
    A = np.empty((4, LANES))
    A[0], A[1], A[2], A[3] = 1 + e, 1 - e, -1.0, np.linspace(-1000, 1000, LANES).round()
    out = np.empty((2, LANES))
    text = """
def f(A, out):
    store(out, 0, fma(load(A, 0), load(A, 1), load(A, 2)))
    store(out, 1, pow2(load(A, 3)))
"""
    run(text, A, out)
    np.testing.assert_array_equal(out[0], -(e**2))
    np.testing.assert_array_equal(out[1], 2.0 ** A[3])


def test_constants_keep_the_sign_of_zero() -> None:
    out = np.empty((2, LANES))
    run("def f(A, out):\n    store(out, 0, 0.0)\n    store(out, 1, -0.0)\n", np.zeros((1, LANES)), out)
    np.testing.assert_array_equal(np.signbit(out), [[False] * LANES, [True] * LANES])


ELEMENTARY = """
def f(A, out, n: int):
    for i in range(n):
        x = load(A, i)
        store(out, 3 * i, exp(x))
        store(out, 3 * i + 1, sin(x))
        store(out, 3 * i + 2, cos(x))
"""


def test_elementary_functions_are_accurate_to_a_few_ulp() -> None:
    """Compare exp, sin and cos with NumPy over small and large arguments."""
    rng = np.random.default_rng(0)
    A = np.concatenate(
        [rng.uniform(-5, 5, (200, LANES)), rng.uniform(-600, 600, (200, LANES)), np.zeros((1, LANES))]
    )
    out = np.empty((3 * len(A), LANES))
    run(ELEMENTARY, A, out, len(A))
    np.testing.assert_allclose(out[0::3], np.exp(A), rtol=1e-15)
    np.testing.assert_allclose(out[1::3], np.sin(A), atol=5e-16)
    np.testing.assert_allclose(out[2::3], np.cos(A), atol=5e-16)


def test_sine_and_cosine_of_large_angles() -> None:
    """The error limit that `elementwise` states holds up to 1e12 rad, also near multiples of pi/2."""
    sizes = np.geomspace(1e3, 1e12, 200)[:, None] * np.random.default_rng(0).uniform(-1.0, 1.0, (200, LANES))
    A = np.concatenate([sizes, np.rint(sizes / (0.5 * np.pi)) * 0.5 * np.pi])
    out = np.empty((3 * len(A), LANES))
    run(ELEMENTARY, A, out, len(A))
    np.testing.assert_allclose(out[1::3], np.vectorize(math.sin)(A), rtol=0.0, atol=5e-16)
    np.testing.assert_allclose(out[2::3], np.vectorize(math.cos)(A), rtol=0.0, atol=5e-16)


def test_tanh_and_sign() -> None:
    """The relative error of tanh is a few units in the last place, for small arguments too."""
    sizes = np.geomspace(1e-300, 1e3, 3000 * LANES).reshape(-1, LANES)
    special = np.resize([0.0, -0.0, 0.4, -0.4, np.nextafter(0.4, 0.0), np.inf, -np.inf, 1e-320], (1, LANES))
    A = np.concatenate([sizes, -sizes, special])
    out = np.empty((2 * len(A), LANES))
    text = """
def f(A, out, n: int):
    for i in range(n):
        store(out, 2 * i, tanh(load(A, i)))
        store(out, 2 * i + 1, sign(load(A, i)))
"""
    run(text, A, out, len(A))
    np.testing.assert_allclose(out[0::2], np.tanh(A), rtol=1e-15)
    np.testing.assert_array_equal(out[1::2], np.sign(A))


def test_log_is_accurate_and_finite() -> None:
    """The error is a few units in the last place, relative to 1 where the logarithm is near 0."""
    sizes = np.geomspace(1e-300, 1e300, 2000 * LANES).reshape(-1, LANES)
    near_one = 1.0 + np.linspace(-0.5, 0.5, 100 * LANES).reshape(-1, LANES)
    limits = np.resize([1.0, 2.0, 0.5, np.sqrt(2.0), 0.0, -1.0, np.inf, 1e308], (1, LANES))
    A = np.concatenate([sizes, near_one, limits])
    out = np.empty_like(A)
    run(
        "def f(A, out, n: int):\n    for i in range(n):\n        store(out, i, log(load(A, i)))\n",
        A,
        out,
        len(A),
    )
    np.testing.assert_allclose(out, np.log(np.clip(A, 1e-300, 1e300)), rtol=5e-16, atol=5e-16)


def test_exp_saturates() -> None:
    """Arguments below -700 give zero, those above 700 give e**700."""
    A = np.full((1, LANES), -700.001)
    A[0, :3] = 700.0, 700.001, 1e4
    out = np.empty((1, LANES))
    run("def f(A, out):\n    store(out, 0, exp(load(A, 0)))", A, out)
    np.testing.assert_allclose(out[0, :3], np.exp(700.0), rtol=1e-15)
    np.testing.assert_array_equal(out[0, 3:], 0.0)


def test_a_loop_runs_until_no_lane_needs_it() -> None:
    A = np.arange(float(LANES))[None]
    out = np.empty((1, LANES))
    text = """
def f(A, out):
    x = load(A, 0)
    while any_of(x > 0.5):
        x = where(x > 0.5, x - 1.0, x)
    store(out, 0, x)
"""
    run(text, A, out)
    np.testing.assert_array_equal(out, 0.0)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("x = unknown(h)", "the function unknown is unknown"),
        ("x = h ** 2", r"cannot contain 'h \*\* 2'"),
        ("x = y", "the name y is unknown"),
        ("h = 2.0", "cannot assign to the argument h"),
        ("x = fma(h, h)", "fma takes 3 operands, not 2"),
        ("x = load(h, 0)", "h is no array of rows"),
        ("import os", "cannot contain the statement 'import os'"),
        ("x = h > 0.0 or h", "cannot contain"),
    ],
)
def test_what_is_not_in_the_language_is_refused(line: str, message: str) -> None:
    with pytest.raises(LaneCompileError, match=message):
        compile_lanes(f"def f(A, h: float):\n    {line}", FORMULAS, LANES)


def test_a_variable_keeps_its_type() -> None:
    with pytest.raises(LaneCompileError, match="x cannot hold values of several types"):
        compile_lanes("def f(A, h: float):\n    x = h\n    x = load(A, 0)", FORMULAS, LANES)


def test_a_pickled_program_is_compiled_again() -> None:
    """Another process has other addresses; a copy in this one shares the code."""
    program = LaneProgram("def f(A):\n    store(A, 0, 2.0 * load(A, 0))\n", ("f",))
    assert pickle.loads(pickle.dumps(program)).addresses["f"] == program.addresses["f"]
    script = f"import pickle; print(pickle.loads({pickle.dumps(program)!r}).text)"
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == program.text.strip()


FEATURES = {
    "baseline": ("", 8),  # the oldest processor of its kind, which has no `fma`
    "avx": ("+avx,+sse4.2", 8),
    "avx2": ("+avx2,+fma", 8),
    "avx512": ("+avx512f,+avx512dq,+avx2,+fma", 16),
}


def skip_without(features: str) -> None:
    """Skip the test if this processor lacks one of the features."""
    here = llvm.get_host_cpu_features()
    missing = [name[1:] for name in features.split(",") if name and not here.get(name[1:])]
    if missing:
        pytest.skip(f"this processor has no {', '.join(missing)}")


def cogging_machine() -> Machine:
    """Return a machine whose step has every kind of branch."""
    cogging = EFFECTS["cogging"].at("motor1", A=0.01, n=6.0, p=0.3)
    return BUILTIN_MACHINES["hframe"]().with_effects(cogging)


def states_and_measurements(addresses: Mapping[str, int], source: KernelSource, lanes: int) -> bytes:
    """Return states and measurements of 16 machines after each of 200 steps, by a kernel's functions."""
    rng = np.random.default_rng(0)
    nominal = np.array(list(source.machine.parameters.values()))
    parameters = nominal[:, None] * rng.uniform(0.8, 1.2, (len(nominal), 16))
    voltages = 8.0 * rng.normal(size=(200, len(source.machine.drives), 16))
    seen = np.zeros((200, source.states + len(source.machine.sensors), 16))
    for first in range(0, 16, lanes):
        block = slice(first, first + lanes)
        constants = np.ascontiguousarray(parameters[:, block])
        derived = np.zeros((len(source.layout.derived), lanes))
        state = np.zeros((source.states, lanes))
        forces = np.zeros((len(source.machine.coordinates), lanes))
        measured = np.zeros((len(source.machine.sensors), lanes))
        call(addresses["prepare"], constants, derived, 1e-3)
        for step in range(200):
            held = np.ascontiguousarray(voltages[step, :, block])
            call(addresses["advance"], state, constants, derived, held, forces, 1e-3, 1)
            call(addresses["read_sensors"], state, constants, measured)
            seen[step, :, block] = np.concatenate([state, measured])
    assert np.isfinite(seen).all()
    assert np.ptp(seen[-1], axis=1).max() > 0.0
    return seen.tobytes()


@pytest.mark.parametrize(("features", "lanes"), FEATURES.values(), ids=FEATURES)
def test_the_kernel_of_every_processor_gives_the_same_bits(
    features: str, lanes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compile for processors with fewer features than this one."""
    skip_without(features)
    text, source = generate_kernel(cogging_machine())
    here = states_and_measurements(LaneProgram(text, FUNCTIONS).addresses, source, LANES)
    monkeypatch.setattr(machine_code, "processor", lambda: ("generic", features))
    engine = machine_code._load(machine_code._compile(compile_lanes(text, FORMULAS, lanes)))
    addresses = {name: engine.get_function_address(name) for name in FUNCTIONS}
    assert states_and_measurements(addresses, source, lanes) == here


# Simulates a machine with every kind of branch, and means of the voltages over its drives' delay; prints all
# bits.
_SIMULATION = """
import hashlib, numpy as np, hframe_gym
from hframe_gym.dynamics import LANES, simulate_batch
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.effects import EFFECTS
cogging = EFFECTS["cogging"].at("motor1", A=0.01, n=6.0, p=0.3)
machine = BUILTIN_MACHINES["hframe"]().with_effects(cogging, EFFECTS["input_delay"].at("drives", d=0.0023))
time_s = np.arange(200) * 1e-3
voltages = 8.0 * np.random.default_rng(0).normal(size=(200, 2))
digest = hashlib.sha256(b"".join(part.tobytes() for part in simulate_batch(machine, time_s, voltages)))
print(LANES, digest.hexdigest())
"""
_ENVIRONMENT = """
import gymnasium as gym
envs = gym.make_vec("HFrame-v0", num_envs=5, sensors="rig", randomize="default")
observation, _ = envs.reset(seed=1)
for action in np.random.default_rng(1).uniform(-1, 1, (30, 5, 2)).astype(np.float32):
    observation = envs.step(action)[0]
digest.update(b"".join(observation[key].tobytes() for key in sorted(observation)))
print(digest.hexdigest())
"""


def printed_by(script: str, **variables: str) -> list[str]:
    """Return the words that a script prints in a process with these environment variables."""
    environment = os.environ | variables
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True
    )
    return run.stdout.split()


@pytest.mark.parametrize(
    ("features", "lanes", "script"),
    [
        pytest.param(*FEATURES["baseline"], _SIMULATION, id="baseline"),
        # All loops around the kernels are compiled anew, which takes longest.
        *(
            pytest.param(
                *FEATURES[name], _SIMULATION + _ENVIRONMENT, id=f"{name}, environment", marks=pytest.mark.slow
            )
            for name in FEATURES
        ),
    ],
)
def test_the_loops_of_every_processor_give_the_same_bits(
    features: str, lanes: int, script: str, tmp_path: Path
) -> None:
    """Loops around the kernels are compiled for the processor as well."""
    skip_without(features)
    width, *bits = printed_by(
        script, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES=features, NUMBA_CACHE_DIR=str(tmp_path)
    )
    assert width == str(lanes)
    assert bits == printed_by(script)[1:]
