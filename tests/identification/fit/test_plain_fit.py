"""The plain fit needs no data sheet, and no machine is delivered that predicts worse."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.identification import SelectionCriteria, identify, prepare
from hframe_gym.identification.budget import Budget
from hframe_gym.identification.fit.estimation import Fit, prediction_cost
from hframe_gym.identification.fit.plain_fit import (
    PlainFit,
    _adds_term,
    _output_error_fits,
    _removal,
    _term_parameters,
    better_start,
    equally_weighted,
    outside_limits,
    plain_fit,
    starting_values,
    wide_parameters,
)
from hframe_gym.identification.forces.force_sizes import lacking_force
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.identification.validate.simpler_machines import (
    confirmed,
    description_line,
    description_sentence,
    descriptions,
    start_of_description,
)
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.recordings import Recording

NOISE = 1e-5  # m
TRUE = {"x.mass": 3.0, "x.viscous": 15.0, "x.coulomb": 3.0, "motor.Ke": 0.03}


def axis(values: Mapping[str, float] | None = None) -> Machine:
    machine = BUILTIN_MACHINES["axis"]()
    machine = machine.replace(effects=())
    return machine.replace(
        {name: value for name, value in (values or {}).items() if name in machine.parameters}
    )


def damping(machine: Machine) -> float:
    return machine.coordinates[0].viscous + machine.drives[0].back_emf


def measure(machine: Machine, runs: int = 3, seconds: float = 4.0) -> list[Recording]:
    """Simulate a machine under random steps of voltage, with rest at the start, and add noise."""
    time_s = np.arange(0.0, seconds, 2e-3)
    recordings = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        volts = np.repeat(rng.uniform(-8.0, 8.0, len(time_s) // 100 + 1), 100)[: len(time_s), None]
        volts[:100] = 0.0
        motion = machine.simulate(time_s, volts)
        outputs = motion.outputs + NOISE * rng.normal(size=motion.outputs.shape)
        recordings.append(Recording(f"run_{seed + 1:02d}", time_s, volts, outputs))
    return recordings


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_inertia_and_friction_follow_from_the_motion_whatever_is_declared(factor: float) -> None:
    true = axis(TRUE)
    declared = axis({name: factor * value for name, value in TRUE.items()})
    data = prepare(measure(true), declared)
    plain = plain_fit(declared, data)
    assert plain is not None
    assert plain.terms == ()
    assert plain.machine.parameters["x.mass"] == pytest.approx(true.parameters["x.mass"], rel=0.01)
    assert plain.machine.parameters["x.coulomb"] == pytest.approx(true.parameters["x.coulomb"], rel=0.03)
    assert damping(plain.machine) == pytest.approx(damping(true), rel=0.02)
    start = better_start(declared, data, plain)
    assert (start is declared) == (factor == 1.0)


def test_a_speed_sensor_alone_shows_inertia_and_friction() -> None:
    true = axis(TRUE)
    speed = Sensor("x_m_s", {"x": 1.0}, kind="speed", noise=1e-3)
    true = true.replace(sensors=(speed,))
    declared = true.replace({name: 4.0 * value for name, value in TRUE.items()})
    plain = plain_fit(declared, prepare(measure(true, runs=2), declared))
    assert plain is not None
    assert plain.machine.parameters["x.mass"] == pytest.approx(true.parameters["x.mass"], rel=0.02)
    assert damping(plain.machine) == pytest.approx(damping(true), rel=0.03)


def test_a_constant_force_is_a_term_of_the_plain_fit() -> None:
    true = axis(TRUE).with_effects(EFFECTS["constant_force"].at("x", size=1.5))
    plain = plain_fit(axis(TRUE), prepare(measure(true), axis(TRUE)))
    assert plain is not None
    assert plain.terms == ("constant_force@x",)
    assert plain.machine.parameters["constant_force@x.size"] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize(
    ("size", "cost", "added"), [(0.0, 99.0, False), (1.5, 99.0, True), (1.5, 101.0, False)]
)
def test_a_term_of_size_zero_is_none(size: float, cost: float, added: bool) -> None:
    """Rounding alone may lower the cost with it; its parameters do not act, and the next fit omits them."""
    machine, term = axis(TRUE), EFFECTS["constant_force"].at("x", size=size)
    free, data = wide_parameters(machine), prepare(measure(machine, runs=1, seconds=0.5), machine)
    without = Fit(machine, free, np.zeros(len(free)), 100.0, data.count, SIMULATION, np.eye(len(free)))
    trial = dataclasses.replace(
        without,
        machine=machine.with_effects(term),
        free=(*free, *_term_parameters(term, machine)),
        theta=np.zeros(len(free) + 1),
        cost=cost,
    )
    assert _adds_term(trial, without, term) == added
    if size == 0.0:  # nor is it kept where another term beside it took all of it
        removal = _removal(trial, term.label, [term.label], {(): without}, data)
        assert (removal.fitted, removal.gain) == (without, 0.0)


def test_a_constant_force_is_a_term_where_the_drive_follows_a_set_point_as_well() -> None:
    """There is no balance of forces, because the torque depends on unknown gains."""
    servo = BUILTIN_MACHINES["servo"]()
    true = servo.with_effects(EFFECTS["constant_force"].at("horn", size=0.05))
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 2.0, 5e-3)
    commands = np.repeat(rng.uniform(-1.0, 1.0, len(time_s) // 40), 40)[:, None]
    commands[:40] = 0.0
    outputs = true.simulate(time_s, commands).outputs
    run = Recording("run", time_s, commands, outputs + rng.normal(0.0, 1e-3, outputs.shape))
    plain = plain_fit(servo, prepare([run], servo))
    assert plain is not None
    assert "constant_force@horn" in plain.terms


@pytest.mark.parametrize(("lag", "terms"), [(0.05, ("input_delay@drives",)), (0.12, ())])
def test_a_delay_at_the_limit_of_its_range_is_no_term(lag: float, terms: tuple[str, ...]) -> None:
    runs = measure(axis(TRUE), runs=2, seconds=2.0)
    rows = round(lag / 2e-3)
    early = [np.concatenate([run.inputs[rows:], run.inputs[-1:].repeat(rows, axis=0)]) for run in runs]
    late = [dataclasses.replace(run, inputs=inputs) for run, inputs in zip(runs, early, strict=True)]
    plain = plain_fit(axis(TRUE), prepare(late, axis(TRUE)))
    assert plain is not None
    assert plain.terms == terms
    assert not any("input_delay@drives" in other.terms for other in plain.extended if not terms)


def test_a_speed_without_sign_is_fitted_from_many_points() -> None:
    """There is no balance of forces without a direction; dry friction is not declared."""
    counter = (Sensor("speed_m_s", {"x": 1.0}, NOISE, 0.0, "unsigned-speed"),)
    true = axis(TRUE).replace(sensors=counter)
    declared = axis({"x.mass": 0.6, "x.viscous": 40.0, "x.coulomb": 0.0}).replace(sensors=counter)
    data = prepare(measure(true, runs=2, seconds=1.0), declared)
    plain = plain_fit(declared, data)
    assert plain is not None
    assert plain.start.parameters["x.coulomb"] == pytest.approx(TRUE["x.coulomb"], rel=0.05)
    assert plain.start.parameters["x.mass"] == pytest.approx(TRUE["x.mass"], rel=0.05)
    assert better_start(declared, data, plain) is plain.start
    assert lacking_force(declared, data) is None  # no observer follows such a sensor


def test_runs_without_motion_have_no_plain_fit() -> None:
    machine = axis(TRUE)
    time_s = np.arange(0.0, 1.0, 2e-3)
    outputs = NOISE * np.random.default_rng(0).normal(size=(len(time_s), len(machine.sensors)))
    still = Recording("run_01", time_s, np.zeros((len(time_s), 1)), outputs)
    assert plain_fit(machine, prepare([still], machine)) is None


def test_runs_of_constant_speeds_are_fitted_from_the_declared_machine() -> None:
    """Of a hoist whose runs have one speed each, forces show neither inertia nor viscous friction.

    Here, the drives act against the motion, so that it shows negative ones.
    """
    true = axis(TRUE)
    declared = axis({name: 2.0 * value for name, value in TRUE.items()})
    data = prepare(measure(true), declared)
    against = data.with_inputs({run.name: -run.inputs for run in data.runs})
    assert starting_values(declared, against) == [(declared, ())]
    # Simulations that begin at rest show both.
    best = min(_output_error_fits(declared, wide_parameters(declared), data), key=lambda fitted: fitted.cost)
    assert best.machine.parameters["x.mass"] == pytest.approx(true.parameters["x.mass"], rel=0.02)
    assert damping(best.machine) == pytest.approx(damping(true), rel=0.02)


def test_identification_starts_from_the_motion_where_the_file_is_wrong_by_a_factor() -> None:
    """Kt, Ke and mass are guesses; the refit finds the true machine, and the report the file's errors."""
    true = axis(TRUE)
    declared = axis({"x.mass": 0.2, "x.viscous": 2.0, "x.coulomb": 0.2, "motor.Ke": 0.003})
    assert outside_limits(declared, true)
    lines: list[str] = []
    result = identify(measure(true, runs=4), declared, budget=0.0, log=lines.append)
    assert any("starts from values that follow from the motion" in line for line in lines)
    assert result.after.held_out.noise_ratio < 1.2
    assert result.plain is not None
    assert not result.plain.delivered
    assert any(warning.startswith("x.mass is") for warning in result.limit_warnings)
    report = result.as_json()
    assert set(report["plain"]) == {
        "held_out",
        "missing_force_percent",
        "missing_force",
        "terms",
        "delivered",
    }


