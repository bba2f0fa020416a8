"""Test the random rigs: the draw, the recordings, and that the true machine is the rig."""

import dataclasses
import time

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS, effect_sites
from hframe_gym.machine import BUILTIN_MACHINES, rest_state
from hframe_gym.recordings import load_recordings
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, LASER_NOISE_M
from tests.rigs.random_effects import SITES, SMALLEST_SIZE, draw_effect
from tests.rigs.random_excitation import CONVERTER_STEP_V, KINDS, MAX_VOLTAGE_V, STARTS
from tests.rigs.random_rigs import (
    CLOSED_LOOP_RUNS,
    LOG_RATES_HZ,
    OPEN_LOOP,
    RESIDUES,
    RandomRig,
    Residue,
    draw_rig,
)
from tests.rigs.true_machine import identified_values, true_machine

RIGS = [draw_rig(1, i) for i in range(300)]
SHORT = dataclasses.replace(RIGS[1], runs=1)


def test_draw_is_repeatable_and_seeds_differ():
    again = draw_rig(1, 4)
    assert again.describe() == RIGS[4].describe()
    assert again.stage == RIGS[4].stage
    assert [draw_rig(2, i).describe() for i in range(5)] != [rig.describe() for rig in RIGS[:5]]


def test_set_has_what_it_promises():
    kinds = [rig.kind for rig in RIGS]
    assert 0.2 < kinds.count("none") / len(RIGS) < 0.3
    assert kinds.count("outside") > 12
    assert kinds.count("off-form") > 12
    usual = [rig for rig in RIGS if rig.kind in ("none", "library")]
    assert 0.4 < sum(bool(rig.residue.kind) for rig in usual) / len(usual) < 0.6
    assert {rig.residue.kind for rig in usual} == {*RESIDUES, ""}
    assert {len(rig.hidden_effects) for rig in RIGS if rig.kind == "library"} == {1, 2, 3}
    assert {rig.runs for rig in RIGS} == set(range(3, 13))
    assert {rig.rate_hz for rig in RIGS} == {500.0, 1000.0}
    assert 0.3 < sum(rig.simulator == "euler" for rig in RIGS) / len(RIGS) < 0.7
    sizes = [e.size for rig in RIGS for e in rig.hidden_effects if rig.kind == "library"]
    assert min(sizes) >= SMALLEST_SIZE
    assert np.mean(np.array(sizes) < 0.2) > 0.4  # log-uniform
    assert {e.name for rig in RIGS for e in rig.hidden_effects if rig.kind == "library"} == set(SITES)


def test_effects_are_drawn_at_admissible_sites(hframe):
    """Of the library; newer effects are not drawn, because the rigs of a seed would change."""
    for name, sites in SITES.items():
        assert set(sites) <= {*effect_sites(EFFECTS[name], hframe), "drives"}


@pytest.mark.oracle
def test_recording_has_noise_and_converters_of_the_declared_size():
    session = SHORT.record()
    assert len(session.recordings) == 1
    assert len(session.unseen) == 3
    for recording in (*session.recordings, *session.unseen):
        error = recording.outputs - session.truth[recording.name]
        assert np.abs(error[:, :2]).max() < 0.5 * ENCODER_STEP_RAD + 1e-8
        assert error[:, 2:].std() == pytest.approx(LASER_NOISE_M, rel=0.05)
        steps = recording.inputs / CONVERTER_STEP_V
        assert np.abs(steps - np.round(steps)).max() < 1e-9
        assert np.all(recording.inputs[:100] == 0.0)
    again = SHORT.record()
    assert np.array_equal(again.unseen[2].outputs, session.unseen[2].outputs)


@pytest.mark.oracle
def test_runs_rest_at_first_move_both_axes_and_stay_on_the_rails():
    seen, starts = set(), set()
    for index in (2, 9, 14):
        for run in RIGS[index].record().played:
            seen.add(run.kind)
            starts.add(run.start)
            assert np.abs(run.velocities[:100]).max() < 1e-6
            assert np.abs(run.positions[:, 0]).max() < 0.28
            assert np.abs(run.positions[:, 1]).max() < 0.19
            assert np.ptp(run.positions[:, :2], axis=0).max() > 5e-3
    assert seen == set(KINDS)
    assert starts == set(STARTS)


def test_closed_loop_changes_the_log_of_a_rig_only():
    rigs = [draw_rig(1, i, closed_loop=True) for i in range(60)]
    effects, in_open_loop = ([rig.hidden_effects for rig in some] for some in (rigs, RIGS[:60]))
    assert [[e.parameters for e in some] for some in effects] == [
        [e.parameters for e in some] for some in in_open_loop
    ]
    assert rigs[4].stage == RIGS[4].stage
    loops = [rig.closed_loop for rig in rigs]
    assert {loop.period_s for loop in loops} == {0.5e-3, 1e-3, 2e-3}
    rates = np.array([rig.rate_hz for rig in rigs])
    np.testing.assert_allclose(rates, [1.0 / (loop.period_s * loop.updates) for loop in loops])
    assert (rates.min(), rates.max()) == LOG_RATES_HZ
    assert 0.3 < np.mean([loop.jitter_s > 0.0 for loop in loops]) < 0.7
    assert len({loop.updates for loop in loops}) == 7
    assert 0.3 < np.mean([loop.controller.integral > 0.0 for loop in loops]) < 0.7


