"""Tests of a recording's simulation: stored encoder zeros, dropped samples, outliers, the held-out errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import (
    SelectionCriteria,
    estimate_initial_state,
    prepare,
    simulate_recording,
)
from hframe_gym.identification.fit.channel_errors import ChannelError
from hframe_gym.identification.fit.lost_voltages import estimate_lost_voltages
from hframe_gym.identification.fit.start_estimation import refine_dataset
from hframe_gym.identification.validate import evaluation, recording_simulation
from hframe_gym.identification.validate.machine_errors import (
    ModelEvaluation,
    PredictionErrors,
    evaluate_held_out,
    with_encoder_zeros,
)
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state
from hframe_gym.preparation.dataset import Dataset
from hframe_gym.preparation.runs.left_out import with_known_positions
from hframe_gym.preparation.session import prepare_session
from hframe_gym.preparation.start.rest import rest_and_noise
from hframe_gym.recordings import Recording, fill_gaps, load_machine, save_machine

RADIUS = 0.0194
QUANTUM = 5.2e-4  # rad
ZEROS = np.array([0.31, -0.22])  # rad
# rad; friction holds it at rest
STRETCH = np.array([[1.0, 0.5], [-1.0, 1.0], [0.5, -1.0], [0.0, 0.0], [-0.5, -0.5]]) * 30e-6 / RADIUS
STARTS = ((0.02, -0.05), (0.06, 0.03), (-0.05, -0.02), (0.0, 0.04), (0.04, -0.01))


def record(
    machine: Machine, k: int, start: tuple[float, float] | None = None, zeros: np.ndarray = ZEROS
) -> Recording:
    """Return a noisy run of a machine that starts with belts that friction holds stretched."""
    rng = np.random.default_rng(k)
    time_s = np.arange(600) * 1e-3
    inputs = np.where((time_s[:, None] > 0.1) & (time_s[:, None] < 0.4), rng.uniform(-3.0, 3.0, 2), 0.0)
    state = rest_state(machine, start or STARTS[k])
    state[2:4] += STRETCH[k]
    ideal = simulate(machine, time_s, inputs, state).outputs
    encoders = np.round((ideal[:, :2] + zeros) / QUANTUM) * QUANTUM
    return Recording(
        f"run_{k}",
        time_s,
        inputs,
        np.hstack([encoders, ideal[:, 2:] + rng.normal(0.0, 20e-6, (len(time_s), 2))]),
    )


def evaluated(
    machine: Machine, fitted: Dataset, held_out: Dataset, recordings: list[Recording]
) -> ModelEvaluation:
    """Return the errors of a machine on held-out runs, which are refined for it."""
    located = with_encoder_zeros(machine, fitted)
    return evaluate_held_out(located, refine_dataset(held_out, located, fitted), recordings)


@pytest.fixture
def session(hframe: Machine) -> list[Recording]:
    """Return the runs of a session over which the encoders stayed on."""
    return [record(hframe, k) for k in range(len(STARTS))]


@pytest.fixture
def identified(hframe: Machine, session: list[Recording]) -> Machine:
    """Return the machine with the zeros of the session."""
    return with_encoder_zeros(hframe, prepare(session, hframe))


def test_the_zeros_of_a_session_travel_in_the_machine_file(identified: Machine, tmp_path: Path) -> None:
    path = tmp_path / "machine.json"
    save_machine(identified, path)
    written = load_machine(path)
    assert written == identified
    np.testing.assert_allclose([s.zero for s in written.sensors[:2]], ZEROS, atol=2 * QUANTUM)
    assert [s.zero for s in written.sensors[2:]] == [None, None]


def test_a_single_run_starts_with_its_true_stretch(
    hframe: Machine, identified: Machine, session: list[Recording]
) -> None:
    """The motion of the run shows the stretch as well as the zeros of five runs do; it is three quanta."""
    for k, run in enumerate(session):
        true = rest_state(hframe, STARTS[k])[2:4] + STRETCH[k]
        for machine in (identified, hframe):
            np.testing.assert_allclose(
                simulate_recording(machine, run).initial.state[2:4], true, atol=1.2 * QUANTUM
            )


def test_a_zero_that_the_lasers_contradict_is_not_used(hframe: Machine, identified: Machine) -> None:
    run = record(hframe, 1, zeros=ZEROS + np.array([0.0, 0.7]))
    initial = simulate_recording(identified, run).initial
    assert simulate_recording(identified, record(hframe, 1)).initial.resolves_stretch.tolist() == [
        True,
        True,
        False,
        False,
    ]
    assert initial.resolves_stretch.tolist() == [True, False, False, False]
    assert "phi2_rad does not count from its zero in the other runs" in initial.warnings[0]
    np.testing.assert_allclose(initial.state[:2], STARTS[1], atol=20e-6)
    assert simulate_recording(identified, record(hframe, 1)).initial.warnings == ()


def test_encoders_locate_a_start_that_a_laser_does_not_measure(hframe: Machine, identified: Machine) -> None:
    """The pulley is eccentric, and the laser is out of range in the complete run."""
    pulley = EFFECTS["eccentric_pulley"].at("motor2", e=0.2e-3, p=0.7)
    rig = hframe.with_effects(pulley)
    limited = identified.with_effects(pulley, EFFECTS["sensor_range"].at("x_m", low=-0.05, high=0.05))
    run = record(rig, 1, start=(0.09, 0.01), zeros=np.array([s.zero for s in identified.sensors[:2]]))
    run.outputs[:, 2] = np.minimum(run.outputs[:, 2], 0.05)
    # `record` starts a round pulley at its angle; the eccentric one measures less by the lag.
    lag = 0.2e-3 * np.sin((0.09 - 0.01) / RADIUS + STRETCH[1, 1] + 0.7) / RADIUS
    run.outputs[:, 1] -= lag
    initial = simulate_recording(limited, run).initial
    # The belts are stretched by 30 um; the encoders cannot tell this from the position.
    np.testing.assert_allclose(initial.state[:2], (0.09, 0.01), atol=45e-6)


def test_dropped_samples_and_outliers_do_not_count(hframe: Machine, session: list[Recording]) -> None:
    run = session[0]
    kept = np.ones(len(run.time_s), np.bool_)
    kept[[50, 300, 301]] = False
    outputs = run.outputs.copy()
    outputs[400, 2] += 0.05
    damaged = Recording(run.name, run.time_s[kept], run.inputs[kept], outputs[kept])
    simulation = simulate_recording(hframe, damaged)
    np.testing.assert_array_equal(simulation.trajectory.time_s, damaged.time_s)
    assert np.flatnonzero(np.isnan(simulation.error[:, 2])).tolist() == [397]
    np.testing.assert_allclose(simulation.outputs, simulate_recording(hframe, run).outputs[kept], atol=2e-4)


def test_saturated_measurements_of_a_recording_with_gaps_determine_no_voltages(
    hframe: Machine, session: list[Recording]
) -> None:
    """The noise by which saturated measurements are recognized is that of the prepared recording."""
    run, limits = session[1], (-0.05, 0.065)
    run.outputs[:, 2] = np.clip(run.outputs[:, 2], *limits)
    machine = hframe.with_effects(EFFECTS["sensor_range"].at("x_m", low=limits[0], high=limits[1]))
    kept = np.ones(len(run.time_s), np.bool_)
    kept[[250, *range(396, 406)]] = False  # the voltage changes in the second gap
    damaged = Recording(run.name, run.time_s[kept], run.inputs[kept], run.outputs[kept])
    filled = fill_gaps(damaged)
    unsaturated = recording_simulation._unsaturated(damaged, filled, machine)
    noise = prepare([damaged], machine).noise
    np.testing.assert_array_equal(rest_and_noise(filled, machine)[2], noise)
    distance = np.abs(damaged.outputs[:, 2, None] - limits).min(axis=1) / noise[2]
    saturated = distance < 4
    expected = saturated | (np.convolve(saturated, [1, 0, 1], "same") > 0) & (distance < 8)
    assert 0 < expected.sum() < len(expected)
    np.testing.assert_array_equal(np.isnan(unsaturated.outputs[:, 2]), expected)
    cleaned = recording_simulation._cleaned(damaged, machine, 1)[0].inputs
    without, with_saturated = (
        estimate_lost_voltages(prepare([run], machine), machine).runs[0].inputs
        for run in (unsaturated, damaged)
    )
    np.testing.assert_array_equal(cleaned, without)
    assert not np.array_equal(cleaned, with_saturated)


def test_a_written_machine_has_the_errors_that_the_report_states(
    hframe: Machine, session: list[Recording], tmp_path: Path
) -> None:
    data = prepare(session, hframe)
    fitted, held_out = data.with_runs(["run_0", "run_1", "run_2"]), data.with_runs(["run_3", "run_4"])
    cable = hframe.with_effects(EFFECTS["cable_spring"].at("y", k=2.0, q0=0.2))
    for machine in (hframe, cable):
        evaluation = evaluated(machine, fitted, held_out, session)
        save_machine(evaluation.machine, tmp_path / "machine.json")
        written = load_machine(tmp_path / "machine.json")
        errors = [simulate_recording(written, run).error for run in session[3:]]
        reported = [evaluation.held_out.channels[channel].rmse for channel in hframe.output_channels]
        np.testing.assert_allclose(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)), reported, rtol=1e-9)
        for run, error in zip(session[3:], errors, strict=True):
            np.testing.assert_allclose(evaluation.errors[run.name], error, atol=1e-12)


def test_errors_of_a_machine_that_diverges_are_reported(hframe: Machine, session: list[Recording]) -> None:
    data = prepare(session, hframe)
    light = hframe.replace(coordinates=tuple(dataclasses.replace(c, mass=1e-9) for c in hframe.coordinates))
    evaluation = evaluated(light, data, data.with_runs(["run_3"]), session)
    assert set(evaluation.held_out.channels) == set(hframe.output_channels)


def test_later_measurements_locate_a_start_in_spite_of_stretched_belts(hframe: Machine) -> None:
    """The laser sees the stage only while the drives pull it, which stretch the belts by tenths of a mm."""
    time_s = np.arange(600) * 1e-3
    inputs = np.where((time_s[:, None] > 0.1) & (time_s[:, None] < 0.4), (5.0, -4.0), 0.0)
    outputs = simulate(hframe, time_s, inputs, rest_state(hframe, (0.09, 0.01))).outputs
    inside = np.abs(outputs[:, 2]) < 0.05
    assert 20 < inside.sum() < 500
    outputs[~inside, 2] = np.nan
    run = Recording("run", time_s, inputs, outputs)
    initial = estimate_initial_state(run, hframe)
    assert initial.position_known
    assert not initial.lasers_measured
    assert abs(initial.position[0] - 0.09) < 0.2e-3
    # With the machine, the simulation corrects what is left.
    limited = hframe.with_effects(EFFECTS["sensor_range"].at("x_m", low=-0.05, high=0.05))
    saturated = dataclasses.replace(run, outputs=np.where(np.isnan(outputs), 0.05, outputs))
    assert abs(simulate_recording(limited, saturated).initial.position[0] - 0.09) < 20e-6


def without_x(run: Recording) -> Recording:
    """Return a run in which the laser of x measures nothing."""
    return dataclasses.replace(run, outputs=run.outputs * [1.0, 1.0, np.nan, 1.0])


def test_a_laser_that_measures_checks_the_zeros_where_another_one_does_not(
    hframe: Machine, identified: Machine
) -> None:
    initial = simulate_recording(identified, without_x(record(hframe, 0))).initial
    assert initial.resolves_stretch.tolist() == [True, True, False, False]
    np.testing.assert_allclose(initial.state[:2], STARTS[0], atol=45e-6)
    # One of the encoders, it is unknown which, was switched on anew.
    initial = simulate_recording(
        identified, without_x(record(hframe, 0, zeros=ZEROS + np.array([0.0, 0.7])))
    ).initial
    assert not initial.resolves_stretch.any()
    assert not initial.position_known
    assert len(initial.warnings) == 2


def test_runs_that_nothing_locates_are_left_out(hframe: Machine) -> None:
    """The encoders were switched on anew for each run."""
    session = [record(hframe, k, zeros=ZEROS + np.array([k, -2.0 * k])) for k in range(3)]
    lost = without_x(session[0])
    data, warnings = with_known_positions(prepare([lost, *session[1:3]], hframe))
    assert [run.name for run in data.runs] == ["run_1", "run_2"]
    assert warnings == ("Not used, because no sensor with a known zero measures the start: run_0.",)
    data, warnings = with_known_positions(prepare([lost], hframe))
    assert [run.name for run in data.runs] == ["run_0"]
    assert warnings == ()


@pytest.mark.parametrize("unmeasured", [0, 1, 40])
def test_a_servo_log_is_used_from_its_first_measurement_on(unmeasured: int) -> None:
    """A servo is driven from the first row on, in which many logs have no measurement yet."""
    servo = BUILTIN_MACHINES["servo"]()
    time_s = np.arange(400) * 2e-3
    command = 0.4 * np.cos(6.0 * time_s)[:, None]
    outputs = simulate(servo, time_s, command, [0.4, 0.0, 0.0]).outputs.copy()
    outputs[:unmeasured] = np.nan
    run = Recording("run", time_s, command, outputs)
    session = prepare_session([run], servo, lambda line: None)
    (prepared,) = session.data.runs
    assert prepared.initial.position_known
    assert len(prepared.time_s) == 400 - unmeasured
    simulated = simulate_recording(servo, run)
    assert simulated.error.shape == (400, 1)
    assert np.isnan(simulated.outputs[:unmeasured]).all()
    # A wrong start would be an error of its lag, 50 mrad, at first; an estimated speed costs some of the
    # noise, 1 mrad.
    assert np.abs(simulated.error[unmeasured:]).max() < 5e-3


def test_a_run_without_measurements_is_simulated_from_its_first_row() -> None:
    servo = BUILTIN_MACHINES["servo"]()
    run = Recording("run", np.arange(100) * 2e-3, np.full((100, 1), 0.3), np.full((100, 1), np.nan))
    assert np.isfinite(simulate_recording(servo, run).outputs).all()


def test_a_machine_whose_simulation_diverges_on_a_held_out_run_has_no_error(
    hframe: Machine, session: list[Recording]
) -> None:
    """The logged command is far above what the amplifier gives; observers still follow the real motion."""
    wild = dataclasses.replace(session[4], inputs=1e6 * session[4].inputs)
    data = prepare([*session[:4], wild], hframe)
    evaluation = evaluated(hframe, data, data.with_runs(["run_3", "run_4"]), [*session[:4], wild])
    assert evaluation.diverged == ("run_4",)
    assert np.isnan(evaluation.errors["run_4"]).all()
    assert np.isfinite(evaluation.errors["run_3"]).all()
    assert {(e.rmse, e.noise_ratio) for e in evaluation.held_out.channels.values()} == {(None, None)}


def test_one_path_prepares_recordings(hframe: Machine, session: list[Recording]) -> None:
    """A laser begins at the end of its range: neither the fit nor the simulation believes it there."""
    run = session[1]
    begin = run.outputs[0, 2]
    run.outputs[:, 2] = np.minimum(run.outputs[:, 2], begin - 0.5e-3)
    prepared = prepare_session([run], hframe, lambda line: None)
    assert list(prepared.ranges) == ["x_m"]
    assert np.isnan(prepared.data.runs[0].outputs[0, 2])
    assert abs(simulate_recording(hframe, run).initial.position[0] - (begin - 0.5e-3)) > 50e-6


def test_a_sensor_deviates_alone_if_the_others_refute_its_error(hframe: Machine) -> None:
    """The carriage is 0.3 mm off by the laser; the encoders would see that as 0.02 rad if it had moved so."""

    def deviating(**errors: tuple[float, float]) -> tuple[str, ...]:
        quiet = {"phi1_rad": (2e-4, 1.1), "phi2_rad": (2e-4, 1.1), "x_m": (2e-5, 1.0), "y_m": (2e-5, 1.0)}
        channels = {channel: ChannelError(*values) for channel, values in (quiet | errors).items()}
        return ModelEvaluation(hframe, PredictionErrors(channels, None)).deviating_sensors

    assert deviating() == ()
    assert deviating(x_m=(3e-4, 15.0)) == ("x_m",)
    assert deviating(x_m=(3e-4, 15.0), y_m=(3e-4, 15.0)) == ("x_m", "y_m")
    assert deviating(x_m=(3e-4, 15.0), phi1_rad=(0.01, 50.0)) == ()  # a force
    assert deviating(phi1_rad=(0.05, 250.0)) == ("phi1_rad",)  # an encoder that slips
    assert deviating(x_m=(3e-4, 2.0)) == ()  # noise
    # Nothing else measures this motion.
    assert (
        ModelEvaluation(
            hframe, PredictionErrors({"x_m": ChannelError(3e-4, 15.0), "y_m": ChannelError(None, None)}, None)
        ).deviating_sensors
        == ()
    )


def test_a_wrong_model_has_no_error_of_the_zero(hframe: Machine) -> None:
    """The mean error of an encoder that drifts away by 1.4 rad is one of the model, not of the zero."""
    time_s = np.arange(1500) * 1e-3
    inputs = np.where(time_s[:, None] > 0.1, [3.0, 3.0], 0.0) * np.sign(np.sin(9 * time_s))[:, None]
    motion = hframe.simulate(time_s, inputs).outputs
    drifting = motion.copy()
    drifting[:, 0] += np.maximum(time_s - 0.1, 0.0)
    error = simulate_recording(hframe, Recording("run", time_s, inputs, drifting)).error[:, 0]
    assert abs(error[:100].mean()) < 0.2  # rad; twice what friction can hold
    assert error[-1] == pytest.approx(1.4, abs=0.2)
    held = motion.copy()
    held[:, 0] += 0.05  # rad; stretched belts at rest, which the encoder does not measure
    error = simulate_recording(hframe, Recording("run", time_s, inputs, held)).error[:, 0]
    assert np.sqrt(np.mean(error**2)) < 0.01


def test_held_out_runs_are_refined_once_for_each_machine(
    hframe: Machine, session: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The states of a friction that remembers are estimated from a whole run, which takes seconds."""
    data = prepare(session, hframe)
    fitted, held_out = data.with_runs(["run_0", "run_1", "run_2"]), data.with_runs(["run_3"])
    refined: list[Machine] = []

    def counted(runs: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
        refined.append(machine)
        return refine_dataset(runs, machine, reference)

    monkeypatch.setattr(evaluation, "refine_dataset", counted)
    test = evaluation.HeldOutTest(
        prepare_session(session, hframe, lambda line: None), held_out, SelectionCriteria()
    )
    model = test.errors(hframe, fitted)
    again = test.errors(hframe, fitted, "renamed")
    runs = test.refined_runs(again, fitted)
    assert len(refined) == 1
    expected = refine_dataset(test.complete_runs, model.machine, fitted)
    np.testing.assert_array_equal(runs.runs[0].outputs, expected.runs[0].outputs)
    heavier = dataclasses.replace(
        model, machine=hframe.replace({"x.mass": 2.0 * hframe.parameters["x.mass"]})
    )
    test.refined_runs(heavier, fitted)
    assert len(refined) == 2