def test_a_term_that_the_held_out_run_refutes_is_removed_from_the_plain_fit() -> None:
    """The axis was tilted in the fitted runs. One without motion and copies of runs are not fitted."""
    tilted = axis(TRUE).with_effects(EFFECTS["constant_force"].at("x", size=3.0))
    level = dataclasses.replace(measure(axis(TRUE), runs=4)[3], name="run_04")
    fitted = measure(tilted)
    silent = dataclasses.replace(fitted[0], name="run_05", outputs=0.0 * fitted[0].outputs)
    copies = [dataclasses.replace(r, name=name) for r, name in ((level, "a_copy"), (fitted[0], "run_06"))]
    result = identify([*fitted, level, silent, *copies], axis(TRUE), held_out=["run_04"], budget=0.0)
    assert result.plain is not None
    assert result.plain.terms == ()
    assert "Not used: a_copy is a copy of run_04, the same in every row." in result.excluded
    assert "Not used: run_06 is a copy of run_01, the same in every row." in result.excluded
    assert any(w.startswith("Not used: nothing moves in run_05, although run_01") for w in result.excluded)
    assert [run.name for run in result.fitted.runs] == [run.name for run in fitted]


@pytest.mark.parametrize(
    ("errors", "chosen", "described"),
    [
        ((1.0, 0.9, 0.8), 2, 2),  # the held-out runs confirm what the fitted ones do not show
        ((1.0, 0.9, 0.899), 1, 1),  # not clearly
        (
            (1.0, 0.98, 0.95),
            2,
            0,
        ),  # not clearly enough for a description: a false term takes the place of a spring
        ((1.0, 0.9, 0.85), 2, 1),
        ((0.8, 0.9, 0.7), 2, 2),
        ((0.8, 0.9, 1.0), 0, 0),
    ],
)
def test_the_held_out_runs_may_add_a_term_that_the_fitted_ones_do_not_show(
    errors: tuple[float, ...], chosen: int, described: int
) -> None:
    """Errors of fits without terms, with one that the fitted runs show, and with another one."""
    machines = [axis().replace({"x.mass": mass}) for mass in (1.0, 2.0, 3.0)]
    without, certain, uncertain = (SimpleNamespace(machine=machine) for machine in machines)
    plain = PlainFit(axis(), cast("Any", (without, certain)), cast("Any", (uncertain,)))
    rmse = dict(zip((1.0, 2.0, 3.0), errors, strict=True))

    def evaluation(machine: Machine, data: object) -> Any:
        error = rmse[machine.parameters["x.mass"]]
        channels = {"x_m": SimpleNamespace(rmse=error)}
        return SimpleNamespace(
            diverged=(), held_out=SimpleNamespace(channels=channels, noise_ratio=10.0 * error)
        )

    session = SimpleNamespace(machine=axis())
    test = SimpleNamespace(
        errors=evaluation,
        session=session,
        criteria=SelectionCriteria(),
        rounded_stamps_explain=lambda model: False,
    )
    evaluated: Any = SimpleNamespace(test=test, outcome=SimpleNamespace(data=None))
    best, reference = confirmed(plain, evaluated)
    for_description = start_of_description(plain, evaluated)
    assert best.machine.parameters["x.mass"] == machines[chosen].parameters["x.mass"]
    assert for_description.machine.parameters["x.mass"] == machines[described].parameters["x.mass"]
    assert reference.held_out.channels["x_m"].rmse == errors[chosen]


