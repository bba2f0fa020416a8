"""Input shapers leave no vibration in the closed form of an oscillator and on the simulated carriage."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from hframe_gym.exporters import EXPORTERS
from hframe_gym.exporters.models.input_shapers import SHAPERS, AxisMode, InputShaperExporter, Shaper, impulses
from hframe_gym.exporters.models.linear_model import linear_model
from hframe_gym.machine import Machine, Uncertainty
from hframe_gym.recordings import load_machine


def vibration(shaper: Shaper, frequency: float, damping: float, of_mode: float) -> float:
    """Return the vibration a shaped step leaves, over that of a step: Singer and Seering (1990), eq. 6."""
    times, sizes = impulses(shaper, frequency, damping)
    w = 2.0 * np.pi * of_mode
    phasors = sizes * np.exp((damping * w + 1j * w * np.sqrt(1.0 - damping**2)) * (times - times[-1]))
    return float(np.abs(np.sum(phasors)))


@pytest.mark.parametrize("damping", [0.0, 0.03, 0.15])
@pytest.mark.parametrize("shaper", SHAPERS)
def test_a_shaper_leaves_the_vibration_that_it_is_designed_for(shaper: Shaper, damping: float) -> None:
    _, sizes = impulses(shaper, 40.0, damping)
    assert np.sum(sizes) == pytest.approx(1.0)
    if shaper == "ei":
        assert vibration(shaper, 40.0, damping, 40.0) < 0.05 + 1e-9
    else:
        assert vibration(shaper, 40.0, damping, 40.0) == pytest.approx(0.0, abs=1e-12)


def test_ei_tolerates_the_largest_error_of_the_frequency() -> None:
    left = [max(vibration(shaper, 40.0, 0.0, f) for f in (36.0, 44.0)) for shaper in ("zv", "mzv", "ei")]
    assert left[0] > left[1] > left[2]


@pytest.mark.parametrize("name", ["hframe", "corexy"])
def test_a_shaped_step_of_the_motors_leaves_the_carriage_at_rest(name: str) -> None:
    """The carriage on its belts, simulated with motors that follow the shaped step."""
    machine = load_machine(name)
    model = linear_model(machine, np.zeros(4))
    free, held = [0, 1], [2, 3]
    rows = [*free, 4, 5]
    A, B = model.A[np.ix_(rows, rows)], model.A[np.ix_(rows, held)]
    time_s = np.arange(4001) * 1e-4
    [modes] = [[m for m in EXPORTERS.get("klipper")(machine=name).axis_modes(machine) if m.axis == "y"]]  # type: ignore[call-arg, attr-defined]
    rigid = np.linalg.solve(-A[2:, :2], B[2:] @ np.eye(2))  # tool positions per motor position
    motors = np.linalg.solve(rigid, [0.0, 1.0])  # a step along y

    def left(times: np.ndarray, sizes: np.ndarray) -> float:
        inputs = sum(np.outer(time_s >= t, s * motors) for t, s in zip(times, sizes, strict=True))
        _, y, _ = lsim(StateSpace(A, B, np.eye(4)[:2], np.zeros((2, 2))), inputs, time_s, interp=False)
        late = time_s > 1.2 / modes[0].frequency
        return float(np.abs(y[late, 1] - 1.0).max())

    unshaped = left(np.zeros(1), np.ones(1))
    assert unshaped > 0.1
    for shaper in ("zv", "mzv"):
        assert left(*impulses(shaper, modes[0].frequency, modes[0].damping)) < 0.05 * unshaped


def test_klipper_and_marlin_state_the_same_modes() -> None:
    texts = {}
    for kind in ("klipper", "marlin"):
        exporter = EXPORTERS.get(kind)(machine="corexy")  # type: ignore[call-arg]
        assert isinstance(exporter, InputShaperExporter)
        texts |= exporter.files(load_machine("corexy"))
    settings = dict(re.findall(r"^(\w+): (\S+)$", str(texts["input_shaper.cfg"]), re.MULTILINE))
    gcode = re.findall(r"^M593 (\w) F(\S+) D(\S+)$", str(texts["input_shaping.gcode"]), re.MULTILINE)
    defined = dict(re.findall(r"^#define SHAPING_(\w+) (\S+)f$", str(texts["input_shaping.h"]), re.MULTILINE))
    assert settings["shaper_type_x"] == settings["shaper_type_y"] == "mzv"
    for letter, frequency, damping in gcode:
        axis = letter.lower()
        assert settings[f"shaper_freq_{axis}"] == frequency == defined[f"FREQ_{letter}"]
        assert settings[f"damping_ratio_{axis}"] == damping == defined[f"ZETA_{letter}"]
    assert "[input_shaper]" in str(texts["input_shaper.cfg"])
    rows = str(texts["input_shaper.csv"]).splitlines()
    assert sum(row.startswith("x,mzv,") for row in rows) == 3


def test_an_identified_machine_has_standard_deviations() -> None:
    machine = load_machine("corexy")
    EA = machine.parameters["belt1_short.EA"]
    names = tuple(name for name in machine.parameters if name.endswith(".EA"))
    identified = dataclasses.replace(
        machine,
        uncertainty=Uncertainty(names, np.full((4, 4), (0.02 * EA) ** 2)),  # one common error of 2 %
    )
    found: list[AxisMode] = EXPORTERS.get("klipper")(machine=identified).axis_modes(identified)  # type: ignore[call-arg, attr-defined]
    for mode in found:  # a frequency is the square root of a stiffness
        assert mode.frequency_std == pytest.approx(0.01 * mode.frequency, rel=0.02)
        assert "standard deviation" in mode.described


def test_the_stiffness_at_the_place_counts(hframe: Machine) -> None:
    def frequency(*at: str) -> float:
        exporter = EXPORTERS.get("klipper")(at=list(at))  # type: ignore[call-arg]
        return float(exporter.axis_modes(hframe)[0].frequency)  # type: ignore[attr-defined]

    assert frequency("x=0.25") != pytest.approx(frequency(), rel=1e-3)


@pytest.mark.parametrize("kind", ["klipper", "marlin"])
def test_settings_of_a_machine_that_was_not_identified_say_so(kind: str) -> None:
    machine = load_machine("corexy")
    identified = machine.replace(uncertainty=Uncertainty(("x.mass",), np.array([[1e-4]])))
    exporter = EXPORTERS.get(kind)(machine="corexy")  # type: ignore[call-arg]
    for content in exporter.files(machine).values():
        assert "NOT MEASURED: frequencies and damping follow from the values" in content
    for content in exporter.files(identified).values():
        assert "NOT MEASURED" not in content