@pytest.mark.oracle
def test_closed_loop_is_logged_every_nth_row_and_judged_by_every_row():
    drawn = draw_rig(1, 5, closed_loop=True)  # 1 ms, every fifth row, with jitter
    rig = dataclasses.replace(drawn, runs=5, bad_run=0)
    session = rig.record()
    assert {run.kind for run in session.played[:5]} == set(CLOSED_LOOP_RUNS)
    for recording, played in zip(session.recordings, session.played, strict=False):
        steps = np.diff(recording.time_s)
        assert len(recording.time_s) == 1200
        assert steps.mean() == pytest.approx(5e-3, rel=1e-3)
        assert 10e-6 < steps.std() < 60e-6
        assert np.array_equal(recording.time_s, played.actual_s)
        assert (
            np.abs(recording.outputs - session.truth[recording.name])[:, :2].max()
            < 0.5 * ENCODER_STEP_RAD + 1e-8
        )
        assert np.abs(recording.inputs).max() <= MAX_VOLTAGE_V
        converted = recording.inputs / CONVERTER_STEP_V
        assert np.abs(converted - np.round(converted)).max() < 1e-9
        assert np.ptp(played.positions[:, :2], axis=0).max() > 0.05
    kinds = [run.kind for run in session.played[5:]]
    assert set(kinds[:2]) <= set(OPEN_LOOP)
    assert kinds[2] in CLOSED_LOOP_RUNS
    for recording in session.unseen:
        np.testing.assert_allclose(np.diff(recording.time_s), 1e-3, atol=1e-9)


@pytest.mark.oracle
def test_written_session_can_be_loaded(tmp_path, hframe):
    session = SHORT.record()
    session.write(tmp_path)
    (run,) = load_recordings(tmp_path / "runs", hframe)
    assert np.allclose(run.outputs, session.recordings[0].outputs, rtol=1e-8, atol=1e-9)
    assert len(load_recordings(tmp_path / "unseen", hframe)) == 3


@pytest.mark.oracle
@pytest.mark.parametrize("name", SITES)
def test_true_machine_is_the_rig(name):
    """The kernel with the true parameters follows the simulated rig from a start without stretched belts."""
    rng = np.random.default_rng(7)
    site = SITES[name][-1]
    effect = draw_effect(name, site, 0.6, rng)
    simulator = "reference" if name == "idler_inertia" else "euler"
    rig = RandomRig(5, 0, "library", simulator, (effect,), Residue(), 3, 1000.0, 0)
    machine = true_machine(rig)
    time_s = np.arange(500) * 1e-3
    inputs = np.repeat(rng.uniform(-6.0, 6.0, (25, 2)), 20, axis=0)
    # The same 80 ms of rest as in the oracle tests of the effects, which determine the readings' zeros.
    inputs[:80] = 0.0
    plant = rig.plant((0.08, -0.05), 0.0)
    positions, velocities = np.empty((500, 4)), np.empty((500, 4))
    for row in range(500):
        positions[row], velocities[row] = plant.position, plant.velocity
        if row < 499:
            plant.step(inputs[row], time_s[row + 1])
    expected = rig.stage[1].ideal(time_s, positions, velocities)
    readings = simulate(
        machine, time_s, inputs, rest_state(machine, (0.08, -0.05)), longest_step=0.125e-3
    ).outputs
    error = np.abs((readings - readings[0] - expected + expected[0]) * np.array([0.0194, 0.0194, 1.0, 1.0]))
    assert error.max() < 15e-6


@pytest.mark.oracle
@pytest.mark.parametrize("name", sorted(set(SITES) - {"gain_mismatch"}))  # which the torque constants absorb
def test_identified_values_describe_the_same_machine(name):
    """Forces, masses and belts that are scaled with the gain of motor 1 leave the motion as it is."""
    rng = np.random.default_rng(7)
    rig = RandomRig(
        5, 0, "library", "euler", (draw_effect(name, SITES[name][-1], 0.6, rng),), Residue(), 3, 1000.0, 0
    )
    true, values = true_machine(rig), identified_values(rig)
    scale = values["x.mass"] / true.parameters["x.mass"]
    lumped = {
        key: scale * value
        for key, value in true.parameters.items()
        if key.endswith((".mass", ".viscous", ".coulomb")) and key not in values
    }
    declared = BUILTIN_MACHINES["hframe"]().parameters
    resistances = {key: declared[key] for key in ("motor1.resistance", "motor2.resistance")}
    known = {key: value for key, value in values.items() if key in true.parameters}
    identified = true.replace(known | lumped | resistances)
    assert abs(scale - 1.0) > 0.01
    time_s = np.arange(500) * 1e-3
    inputs = np.repeat(rng.uniform(-6.0, 6.0, (25, 2)), 20, axis=0)
    readings = [simulate(m, time_s, inputs, rest_state(m, (0.08, -0.05))).outputs for m in (true, identified)]
    np.testing.assert_allclose(readings[1], readings[0], rtol=0.0, atol=1e-9)


def test_identified_values_are_scaled_to_the_declared_gain():
    rig = next(
        r
        for r in RIGS
        if any(e.label == "stribeck_friction@x" for e in r.hidden_effects) and r.kind == "library"
    )
    values, stage = identified_values(rig), rig.stage[0]
    assert values["motor1.Kt"] == pytest.approx(0.023)
    ratio = values["x.mass"] / stage.mass[0]
    assert values["stribeck_friction@x.dF"] == pytest.approx(ratio * stage.stribeck_force[0])
    assert values["motor2.Kt"] / values["motor1.Kt"] == pytest.approx(
        stage.drive_gain[1] * stage.torque_constant[1] / stage.drive_gain[0] / stage.torque_constant[0]
    )


@pytest.mark.oracle
def test_recording_takes_less_than_5_seconds():
    largest = dataclasses.replace(RIGS[9], runs=1)
    largest.record()  # compiles
    began = time.process_time()
    largest.record()
    assert (time.process_time() - began) / 4 * 15 < 5.0
