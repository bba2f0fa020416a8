"""Names in a machine file are labels: no names, and no order of factors, change a result by one bit."""

from __future__ import annotations

import builtins
import dataclasses
import keyword
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_gym.dynamics import (
    kernel_source_text,
    linearize,
    mode_frequencies,
    net_forces,
    sensor_readings,
    simulate,
)
from hframe_gym.effects import EFFECTS, effect_sites, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.envs import HFrameEnv
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine, draw_machine
from hframe_gym.recordings import load_machine, save_machine
from tests.effects.one_of_each import CASES, history

TABLE = {f"k{i:02d}": 0.01 * i for i in range(KNOTS)} | {f"f{i:02d}": 0.1 * i for i in range(KNOTS)}
# Coordinates that structural effects name themselves.
ADDED = {"yaw", "frame", *(f"phi{i}" for i in range(3, 9))}
# Each with effects at sites of every kind, on single components and on all at once, and with each structural
# effect.
EFFECTS_OF_MACHINES: dict[str, tuple[str, Sequence[tuple[str, str, Mapping[str, float]]]]] = {
    "many effects": (
        "hframe",
        (
            ("stribeck_friction", "x", {"dF": 3.0, "vs": 0.04}),
            ("asymmetric_viscous", "phi1", {"a": -0.4}),
            ("cogging", "motor1", {"A": 0.03, "n": 23.6, "p": 0.5}),
            ("eccentric_pulley", "motor2", {"e": 0.2e-3, "p": 0.7}),
            ("dead_band", "motor1", {"Vd": 0.4, "drop": 1.0}),
            ("electrical_lag", "drives", {"tau": 1.5e-3}),
            ("input_delay", "drives", {"d": 2.3e-3}),
            ("belt_play", "left", {"d": 0.15e-3}),
            ("belt_damping", "belts", {"c": 1e-3}),
            ("sensor_skew", "y_m", {"a": 5e-3}),
            ("sensor_delay", "x_m", {"d": 2.3e-3}),
            ("smooth_force[position of y]", "x", TABLE),
            ("smooth_friction[path of x]", "y", TABLE),
        ),
    ),
    "yaw": ("hframe", (("bridge_yaw", "machine", CASES["bridge_yaw"].parameters),)),
    "idlers": ("hframe", (("idler_inertia", "machine", CASES["idler_inertia"].parameters),)),
    "frame": ("corexy", (("frame_resonance", "x", CASES["frame_resonance"].parameters),)),
}


def with_effects(machine: Machine, name: str, new: Mapping[str, str]) -> Machine:
    """Return a machine with the effects of an entry of `EFFECTS_OF_MACHINES` at renamed sites."""
    effects = []
    for effect, site, parameters in EFFECTS_OF_MACHINES[name][1]:
        variable, of, coordinate = effect.removesuffix("]").partition(" of ")
        effects.append(
            get_effect(f"{variable} of {new[coordinate]}]" if of else effect).at(
                new.get(site, site), **parameters
            )
        )
    return machine.with_effects(*effects)


def labels_of(machine: Machine) -> tuple[str, ...]:
    """Return the names of coordinates, belts, drives, input and output channels, all different ones."""
    names = [c.name for c in (*machine.coordinates, *machine.belts, *machine.drives)]
    return (*names, *machine.input_channels, *machine.output_channels)


def relabeled(machine: Machine, new: Mapping[str, str], reverse_rows: bool = False) -> Machine:
    """Return a machine with other names, and perhaps its factors in the reverse order."""

    def row(factors: Mapping[str, float]) -> dict[str, float]:
        items = [(new[name], factor) for name, factor in factors.items()]
        return dict(reversed(items) if reverse_rows else items)

    def parameter(full_name: str) -> str:
        owner, _, key = full_name.rpartition(".")
        return f"{new[owner]}.{key}"

    return dataclasses.replace(
        machine,
        name="renamed",
        ties={parameter(tied): (parameter(free), factor) for tied, (free, factor) in machine.ties.items()},
        coordinates=tuple(dataclasses.replace(c, name=new[c.name]) for c in machine.coordinates),
        belts=tuple(
            dataclasses.replace(b, name=new[b.name], extension=row(b.extension), length=row(b.length))
            for b in machine.belts
        ),
        drives=tuple(
            dataclasses.replace(d, name=new[d.name], channel=new[d.channel], coordinate=new[d.coordinate])
            for d in machine.drives
        ),
        sensors=tuple(
            dataclasses.replace(s, channel=new[s.channel], row=row(s.row)) for s in machine.sensors
        ),
        effects=tuple(dataclasses.replace(e, site=new.get(e.site, e.site)) for e in machine.effects),
    )


@cache
def original(name: str) -> tuple[Machine, str]:
    """Return a machine with its original names, and its generated source."""
    machine = BUILTIN_MACHINES[name]() if name in BUILTIN_MACHINES else _composed(name)
    return machine, kernel_source_text(machine)


def _composed(name: str) -> Machine:
    preset = BUILTIN_MACHINES[EFFECTS_OF_MACHINES[name][0]]()
    return with_effects(preset, name, {label: label for label in labels_of(preset)})


