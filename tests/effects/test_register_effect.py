"""An effect that is defined outside the library works like those of the library."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import effect_forces, simulate
from hframe_gym.dynamics.elementwise import maximum, sign, sin, tanh
from hframe_gym.effects import EFFECTS, effect_sites, get_effect, register_effect, unregister_effect
from hframe_gym.machine import BUILTIN_MACHINES, Effect, EffectParameter, Machine, Sensor

EXPONENT = 3


def _cubed(v):  # type: ignore[no-untyped-def]
    return v**EXPONENT


def drag(v, c):  # type: ignore[no-untyped-def]
    """Return -c v^3 in forward direction; a formula with a constant and a helper function of its module."""
    return -c * maximum(_cubed(v), 0.0)


TOY = Effect(
    name="toy_drag",
    site="coordinate",
    formula="f = -c max(v, 0)^3",
    source="this test",
    force=drag,
    parameters=(EffectParameter("c", "1", 0.0, 1e6, scale=1.0, role="amplitude"),),
)


def ripple(r, q, a, n):  # type: ignore[no-untyped-def]
    """Return the measurement r (1 + a sin(n q)) of a tachometer; q: angle, rad."""
    return r * (1.0 + a * sin(n * q))


RIPPLE = Effect(
    name="toy_ripple",
    family="toy_ripple",
    site="sensor",
    formula="measurement = r (1 + a sin(n q))",
    source="this test",
    measurement=ripple,
    fits_site=lambda machine, site: not machine.measures_position(site),
    parameters=(
        EffectParameter("a", "1", -1.0, 1.0, scale=0.01, role="amplitude"),
        EffectParameter("n", "rad/position", 0.0, 1e3, scale=1.0),
    ),
)


@pytest.fixture
def toy() -> Iterator[Effect]:
    """Register the effect for one test."""
    yield register_effect(TOY)
    unregister_effect(TOY.name)


def test_registered_effect_is_listed(toy: Effect, hframe: Machine) -> None:
    """The library's mapping, look-up by name, and sites."""
    assert EFFECTS["toy_drag"] is get_effect("toy_drag") is toy
    assert effect_sites(toy, hframe) == hframe.coordinate_names


def test_registered_effect_acts_in_the_kernel(toy: Effect, hframe: Machine) -> None:
    """The kernel slows the carriage down, and the equations give the formula's force."""
    time_s, inputs = np.arange(200) * 1e-3, np.full((200, 2), (6.0, -6.0))
    machine = hframe.with_effects(toy.at("x", c=500.0))
    motion, plain = simulate(machine, time_s, inputs), simulate(hframe, time_s, inputs)
    speed = motion.velocities[:, 0]
    assert abs(speed[-1]) > 0.1
    force = effect_forces(machine, time_s, motion.positions, motion.velocities, inputs)[:, 0]
    np.testing.assert_allclose(force, -500.0 * np.maximum(speed**3, 0.0), atol=1e-9)
    assert (speed[-1] < 0.0) == (np.abs(force).max() == 0.0)
    difference = np.abs(motion.positions - plain.positions).max()
    assert (difference == 0.0) if speed[-1] < 0.0 else (difference > 1e-3)


def test_an_effect_of_a_speed_sensor_depends_on_the_position_of_what_it_measures(hframe: Machine) -> None:
    machine = hframe.with_components(Sensor("w1_rad_s", {"phi1": 1.0}, kind="speed"))
    machine = machine.with_effects(RIPPLE.at("w1_rad_s", a=0.2, n=3.0))
    motion = simulate(machine, np.arange(100) * 1e-3, np.full((100, 2), (6.0, -6.0)))
    speed, angle = motion.velocities[:, 2], motion.positions[:, 2]
    assert np.ptp(3.0 * angle) > 1.0
    np.testing.assert_allclose(motion.outputs[:, -1], speed * (1.0 + 0.2 * np.sin(3.0 * angle)), atol=1e-9)


def test_an_effect_says_itself_which_kinds_of_sensors_it_fits(hframe: Machine) -> None:
    """The library's fit positions, another one may fit a speed; a current has no coordinate of its own."""
    speed = Sensor("w1_rad_s", {"phi1": 1.0}, kind="speed")
    machine = hframe.with_components(speed, Sensor("i1_A", {"motor1": 1.0}, kind="current"))
    others = {"w1_rad_s", "i1_A"}
    assert set(effect_sites(RIPPLE, machine)) == others
    library = [effect for effect in EFFECTS.values() if effect.site == "sensor"]
    assert library
    assert not any(others & set(effect_sites(effect, machine)) for effect in library)


