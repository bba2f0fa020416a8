"""The benchmark's table of rigs, its sensors and sessions on disk."""

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS, effect_sites
from tests.reference_simulator import Rig
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, LASER_NOISE_M, Sensors, noisy
from tests.rigs.planted import drawn, effect
from tests.rigs.rigs import Case, cases, chosen
from tests.rigs.sessions import record


def _swing():
    t = np.arange(2000) * 1e-3
    q = np.stack([0.1 * np.sin(9 * t), 0.05 * np.cos(7 * t), 5 * np.sin(3 * t), 4 * np.cos(5 * t)], axis=1)
    v = np.stack([0.9 * np.cos(9 * t), -0.35 * np.sin(7 * t), 15 * np.cos(3 * t), -20 * np.sin(5 * t)], axis=1)
    return t, q, v


def test_sensors():
    t, q, v = _swing()
    assert np.allclose(Sensors().ideal(t, q, v), q[:, [2, 3, 0, 1]], atol=1e-15)
    late = Sensors(delay_s=(0.0, 0.0, 1.7e-3, 0.0)).ideal(t, q, v)
    assert np.abs(late[2:, 2] - 0.1 * np.sin(9 * (t[2:] - 1.7e-3))).max() < 1e-11
    skewed = Sensors(skew=(0.0, 5e-3)).ideal(t, q, v)
    assert np.allclose(skewed[:, 3], q[:, 1] + 5e-3 * q[:, 0], atol=1e-15)
    assert np.allclose(Sensors(scale=(1.0, 1.0, 1.02, 1.0)).ideal(t, q, v)[:, 2], 1.02 * q[:, 0], atol=1e-15)
    stuck = Sensors(range_x_m=(-0.05, 0.05)).ideal(t, q, v)[:, 2]
    assert stuck.min() == -0.05
    assert stuck.max() == 0.05


def test_noise():
    t, q, v = _swing()
    ideal = Sensors().ideal(t, q, v)
    error = noisy(ideal, np.random.default_rng(1)) - ideal
    assert np.abs(error[:, :2]).max() <= 0.5 * ENCODER_STEP_RAD * (1 + 1e-9)
    assert error[:, 2:].std() == pytest.approx(LASER_NOISE_M, rel=0.05)


def test_every_rig_is_off_its_declaration_by_5_to_20_percent():
    declared = Rig()
    for seed in range(20):
        rig = drawn(np.random.default_rng(seed))
        for name in ("mass", "viscous", "coulomb", "belt_EA_N", "torque_constant", "resistance_ohm"):
            off = np.abs(np.array(getattr(rig, name)) / np.array(getattr(declared, name)) - 1.0)
            assert np.all((off >= 0.05) & (off <= 0.2)), name


def test_the_table_covers_the_library_at_three_sizes(hframe):
    planted = {(c.planted[0].label, c.size) for c in cases().values() if c.kind == "library" and len(c.planted) == 1}
    for library in EFFECTS.values():
        if library.name == "idler_inertia":  # there or not
            continue
        labels = {f"{library.name}@{site}" for site in effect_sites(library, hframe)}
        for size in ("full", "20%", "5%"):
            assert any((label, size) in planted for label in labels), (library.name, size)


def test_the_table_has_the_sets_that_were_promised():
    groups = [c.group for c in cases().values()]
    least = {"pairs": 8, "triples": 6, "none": 20, "outside": 6, "order20": 1, "four-runs": 8}
    assert all(groups.count(group) >= count for group, count in least.items())
    assert sum(c.runs == 4 for c in cases().values() if c.kind == "none") >= 6
    assert len(chosen(["none", "none 1", "pairs"])) == groups.count("none") + groups.count("pairs")
    with pytest.raises(ValueError, match="neither a rig nor a set"):
        chosen(["nonsense"])


def test_sizes_scale_the_amplitude_and_nothing_else():
    full, small = (effect("cogging", "motor1", size).truth for size in (1.0, 0.05))
    assert small["A"] == pytest.approx(0.05 * full["A"])
    assert small["n"] == full["n"]


def test_force_like_truth_is_in_units_of_the_declared_motor():
    case = cases()["stribeck_friction@x full"]
    rig, _ = case.rig()
    gain = (0.023 / 0.71) / (rig.torque_constant[0] / rig.resistance_ohm[0])
    found = case.truth(case.planted[0])
    assert found["dF"] == pytest.approx(3.0 * gain)
    assert found["vs"] == 0.04


def test_a_session_is_recorded_once_and_reads_back(tmp_path):
    case = Case("short", "none", "none", "", (), runs=2)
    session = record(case, tmp_path)
    stamp = (session.folder / "truth.npz").stat().st_mtime_ns
    assert record(case, tmp_path) == session
    assert (session.folder / "truth.npz").stat().st_mtime_ns == stamp
    truth = session.truth()
    for recording in session.recordings():
        assert recording.outputs.shape == (2000, 4)
        assert np.all(recording.inputs[:100] == 0.0)
        error = recording.outputs - truth[recording.name]
        assert np.abs(error[:, :2]).max() < 0.6 * ENCODER_STEP_RAD
        assert error[:, 2:].std() == pytest.approx(LASER_NOISE_M, rel=0.05)
    other = record(dataclasses.replace(case, runs=1), tmp_path)  # another rig of that name: made again
    assert len(other.truth()) == 1