def renamed(name: str, names: Sequence[str], reverse_rows: bool = False) -> Machine:
    """Return a machine of `original` with the first of some names in place of its names."""
    preset = BUILTIN_MACHINES[EFFECTS_OF_MACHINES[name][0] if name in EFFECTS_OF_MACHINES else name]()
    new = dict(zip(labels_of(preset), names, strict=False))
    # A belt that is called "belts", or a drive "drives", comes before all of them as the site of an effect.
    for component, word in (*((b, "belts") for b in preset.belts), *((d, "drives") for d in preset.drives)):
        if new[component.name] == word:
            new[component.name] = f"{word}_"
    machine = relabeled(preset, new, reverse_rows)
    return with_effects(machine, name, new) if name in EFFECTS_OF_MACHINES else machine


MACHINES = (*BUILTIN_MACHINES, *EFFECTS_OF_MACHINES)
COUNT = max(len(labels_of(machine())) for machine in BUILTIN_MACHINES.values())
# Words of the generated source, of Python, NumPy and Numba, the names of all presets (so that names are
# exchanged), words that sites of effects use, and names that once collided with local variables.
WORDS = sorted(
    {
        *re.findall(r"[A-Za-z_]\w*", original("many effects")[1]),
        *keyword.kwlist,
        *keyword.softkwlist,
        *dir(builtins),
        *np.__all__,
        *dir(numba),
        *(label for machine in BUILTIN_MACHINES.values() for label in labels_of(machine())),
        *("drives", "belts", "machine", "time", "velocity", "position", "path", "mass", "EA", "Kt", "noise"),
        *("a", "b", "f", "h", "k", "m", "q", "s", "v", "w", "z", "first", "last", "state", "step"),
    }
    - ADDED
)
SIZE = {"min_size": COUNT, "max_size": COUNT, "unique": True}
IDENTIFIERS = st.text("aA_0", min_size=1, max_size=5).map("_".__add__)
NEW_NAMES = st.lists(st.sampled_from(WORDS), **SIZE) | st.lists(IDENTIFIERS, **SIZE)
# The names that once changed the simulated encoder readings by 0.26 rad, and others that are likely to
# collide.
_COLLISIONS = """
s y a last first right bottom f motor2 v_1 v_2 phi1_rad phi2_rad x_m y_m
x s phi2 phi1 right left bottom motor2 motor1 v2_V v1_V phi2_rad phi1_rad y_m x_m
y x phi2 phi1 bottom left right motor2 motor1 v2_V v1_V y_m x_m phi2_rad phi1_rad
step h time load state exp where lambda None drives belts class self array float64
drives belts machine prange njit p0 travel_0 speed_1 half_step x y phi1 phi2 motor1 left
"""
COLLISIONS = [line.split() for line in _COLLISIONS.split("\n") if line]


@pytest.mark.parametrize("name", MACHINES)
@settings(max_examples=15, deadline=None)
@given(names=NEW_NAMES, reverse_rows=st.booleans())
def test_no_name_reaches_the_kernel_or_the_linear_model(
    name: str, names: list[str], reverse_rows: bool
) -> None:
    """The source is equal for all names and with it every bit of a simulation; so are the parameters."""
    machine, text = original(name)
    other = renamed(name, names, reverse_rows)
    assert kernel_source_text(other) == text
    assert list(other.parameters.values()) == list(machine.parameters.values())
    assert list(other.device_parameters.values()) == list(machine.device_parameters.values())
    assert [other.unit(p) for p in other.parameters] == [machine.unit(p) for p in machine.parameters]
    for matrix, expected in zip(linearize(other), linearize(machine), strict=True):
        np.testing.assert_array_equal(matrix, expected)
    np.testing.assert_array_equal(mode_frequencies(other), mode_frequencies(machine))


@pytest.mark.parametrize("name", ["many effects", "yaw"])
@settings(max_examples=10, deadline=None)
@given(names=NEW_NAMES)
def test_simulation_and_forces_are_equal_to_the_bit(name: str, names: list[str]) -> None:
    """All examples share one compiled kernel."""
    check_simulation(name, names)


@pytest.mark.parametrize("names", COLLISIONS)
def test_names_that_are_likely_to_collide_change_nothing(names: list[str]) -> None:
    check_simulation("many effects", [*names, *(f"other_{i}" for i in range(COUNT))])


def check_simulation(name: str, names: Sequence[str]) -> None:
    """Compare trajectories and forces of a machine with those of the renamed one."""
    time_s, inputs = history(1, seconds=0.12)
    machine, other = original(name)[0], renamed(name, names)
    expected, actual = (simulate(m, time_s, inputs) for m in (machine, other))
    np.testing.assert_array_equal(actual.outputs, expected.outputs)
    np.testing.assert_array_equal(actual.velocities, expected.velocities)
    forces = [
        net_forces(m, time_s, expected.positions, expected.velocities, inputs) for m in (machine, other)
    ]
    np.testing.assert_array_equal(forces[1], forces[0])


