"""Names in a machine file are labels: no choice of names changes a simulation."""

from __future__ import annotations

import dataclasses
import keyword
import re
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_gym.dynamics import kernel_source_text, simulate
from hframe_gym.effects import EFFECTS, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine

pytestmark = pytest.mark.unit


def with_many_effects() -> Machine:
    """Return the H-frame with effects at every kind of site."""
    table = {f"k{i:02d}": 0.01 * i for i in range(KNOTS)} | {f"f{i:02d}": 0.1 * i for i in range(KNOTS)}
    return BUILTIN_MACHINES["hframe"]().with_effects(
        EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.04),
        EFFECTS["asymmetric_viscous"].at("phi1", a=-0.4),
        EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
        EFFECTS["electrical_lag"].at("motor2", tau=1.5e-3),
        EFFECTS["sensor_skew"].at("y_m", a=5e-3),
        get_effect("smooth_force[position of y]").at("x", **table),
    )


MACHINE = with_many_effects()
NAMES = (
    *MACHINE.coordinate_names,
    *(b.name for b in MACHINE.belts),
    *(d.name for d in MACHINE.drives),
    *MACHINE.output_channels,
)
# Words that generated source contains, Python's keywords, and names that once collided with local variables.
WORDS = sorted({*re.findall(r"[A-Za-z_]\w*", kernel_source_text(MACHINE)), *keyword.kwlist, *["a", "b", "f", "h", "k", "m", "q", "s", "v", "w", "z"]})  # fmt: skip  # noqa: E501
# "*" separates the factors of a product in a sensor's row, "[", "]" and " of " are part of a table's name.
FREE_TEXT = st.text(st.characters(blacklist_characters="*[]@", blacklist_categories=("Cs",)), min_size=1, max_size=8)
NEW_NAMES = st.lists(
    st.one_of(st.sampled_from(WORDS), FREE_TEXT.filter(lambda text: " of " not in text)),
    min_size=len(NAMES),
    max_size=len(NAMES),
    unique=True,
)


def renamed(machine: Machine, new: Mapping[str, str]) -> Machine:
    """Return the machine with other names everywhere: components, rows, sites, variables of tables."""
    coordinates = tuple(dataclasses.replace(c, name=new[c.name]) for c in machine.coordinates)
    belts = tuple(
        dataclasses.replace(
            b,
            name=new[b.name],
            extension={new[c]: g for c, g in b.extension.items()},
            length={new[c]: g for c, g in b.length.items()},
        )
        for b in machine.belts
    )
    drives = tuple(dataclasses.replace(d, name=new[d.name], coordinate=new[d.coordinate]) for d in machine.drives)
    sensors = tuple(
        dataclasses.replace(s, channel=new[s.channel], row={new[c]: g for c, g in s.row.items()})
        for s in machine.sensors
    )
    effects = []
    for e in machine.effects:
        variable, of, coordinate = e.definition.against.partition(" of ")
        definition = e.definition
        if of:
            definition = get_effect(f"smooth_force[{variable} of {new[coordinate]}]")
        effects.append(definition.at(new[e.site], **e.parameters))
    return dataclasses.replace(
        machine, coordinates=coordinates, belts=belts, drives=drives, sensors=sensors, effects=tuple(effects)
    )


@settings(max_examples=40, deadline=None)
@given(NEW_NAMES)
def test_names_do_not_reach_the_kernel(names: list[str]) -> None:
    """The generated source is equal for all names, and with it every bit of a simulation."""
    machine = renamed(MACHINE, dict(zip(NAMES, names, strict=True)))
    assert kernel_source_text(machine) == kernel_source_text(MACHINE)
    assert list(machine.parameters.values()) == list(MACHINE.parameters.values())


@pytest.mark.parametrize(
    "names",
    [
        # These once changed the simulated encoder readings by up to 0.26 rad.
        ["x", "s", "a", "last", "first", "right", "bottom", "f", "motor2", "phi1_rad", "phi2_rad", "x_m", "y_m"],
        ["s", "y", "a", "last", "left", "right", "bottom", "f", "motor2", "phi1_rad", "phi2_rad", "x_m", "y_m"],
        ["step", "h", "time", "load", "state", "exp", "where", "lambda", "None", "belts", "drives", "class", "q 1/ü"],
    ],
)
def test_simulation_is_equal_to_the_bit(names: list[str]) -> None:
    """The same readings with names that collide with words of the generator."""
    time_s = np.arange(100) * 1e-3
    inputs = np.repeat(np.random.default_rng(1).uniform(-8.0, 8.0, (10, 2)), 10, axis=0)
    machine = renamed(MACHINE, dict(zip(NAMES, names, strict=True)))
    expected, actual = simulate(MACHINE, time_s, inputs), simulate(machine, time_s, inputs)
    np.testing.assert_array_equal(actual.outputs, expected.outputs)
    np.testing.assert_array_equal(actual.velocities, expected.velocities)
