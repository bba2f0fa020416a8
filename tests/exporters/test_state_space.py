"""The exported linear model against the simulator, an oscillator's closed form, and other tools' files."""

from __future__ import annotations

import importlib.util
import io
import json

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import StateSpace, lsim

from hframe_gym.dynamics import linearize, mode_frequencies, simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.exporters import EXPORTERS
from hframe_gym.exporters.models.linear_model import axis_modes, linear_model, modes
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine
from tests.effects.one_of_each import CASES


def files(machine: Machine | str, **options: object) -> dict[str, str | bytes]:
    exporter = EXPORTERS.get("state-space")(machine=machine, **options)  # type: ignore[call-arg]
    return dict(exporter.files(exporter.loaded()))  # type: ignore[attr-defined]


def simulated_error(machine: Machine, size: float) -> float:
    """Return the largest difference of linear model and simulator over the largest motion of each output."""
    time_s = np.arange(301) * 1e-3
    inputs = size * np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, (31, 2)), 10, axis=0)[:301]
    model = linear_model(machine, np.zeros(len(machine.coordinates)))
    _, outputs, _ = lsim(StateSpace(model.A, model.B, model.C, model.D), inputs, time_s, interp=False)
    # Without the motion that constant forces cause, which the model states as `bias`.
    expected = simulate(machine, time_s, inputs).outputs - simulate(machine, time_s, 0.0 * inputs).outputs
    return float(np.max(np.abs(outputs - expected) / np.abs(expected).max(axis=0)))


def test_it_is_the_linearization_where_a_machine_has_no_effects(hframe: Machine) -> None:
    model, nominal = linear_model(hframe, np.zeros(4)), linearize(hframe)
    for key in "ABCD":
        np.testing.assert_array_equal(getattr(model, key), getattr(nominal, key))


@pytest.mark.parametrize(
    "name",
    ["belt_damping", "cable_spring", "bridge_yaw", "frame_resonance", "payload_swing", "idler_inertia"],
)
def test_the_simulator_moves_like_the_linear_model_with_effects(name: str) -> None:
    machine = load_machine("hframe-linear").with_effects(CASES[name].effect)
    assert simulated_error(machine, 0.01) < 2e-3
    without = linear_model(load_machine("hframe-linear"), np.zeros(4))
    if len(machine.coordinates) == 4:
        model = linear_model(machine, np.zeros(4))
        assert np.abs(model.A - without.A).max() + np.abs(model.B - without.B).max() > 1e-3


@pytest.mark.parametrize(
    "name", ["stribeck_friction", "presliding", "dead_band", "belt_play", "electrical_lag"]
)
def test_effects_without_a_linear_model_are_named(name: str, hframe: Machine) -> None:
    effect = CASES[name].effect
    text = json.loads(files(hframe.with_effects(effect))["state_space.json"])
    assert text["left_out"] == [effect.label]
    assert text["A"] == json.loads(files(hframe)["state_space.json"])["A"]


def test_delays_are_stated(hframe: Machine) -> None:
    machine = hframe.with_effects(
        EFFECTS["input_delay"].at("motor2", d=2e-3), EFFECTS["sensor_delay"].at("x_m", d=1e-3)
    )
    content = json.loads(files(machine)["state_space.json"])
    assert content["input_delays"] == [0.0, 2e-3]
    assert content["output_delays"] == [0.0, 0.0, 1e-3, 0.0]


def test_modes_of_an_oscillator() -> None:
    frequency, damping = 3.0, 0.2
    w = 2.0 * np.pi * frequency
    [mode] = modes(np.array([[0.0, 1.0], [-w * w, -2.0 * damping * w]]), np.ones(1))
    assert (mode.frequency, mode.damping) == pytest.approx((frequency, damping))
    assert mode.shape == pytest.approx([1.0])


def test_frequencies_are_those_of_the_undamped_machine() -> None:
    machine = load_machine("hframe-linear")
    frictionless = machine.replace(
        {f"{c.name}.viscous": 0.0 for c in machine.coordinates} | {"motor1.Ke": 0.0, "motor2.Ke": 0.0}
    )
    content = json.loads(files(frictionless)["state_space.json"])
    found = [mode["frequency_Hz"] for mode in content["modes"]]
    assert found[-2:] == pytest.approx(mode_frequencies(machine)[-2:], rel=1e-6)
    assert [mode["damping_ratio"] for mode in content["modes"]][-2:] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_held_motors_leave_the_carriage_on_its_belts(hframe: Machine) -> None:
    found = axis_modes(hframe, np.zeros(4))
    k_left, k_right, k_bottom = (b.EA / b.rest_length for b in hframe.belts)
    stiffness = np.array(
        [[k_left + k_right + 4.0 * k_bottom, k_left - k_right], [k_left - k_right, k_left + k_right]]
    )
    squared = np.linalg.eigvals(np.diag([1.0 / 4.07, 1.0 / 1.0412]) @ stiffness)
    expected = np.sort(np.sqrt(squared)) / (2.0 * np.pi)
    assert sorted(mode.frequency for mode in found.values()) == pytest.approx(expected, rel=1e-6)


def test_the_mat_file_has_the_same_matrices(hframe: Machine) -> None:
    written = files(hframe, at=["x=0.1", "y=-0.1"])
    mat = loadmat(io.BytesIO(written["state_space.mat"]))  # type: ignore[arg-type]
    content = json.loads(written["state_space.json"])
    for key in "ABCD":
        np.testing.assert_array_equal(mat[key], content[key])
    assert [str(name[0][0]) for name in mat["inputs"]] == content["inputs"] == ["v1_V", "v2_V"]
    assert "hframe_gym" in str(mat["provenance"][0])
    position = np.array(list(content["operating_point"].values()))
    np.testing.assert_allclose(mat["A"], linearize(hframe, position).A)


def test_the_table_has_the_matrices(hframe: Machine) -> None:
    written = files(hframe)
    rows = [line for line in str(written["state_space.csv"]).splitlines() if not line.startswith("#")]
    values = np.array([[float(cell) for cell in row.split(",")[1:]] for row in rows[1:]])
    model = linear_model(hframe, np.zeros(4))
    np.testing.assert_array_equal(values, np.block([[model.A, model.B], [model.C, model.D]]))
    assert rows[0].startswith(",x [m],y [m],phi1 [rad],phi2 [rad],x_rate [m/s]")


def test_python_control_takes_the_json(hframe: Machine) -> None:
    if importlib.util.find_spec("control") is None:
        pytest.skip("needs python-control: pip install control")
    import control

    content = json.loads(files(hframe)["state_space.json"])
    system = control.ss(
        *(content[k] for k in "ABCD"), **{k: content[k] for k in ("states", "inputs", "outputs", "name")}
    )
    assert system.input_labels == ["v1_V", "v2_V"]