@pytest.mark.parametrize("name", ["hframe", "axis", "corexy"])
@settings(max_examples=8, deadline=None)
@given(names=NEW_NAMES)
def test_environment_steps_are_equal_to_the_bit(name: str, names: list[str]) -> None:
    """Goals, randomized parameters, observations with sensors, rewards and the critic's observation."""
    np.testing.assert_array_equal(steps(renamed(name, names)), steps(original(name)[0]))


@pytest.mark.parametrize("names", COLLISIONS)
def test_environment_with_effects_does_not_depend_on_names(names: list[str]) -> None:
    machines = (
        original("many effects")[0],
        renamed("many effects", [*names, *(f"other_{i}" for i in range(COUNT))]),
    )
    expected, actual = (steps(machine) for machine in machines)
    np.testing.assert_array_equal(actual, expected)


def steps(machine: Machine) -> np.ndarray:
    """Return the observations and rewards of some steps of two episodes as one array."""
    env = HFrameEnv(machine=machine, randomize="default", sensors="machine", privileged=True)
    rng, values = np.random.default_rng(0), []
    for seed in (3, 4):
        observation, _ = env.reset(seed=seed)
        for _ in range(5):
            values += [np.ravel(part) for part in observation.values()]
            observation, reward, *_ = env.step(rng.uniform(-1.0, 1.0, len(machine.drives)).astype(np.float32))
            values.append(np.array([float(reward)]))
    return np.concatenate(values)


@settings(max_examples=10, deadline=None)
@given(names=NEW_NAMES)
def test_a_search_tries_the_same_effects_at_the_same_components(names: list[str]) -> None:
    """By the index of the component, because its name differs."""
    machine, other = original("hframe")[0], renamed("hframe", names)
    old_names, new_names = labels_of(machine), labels_of(other)
    for effect in EFFECTS.values():
        sites, new_sites = effect_sites(effect, machine), effect_sites(effect, other)
        new = dict(zip(old_names, new_names, strict=True))
        assert new_sites == tuple(new.get(site, site) for site in sites), effect.name


@pytest.mark.parametrize("name", ["many effects", "yaw", "frame"])
def test_a_file_with_other_names_gives_the_same_machine(name: str, tmp_path: Path) -> None:
    names = [f"{word}_" if word in ("drives", "belts") else word for word in COLLISIONS[3]]
    machine = renamed(name, [*names, *(f"other_{i}" for i in range(COUNT))])
    save_machine(machine, tmp_path / "machine.json")
    read = load_machine(tmp_path / "machine.json")
    assert kernel_source_text(read) == original(name)[1]
    assert list(read.parameters.values()) == list(machine.parameters.values())


def test_a_renamed_stage_is_drawn() -> None:
    draw_machine(renamed("hframe", COLLISIONS[3]))


def test_a_name_that_an_effect_adds_is_refused() -> None:
    """A machine with two coordinates of one name would be simulated wrongly without a word."""
    machine = renamed("hframe", ["frame", *labels_of(original("hframe")[0])[1:]])
    with pytest.raises(ValueError, match="frame_resonance: does not fit"):
        machine.with_effects(EFFECTS["frame_resonance"].at("frame", **CASES["frame_resonance"].parameters))


def test_a_file_whose_effect_lacks_its_coordinate_is_refused(tmp_path: Path) -> None:
    """Without the coordinate `yaw` the spring of the bridge would act on nothing."""
    path = tmp_path / "machine.json"
    save_machine(original("yaw")[0], path)
    path.write_text(re.sub(r"(?<!bridge_)\byaw\b", "psi", path.read_text()))
    with pytest.raises(
        InputError, match=r"effects.bridge_yaw: the effect needs a coordinate that is called 'yaw'"
    ):
        load_machine(path)


def test_a_channel_with_the_name_of_another_component_is_that_channel(tmp_path: Path) -> None:
    """The laser of x is called like the pulley phi1; its scale has the laser's units and acts on it alone."""
    names = list(labels_of(original("hframe")[0]))
    names[names.index("x_m")], names[names.index("y_m")] = "phi1", "motor1"
    machine = renamed("hframe", names).with_effects(
        EFFECTS["sensor_range"].at("phi1", low=-0.01, high=0.01), EFFECTS["sensor_skew"].at("motor1", a=5e-3)
    )
    assert machine.unit("sensor_range@phi1.low") == "m"
    save_machine(machine, tmp_path / "machine.json")
    read = load_machine(tmp_path / "machine.json")
    readings = sensor_readings(read, np.array([0.5, 0.2, 0.3, 0.4]))
    np.testing.assert_allclose(readings, [0.3, 0.4, 0.01, 0.2 + 5e-3 * 0.5])


def test_axes_in_an_unusual_order_are_pointed_out(tmp_path: Path) -> None:
    machine = original("corexy")[0]
    first, second, *rest = machine.coordinates
    save_machine(dataclasses.replace(machine, coordinates=(second, first, *rest)), tmp_path / "machine.json")
    with pytest.warns(
        UserWarning, match="y comes before x, so it is the first axis of the tool: list x first"
    ):
        load_machine(tmp_path / "machine.json")