def test_fitted_runs_that_all_should_move_are_refused() -> None:
    """Something blocked the axis in all runs that are fitted, so that it only trembled."""
    moved = measure(axis(TRUE), runs=2)
    blocked = [dataclasses.replace(r, name=f"{r.name}_blocked", outputs=2e-3 * r.outputs) for r in moved]
    with pytest.raises(
        InputError, match=r"no run is left to fit.*nothing moves in run_01_blocked, although run_"
    ):
        identify([*moved, *blocked], axis(TRUE), held_out=["run_01", "run_02"], budget=0.0)


def test_the_declared_machine_is_delivered_where_the_fitted_runs_mislead() -> None:
    """The carriage is heavier in all fitted runs than in the held-out one, where the file is right."""
    loaded = axis({"x.mass": 2.0 * axis().parameters["x.mass"]})
    recordings = [*measure(loaded), dataclasses.replace(measure(axis(), runs=4)[3], name="run_04")]
    result = identify(recordings, axis(), held_out=["run_04"], budget=0.0)
    assert result.after.machine.parameters["x.mass"] == axis().parameters["x.mass"]
    assert result.verdict == "unexplained"
    assert any("declared one" in remark for remark in result.excluded)
    assert result.after.held_out.noise_ratio == pytest.approx(result.declared.held_out.noise_ratio)


