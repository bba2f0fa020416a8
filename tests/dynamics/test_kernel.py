"""Generation, caching and layout of kernels."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.dynamics import LANES, in_blocks, kernel_for, kernel_source_text, simulate
from hframe_gym.dynamics.codegen import kernel, machine_code
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine

GOLDEN = Path(__file__).with_name("golden_kernel_hframe.py")


def test_golden_kernel_is_current() -> None:
    """The file lets reviewers read what a change of the generator changes.

    Regenerate it with `hframe kernel hframe > tests/dynamics/golden_kernel_hframe.py`.
    """
    assert GOLDEN.read_text() == kernel_source_text(BUILTIN_MACHINES["hframe"]())


def test_machines_of_one_shape_have_one_kernel(hframe: Machine) -> None:
    """Parameter values are data; a different value must not compile anything."""
    other = hframe.replace({"x.mass": 5.0, "left.EA": 1e4})
    assert kernel_for(hframe) is kernel_for(other)
    coordinates = tuple(dataclasses.replace(c, coulomb=0.0) for c in hframe.coordinates)
    assert kernel_for(hframe.replace(coordinates=coordinates)) is kernel_for(hframe)


@pytest.mark.parametrize(
    ("name", "site", "trace"),
    [
        ("stribeck_friction", "x", "exp("),
        ("quadratic_drag", "y", "absolute("),
        ("current_limit", "motor1", "ohmic_current_0 = "),
        ("input_delay", "drives", "step * 2 + 0"),
        ("belt_damping", "belts", "corrected_tension_0 = "),
    ],
)
def test_absent_effect_costs_nothing(name: str, site: str, trace: str, hframe: Machine) -> None:
    """The step of a machine without an effect contains no instruction of it."""

    def step(machine: Machine) -> str:
        text = kernel_source_text(machine)
        return text[text.index("def advance(") : text.index("def read_sensors(")]

    definition = EFFECTS[name]
    values = {p.name: max(p.lower, 0.01) for p in definition.parameters}
    assert trace in step(hframe.with_effects(definition.at(site, **values)))
    assert trace not in step(hframe)


def test_compiled_code_is_kept_on_disk(
    hframe: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second process loads it; another shape, and external forces, need other code."""
    monkeypatch.setenv("HFRAME_CACHE", str(tmp_path))
    monkeypatch.setattr(machine_code, "_LOADED", {})
    monkeypatch.setattr(kernel, "_KERNELS", {})
    first = kernel_for(hframe)
    (code,) = tmp_path.glob("kernel_*.o")
    kernel_for(hframe, forced=True)
    assert len(list(tmp_path.glob("kernel_*.o"))) == 2
    monkeypatch.setattr(kernel, "_KERNELS", {})
    monkeypatch.setattr(machine_code, "_compile", None)
    assert kernel_for(hframe).layout == first.layout
    assert code.stat().st_size > 1000


def test_blocks_repeat_the_last_machine_in_spare_lanes() -> None:
    """Three machines more than a block holds need two blocks."""
    values = np.arange(2.0 * (LANES + 3)).reshape(-1, 2)
    blocks = in_blocks(values)
    assert blocks.shape == (2, 2, LANES)
    np.testing.assert_array_equal(blocks[1, :, 2], values[-1])
    np.testing.assert_array_equal(blocks[1, :, LANES - 1], values[-1])


def test_states_of_effects_at_the_start(hframe: Machine) -> None:
    """The state of an effect follows positions and velocities; it decays over the distance L."""
    machine = hframe.with_effects(EFFECTS["dahl_hysteresis"].at("y", F=3.0, L=0.01))
    time_s, start = np.arange(400) * 1e-3, np.zeros(9)
    voltages = np.full((400, 2), 4.0)
    start[8] = 0.7
    moved = simulate(machine, time_s, voltages, start)
    zero = simulate(machine, time_s, voltages)
    # Until y has moved by L the force differs by 0.7 * 3 N, which delays the motion.
    assert not np.allclose(moved.positions, zero.positions, atol=1e-4)
    with pytest.raises(ValueError, match="initial has shape"):
        simulate(machine, time_s, voltages, np.zeros(10))


def test_every_effect_of_a_coordinate_has_a_kernel_on_a_single_axis() -> None:
    """With one coordinate, an effect may replace a force by a constant, for example dry friction by zero."""
    axis = BUILTIN_MACHINES["axis"]()
    for effect in EFFECTS.values():
        if effect.site != "coordinate" or not effect.possible_sites(axis) or effect.structure:
            continue
        values = {p.name: min(max(0.5, p.lower), p.upper) for p in effect.parameters}
        text = kernel_source_text(axis.with_effects(effect.at("x", **values)))
        assert "def " in text, effect.name


def test_a_machine_has_an_effect_only_once_at_a_site(hframe: Machine) -> None:
    cogging = EFFECTS["cogging"].at("motor1", A=0.02, n=10.0, p=0.0)
    with pytest.raises(ValueError, match="cogging@motor1: machine 'hframe' has it already"):
        hframe.with_effects(cogging, cogging)