def test_name_can_be_registered_once(toy: Effect) -> None:
    """A second definition of the same name is an error, the same definition is not."""
    assert register_effect(toy) is toy
    with pytest.raises(ValueError, match="registered already"):
        register_effect(dataclasses.replace(toy, formula="f = 0"))


def test_library_cannot_be_changed_by_assignment() -> None:
    """Registration is the only way in."""
    with pytest.raises(TypeError):
        EFFECTS["toy_drag"] = TOY  # type: ignore[index]


def with_force(force: Callable[..., Any]) -> Machine:
    """Return the axis with an effect of a given force, which is not registered."""
    axis = BUILTIN_MACHINES["axis"]()
    return axis.with_effects(
        dataclasses.replace(TOY, name=f"toy_{force.__name__}", force=force).at("x", c=0.8)
    )


def smooth_friction(v, c):  # type: ignore[no-untyped-def]
    """Return a friction force that changes smoothly at rest, with all functions of the sign."""
    return -c * tanh(v / 0.01) * abs(sign(v))


def with_numpy(v, c):  # type: ignore[no-untyped-def]
    """Return a force by a function that cannot be compiled."""
    return -c * np.tanh(v / 0.01)


def with_modulo(v, c):  # type: ignore[no-untyped-def]
    """Return a force by an operator that cannot be compiled."""
    return -c * (v % 0.1)


def with_interpolation(v, c):  # type: ignore[no-untyped-def]
    """Return a force by a function of NumPy that is written in Python."""
    return -c * np.interp(v, [0.0, 1.0], [0.0, 1.0])


def with_math(v, c):  # type: ignore[no-untyped-def]
    """Return a force by a function of numbers."""
    return -c * math.tanh(v)


def with_branch(v, c):  # type: ignore[no-untyped-def]
    """Return a force that branches on the speed."""
    return -c if v > 0.0 else c


def test_tanh_and_sign_act_in_the_kernel() -> None:
    """At a speed well above 0.01 m/s, the effect is Coulomb friction."""
    time_s, inputs = np.arange(400) * 1e-3, np.full((400, 1), 3.0)
    machine = with_force(smooth_friction)
    plain = machine.replace(effects=())
    coulomb = plain.replace({"x.coulomb": plain.coordinates[0].coulomb + 0.8})
    smooth, dry, free = (simulate(m, time_s, inputs).outputs[-1, 0] for m in (machine, coulomb, plain))
    assert smooth == pytest.approx(dry, abs=0.02 * (free - dry))


def with_missing_argument(v, c):  # type: ignore[no-untyped-def]
    """Return a force by a function that lacks an argument."""
    return -c * maximum(v)  # type: ignore[call-arg]


def with_text(v, c):  # type: ignore[no-untyped-def]
    """Return a force that is indexed by mistake."""
    return -c * v["speed"]


ADVICE = "; use the functions of hframe_gym.dynamics.elementwise"


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (with_numpy, f"operand 'Expression' does not support ufuncs (__array_ufunc__=None){ADVICE}"),
        (with_modulo, f"unsupported operand type(s) for %: 'Expression' and 'float'{ADVICE}"),
        (with_interpolation, f"float() argument must be a string or a real number, not 'Expression'{ADVICE}"),
        (
            with_branch,
            "a formula cannot branch on its arguments "
            "(`hframe_gym.dynamics.elementwise.where` selects a value)",
        ),
        (with_missing_argument, "maximum() missing 1 required positional argument: 'b'"),
        (with_text, "'Expression' object is not subscriptable"),
    ],
)
def test_a_formula_that_cannot_be_compiled_is_named(force: Callable[..., Any], message: str) -> None:
    """The error names effect, hook and line; it gives advice only where other functions or operators help."""
    line = force.__code__.co_firstlineno + 2
    with pytest.raises(TypeError) as caught:
        simulate(with_force(force), np.arange(10) * 1e-3, np.zeros((10, 1)))
    assert (
        str(caught.value) == f"toy_{force.__name__}@x, force: test_register_effect.py, line {line}: {message}"
    )


def without_result(v, c):  # type: ignore[no-untyped-def]
    """Compute a force, and forget to return it."""
    c * v


def test_a_formula_that_returns_nothing_is_named() -> None:
    with pytest.raises(TypeError, match="toy_without_result@x, force: the formula returns nothing"):
        simulate(with_force(without_result), np.arange(3) * 1e-3, np.zeros((3, 1)))


def test_a_function_of_numbers_fails_with_advice_on_arrays_as_well() -> None:
    message = rf"toy_with_math@x, force: test_register_effect.py, line \d+: only .* arrays .*{ADVICE}$"
    time_s, column = np.arange(3) * 1e-3, np.zeros((3, 1))
    with pytest.raises(TypeError, match=message):
        effect_forces(with_force(with_math), time_s, column, column, column)