def torque_driven(machine: Machine) -> Machine:
    """Command the torque of a motor, so that the machine is one of inertia, friction and forces alone."""
    drive = dataclasses.replace(
        machine.drives[0], kind="torque", Kt=1.0, Ke=0.0, resistance=1.0, rated_voltage=1.0
    )
    return machine.replace(drives=(drive,))


def random_torques(machine: Machine, size: float, offset: float = 0.0) -> list[Recording]:
    """Simulate three runs of 4 s under random steps of torque beside an offset, Nm, and add noise."""
    time_s, recordings = np.arange(0.0, 4.0, 4e-3), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        torque = np.repeat(rng.uniform(-size, size, len(time_s) // 50), 50)[:, None]
        torque[:50] = 0.0
        torque += offset
        outputs = machine.simulate(time_s, torque).outputs
        outputs = outputs + 1e-4 * rng.normal(size=outputs.shape)
        recordings.append(Recording(f"run_{seed}", time_s, torque, outputs))
    return recordings


@pytest.mark.parametrize("viscous", [0.05, 0.0])
def test_starting_values_include_a_declared_weight_and_no_vanishing_friction(viscous: float) -> None:
    """The file guesses a twentieth of the weight, and friction is all dry in one of the machines."""
    arm = torque_driven(BUILTIN_MACHINES["pendulum"]())
    true = {"arm.mass": 0.02, "arm.viscous": viscous, "arm.coulomb": 0.1, "unbalance@arm.A": -2.0}
    recordings = random_torques(arm.replace(true), 3.0)
    guess = {"arm.mass": 2e-3, "arm.viscous": 1e-5, "arm.coulomb": 3e-3, "unbalance@arm.A": -0.1}
    declared = arm.replace(guess)
    data = prepare(recordings, declared)
    starts = [machine for machine, _ in starting_values(declared, data)]
    best = min(starts, key=lambda machine: prediction_cost(machine, equally_weighted(data), SIMULATION))
    assert best.parameters["unbalance@arm.A"] == pytest.approx(-2.0, rel=0.3)
    assert best.parameters["arm.mass"] == pytest.approx(0.02, rel=0.05)
    fastest = max(np.abs(np.diff(run.outputs[:, 0])).max() / 4e-3 for run in recordings)
    assert all(machine.parameters["arm.viscous"] * fastest > 1e-3 * 3.0 for machine in starts)


def test_an_arm_that_does_not_hang_at_the_declared_angle_is_fitted_with_its_phase_and_a_constant_force() -> (
    None
):
    """The file has 1/20 of the weight, at a phase of zero; a cord pulls as well, the arm turns over."""
    arm = torque_driven(BUILTIN_MACHINES["pendulum"]())
    declared = arm.replace(
        {"arm.mass": 2e-3, "arm.viscous": 1e-5, "arm.coulomb": 3e-3, "unbalance@arm.A": -0.1}
    )
    true = {"arm.mass": 0.02, "arm.viscous": 0.05, "arm.coulomb": 0.1, "unbalance@arm.A": -2.0}
    turned = arm.replace({**true, "unbalance@arm.p": -0.3})
    turned = turned.with_effects(EFFECTS["constant_force"].at("arm", size=0.3))
    plain = plain_fit(declared, prepare(random_torques(turned, 3.0), declared))
    assert plain is not None
    assert plain.terms == ("constant_force@arm",)
    assert plain.machine.parameters["unbalance@arm.p"] == pytest.approx(-0.3, abs=0.02)
    assert plain.machine.parameters["constant_force@arm.size"] == pytest.approx(0.3, rel=0.1)


def test_a_weight_is_found_although_a_constant_force_has_taken_a_part_of_it() -> None:
    """An arm is held at 46 degrees: its weight is a constant force there, and the fit does not recover.

    A counterweight on a cord, a real constant force, is there as well.
    """
    arm = torque_driven(BUILTIN_MACHINES["motor"]()).replace(
        {"shaft.mass": 0.02, "shaft.viscous": 0.05, "shaft.coulomb": 0.1}
    )
    weight = EFFECTS["unbalance"].at("shaft", A=1.0, p=0.8)
    cord = EFFECTS["constant_force"].at("shaft", size=0.3)
    recordings = random_torques(arm.with_effects(weight, cord), 0.5, offset=np.sin(0.8))
    declared = arm.replace({"shaft.mass": 2e-3, "shaft.coulomb": 3e-3, "shaft.viscous": 1e-5})
    plain = plain_fit(declared, prepare(recordings, declared))
    assert plain is not None
    assert plain.terms == ("constant_force@shaft", "unbalance@shaft")
    assert plain.machine.parameters["shaft.mass"] == pytest.approx(0.02, rel=0.05)
    assert plain.simulated.chi2 < 1.5


def confirmed_by_all(machine: Machine) -> bool:
    """Stand in for held-out runs that confirm each machine."""
    return True


def test_what_is_left_is_described_in_simulation_without_naming_a_cause() -> None:
    """A force over speed that the machine lacks: the description removes most of complete runs' error."""
    true = axis(TRUE).with_effects(EFFECTS["quadratic_drag"].at("x", c=40.0))
    data = prepare(measure(true), axis(TRUE))
    plain = plain_fit(axis(TRUE), data)
    assert plain is not None
    before = prediction_cost(plain.machine, equally_weighted(data), 0.0)
    [(fitted, labels)] = descriptions(
        plain.simulated, data, SelectionCriteria(), print, Budget(), confirmed_by_all
    )
    assert labels == ("quadratic_drag@x",)
    assert prediction_cost(fitted.machine, equally_weighted(data), 0.0) < 0.01 * before
    assert not list(
        descriptions(plain.simulated, data, SelectionCriteria(), print, Budget(0.0), confirmed_by_all)
    )


@pytest.mark.parametrize("others", [True, False])
def test_the_next_effect_describes_where_the_held_out_runs_do_not_confirm_the_best_one(others: bool) -> None:
    """Where they confirm no other either, the best one remains: with a second effect, it may still help."""
    true = axis(TRUE).with_effects(EFFECTS["quadratic_drag"].at("x", c=40.0))
    data = prepare(measure(true)[:2], axis(TRUE))
    plain = plain_fit(axis(TRUE), data)
    assert plain is not None
    tried: list[str] = []
    lines: list[str] = []

    def confirmed_without_drag(machine: Machine) -> bool:
        tried.append(machine.effects[-1].label)
        return others and tried[-1] != "quadratic_drag@x"

    found = descriptions(
        plain.simulated, data, SelectionCriteria(), lines.append, Budget(), confirmed_without_drag
    )
    _, labels = next(found)
    assert tried[0] == "quadratic_drag@x"
    assert len(tried) > 1
    assert labels == (tried[1 if others else 0],)
    assert any(line.startswith("  quadratic_drag@x waits for others") for line in lines)


@pytest.mark.parametrize(
    ("confirmed_labels", "known_force", "expected"),
    [
        ({"drag_of_the_search@x"}, 30.0, "drag_of_the_search@x"),  # no other effect is confirmed
        ({"drag_of_the_search@x", "quadratic_drag@x"}, 30.0, "quadratic_drag@x"),  # which leaves as little
        (set(), 30.0, "quadratic_drag@x"),
    ],
)
def test_an_effect_of_the_search_describes_where_no_other_one_is_confirmed(
    confirmed_labels: set[str], known_force: float, expected: str
) -> None:
    """The search for a description overlooks it, here because it is not in the library."""
    true = axis(TRUE).with_effects(EFFECTS["quadratic_drag"].at("x", c=40.0))
    data = prepare(measure(true)[:2], axis(TRUE))
    plain = plain_fit(axis(TRUE), data)
    assert plain is not None
    drag = dataclasses.replace(EFFECTS["quadratic_drag"], name="drag_of_the_search").at("x", c=known_force)
    belongs_elsewhere = EFFECTS["quadratic_drag"].at("no_coordinate", c=1.0)
    lines: list[str] = []
    found = descriptions(
        plain.simulated,
        data,
        SelectionCriteria(),
        lines.append,
        Budget(),
        lambda machine: machine.effects[-1].label in confirmed_labels,
        (belongs_elsewhere, drag),
    )
    fitted, labels = next(found)
    assert labels == (expected,)
    assert fitted.machine.effects[-1].parameters["c"] == pytest.approx(40.0, rel=0.05)
    assert any(line.startswith("  drag_of_the_search@x of the search reduces") for line in lines)


def test_a_worse_fit_of_an_effect_does_not_replace_it_where_only_the_worse_one_is_confirmed() -> None:
    """With the limit on its coefficient, the same effect describes less of the fitted runs."""
    true = axis(TRUE).with_effects(EFFECTS["quadratic_drag"].at("x", c=40.0))
    data = prepare(measure(true)[:2], axis(TRUE))
    plain = plain_fit(axis(TRUE), data)
    assert plain is not None
    [coefficient] = EFFECTS["quadratic_drag"].parameters
    limited = dataclasses.replace(
        EFFECTS["quadratic_drag"], parameters=(dataclasses.replace(coefficient, upper=20.0),)
    )

    def only_the_worse_one(machine: Machine) -> bool:
        return machine.effects[-1].definition.parameters[0].upper == 20.0

    fitted, labels = next(
        descriptions(
            plain.simulated,
            data,
            SelectionCriteria(),
            print,
            Budget(),
            only_the_worse_one,
            (limited.at("x", c=10.0),),
        )
    )
    assert labels == ("quadratic_drag@x",)
    assert fitted.machine.effects[-1].parameters["c"] == pytest.approx(40.0, rel=0.05)


def test_a_description_may_correct_the_form_of_its_first_effect() -> None:
    """A spring, and friction with a tenth of its force over position: both true, a third is missing."""
    true = axis(TRUE).with_effects(
        EFFECTS["cable_spring"].at("x", k=60.0, q0=0.0),
        EFFECTS["friction_slope"].at("x", s=6.0),
        EFFECTS["quadratic_drag"].at("x", c=3.0),
    )
    data = prepare(measure(true), axis(TRUE))
    plain = plain_fit(axis(TRUE), data)
    assert plain is not None
    # A constant force removes 1 % of an error that swings slowly: that is chance, and would be in the
    # spring's way.
    assert plain.terms == ()
    assert "constant_force@x" in plain.extended[-1].terms
    *_, (_, labels) = descriptions(
        plain.simulated, data, SelectionCriteria(), print, Budget(), confirmed_by_all
    )
    assert labels == ("cable_spring@x", "friction_slope@x")


@pytest.mark.parametrize(
    ("lacking", "without", "only_complete_runs"),
    [(0.80, 0.06, True), (0.03, 0.06, False), (None, 0.06, False), (0.80, None, False)],
)
def test_a_description_that_misses_more_force_is_not_recommended_for_control(
    lacking: float | None, without: float | None, only_complete_runs: bool
) -> None:
    sentence = description_sentence(["interpolation_error@x_m"], 0.317, lacking, without)
    assert "describes the remaining error by interpolation_error@x_m. They are no causes" in sentence
    assert ("lacks 80 % of the drives' force, without them 6 %" in sentence) == only_complete_runs
    assert ("before.json" in sentence) == only_complete_runs


def test_the_log_tells_a_description_from_effects_that_help_in_the_fitted_runs_only() -> None:
    labels = ["frame_resonance@x"]
    assert description_line(labels, 0.5, helps=True).startswith("described by frame_resonance@x: 0.5 times")
    line = description_line(labels, 1.38, helps=False)
    assert "described by" not in line
    assert "frame_resonance@x: 1.38 times the error" in line


def test_a_description_stands_where_the_voltages_change_between_rows() -> None:
    """The controller is four times as fast as the log, and a spring is missing; no search is repeated."""
    declared = BUILTIN_MACHINES["axis"]()
    true = declared.with_effects(EFFECTS["cable_spring"].at("x", k=20.0, q0=0.0))
    time_s = np.arange(2400) * 0.25e-3
    recordings = []
    for k in range(2):
        inputs = np.where(
            time_s > 0.05, 3.0 * np.sin((26 + k) * time_s) + 2.0 * np.sin(231 * time_s + k), 0.0
        )
        outputs = true.simulate(time_s, inputs[:, None]).outputs[::4]
        outputs = outputs + np.random.default_rng(k).normal(0.0, 2e-5, outputs.shape)
        recordings.append(Recording(f"run_{k}", time_s[::4], inputs[::4, None], outputs))
    data = prepare(recordings, declared)
    plain = plain_fit(declared, data)
    assert plain is not None
    found = descriptions(plain.simulated, data, SelectionCriteria(), print, Budget(), confirmed_by_all)
    described, labels = next(found)
    assert (
        len(labels) == 1
    )  # no cause: which effect it is depends on what the voltages between the rows imitate
    # The rest is what the voltages between the rows would explain.
    assert described.cost < 0.3 * prediction_cost(plain.machine, equally_weighted(data), 0.0)


def test_the_cost_of_a_simulation_is_the_error_of_an_evaluation() -> None:
    """Commanded from its first row on, a carriage without declared friction leaves the simulation."""
    true, declared = axis(TRUE), axis(TRUE).replace({"x.coulomb": 1e-3})
    time_s, volts = 2e-3 * np.arange(2000), 4.0 * np.sign(np.sin(np.arange(2000) / 150.0 + 0.1))[:, None]
    outputs = true.simulate(time_s, volts).outputs + NOISE * np.random.default_rng(0).normal(size=(2000, 1))
    data = prepare([Recording("run_01", time_s, volts, outputs)], declared)
    error = declared.simulate(time_s, volts).outputs - outputs
    expected = math.sqrt(float(np.mean(error**2))) / float(data.noise[0])
    equal = equally_weighted(data)
    assert math.sqrt(prediction_cost(declared, equal, SIMULATION) / equal.count) == pytest.approx(
        expected, rel=0.01
    )


def test_long_runs_whose_motion_begins_late_are_fitted() -> None:
    """Two runs at 50 Hz of two and a half minutes, half a minute of motion at the end, stay complete."""
    true = axis(TRUE)
    time_s = 0.02 * np.arange(7500)
    runs = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        volts = np.repeat(rng.uniform(-6.0, 6.0, 75), 100)[:, None] * (time_s > 120.0)[:, None]
        motion = true.simulate(time_s, volts)
        outputs = motion.outputs + NOISE * rng.normal(size=motion.outputs.shape)
        runs.append(Recording(f"run_{seed}", time_s, volts, outputs))
    declared = axis({"x.mass": 0.3, "x.coulomb": 0.5})
    plain = plain_fit(declared, prepare(runs, declared))
    assert plain is not None
    assert plain.simulated.count == 2 * len(time_s)
    assert plain.machine.parameters["x.mass"] == pytest.approx(TRUE["x.mass"], rel=0.05)
