"""Tests of the reasons to doubt a parameter, and of parameters that the data do not separate."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.envs.randomization.machine_sampler import MachineSampler
from hframe_gym.identification import fit, prepare
from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.identification.report.diagnostics.inseparable_parameters import inseparable_parameters
from hframe_gym.identification.report.diagnostics.parameter_diagnostics import (
    parameter_doubts,
    parameters_at_limit,
    undeclared_friction,
)
from hframe_gym.identification.report.words.rows import parameter_rows
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty
from hframe_gym.recordings import Recording


def with_standard_deviations(
    machine: Machine, relative_std: dict[str, float], correlation: float = 0.0
) -> Machine:
    """Attach relative standard deviations by parameter name; the first two parameters are correlated."""
    std = np.array([relative * machine.parameters[name] for name, relative in relative_std.items()])
    correlations = np.eye(len(std))
    if correlation:
        correlations[0, 1] = correlations[1, 0] = correlation
    return machine.replace(uncertainty=Uncertainty(tuple(relative_std), np.outer(std, std) * correlations))


@pytest.fixture(scope="module")
def identified() -> Machine:
    """Return an axis fitted to its simulation; viscous friction and back-EMF have the same effect on it."""
    machine = BUILTIN_MACHINES["axis"]()
    rng, time_s = np.random.default_rng(0), np.arange(800) * 1e-3
    recordings = []
    for k in range(4):
        inputs = np.repeat(rng.uniform(-2.0, 2.0, (16, 1)), 50, axis=0)
        inputs[:50] = 0.0
        outputs = simulate(machine, time_s, inputs).outputs + rng.normal(0.0, 20e-6, (800, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, outputs))
    data = prepare(recordings, machine)
    return with_uncertainty(fit(machine, default_free_parameters(machine), data, SIMULATION), data)


def test_inseparable_parameters_keep_the_spread_of_the_prior(identified: Machine, axis: Machine) -> None:
    assert identified.uncertainty is not None
    (group,) = inseparable_parameters(identified, axis)
    assert set(group.names) == {"x.viscous", "motor.Ke"}
    # Along viscous friction minus its equivalent in back-EMF, only the priors of 70 % and 20 % count.
    drive = axis.drives[0]
    viscous, back_emf = 0.7 * axis.parameters["x.viscous"], 0.2 * drive.back_emf
    std = viscous * back_emf / np.hypot(viscous, back_emf)
    assert identified.uncertainty.std("x.viscous") == pytest.approx(std, rel=0.15)
    ((weights, value, deviation),) = group.determined(identified)
    assert weights["motor.Ke"] / weights["x.viscous"] == pytest.approx(drive.back_emf / drive.Ke, rel=0.01)
    true = sum(weight * axis.parameters[name] for name, weight in weights.items())
    assert deviation < 0.01 * true
    assert value == pytest.approx(true, abs=4 * deviation)
    doubts = parameter_doubts(identified, axis)
    assert doubts["x.viscous"] == doubts["motor.Ke"] == [group.describe()]
    assert doubts["x.mass"] == []


def test_samples_of_inseparable_parameters_keep_their_sum(identified: Machine, axis: Machine) -> None:
    (group,) = inseparable_parameters(identified, axis)
    (entry,) = group.determined(identified)
    sampler = MachineSampler(identified, "identified", 2000)
    for b in range(2000):
        sampler.seed(b, np.random.default_rng(b))
    _, _, values = sampler.sample(np.arange(2000), 0)
    columns = [sampler.space.names.index(name) for name in entry.weights]
    sums = values[:, columns] @ list(entry.weights.values())
    assert sums.std() == pytest.approx(entry.std, rel=0.1)
    assert (values[:, columns] > 0.0).all()


def test_three_parameters_of_one_undetermined_direction(axis: Machine) -> None:
    """Along (0.5, 1, -0.4) of the values nothing is known: sums a - 0.5 b and c + 0.4 b are known."""
    machine = axis.with_effects(
        EFFECTS["constant_force"].at("x", size=1.0), EFFECTS["voltage_offset"].at("motor", V0=1.0)
    )
    names = ("constant_force@x.size", "voltage_offset@motor.V0", "x.mass")
    direction = np.array([0.5, 1.0, -0.4]) * [1.0, 1.0, axis.parameters["x.mass"]]
    machine = machine.replace(
        uncertainty=Uncertainty(names, np.outer(direction, direction) + 1e-10 * np.eye(3))
    )
    (group,) = inseparable_parameters(machine, axis)
    assert set(group.names) == set(names)
    assert len(group.combinations) == 2
    for weights in group.combinations:
        assert sum(
            weight * direction[names.index(name)] for name, weight in weights.items()
        ) == pytest.approx(0.0, abs=1e-6)


def test_separable_parameters_are_in_no_group(axis: Machine) -> None:
    machine = with_standard_deviations(axis, {"x.mass": 0.25, "x.viscous": 0.01}, correlation=0.9)
    assert inseparable_parameters(machine, axis) == ()
    assert inseparable_parameters(axis, axis) == ()


def test_no_doubt_about_well_determined_parameters(axis: Machine) -> None:
    machine = with_standard_deviations(axis, {"x.mass": 0.01, "x.viscous": 0.02}, correlation=0.9)
    assert parameter_doubts(machine, axis) == {"x.mass": [], "x.viscous": []}


def test_a_high_correlation_is_a_doubt_and_stands_in_the_matrix(axis: Machine) -> None:
    machine = with_standard_deviations(axis, {"x.mass": 0.01, "x.viscous": 0.01}, correlation=-0.98)
    doubt = ["correlation beyond 0.95 with another parameter"]
    assert parameter_doubts(machine, axis) == {"x.mass": doubt, "x.viscous": doubt}
    assert machine.uncertainty is not None
    assert machine.uncertainty.correlation == pytest.approx(np.array([[1.0, -0.98], [-0.98, 1.0]]))


def test_large_deviation_is_attributed_to_the_prior_or_to_the_data(axis: Machine) -> None:
    """The prior of a mass is 30 % wide, that of viscous friction 70 %."""
    machine = with_standard_deviations(axis, {"x.mass": 0.25, "x.viscous": 0.25})
    assert parameter_doubts(machine, axis) == {
        "x.mass": ["determined by the declared value more than by the data"],
        "x.viscous": ["poorly determined"],
    }


def test_parameter_at_a_bound_is_reported(axis: Machine) -> None:
    machine = axis.with_effects(EFFECTS["dead_band"].at("motor", Vd=0.4, drop=1.0))
    machine = with_standard_deviations(machine, {"dead_band@motor.Vd": 0.01, "dead_band@motor.drop": 0.01})
    assert parameter_doubts(machine, axis) == {
        "dead_band@motor.Vd": [],
        "dead_band@motor.drop": ["at a bound"],
    }


def test_a_mass_at_the_limit_of_the_fit_is_reported(axis: Machine) -> None:
    heavy = axis.replace({"x.mass": axis.parameters["x.mass"] * np.exp(4 * 0.3)})
    (text,) = parameters_at_limit(heavy, axis).values()
    assert text.startswith(
        "x.mass ends at the limit of the fit, 3.3 times its declared value: check the machine file"
    )
    doubts = parameter_doubts(with_standard_deviations(heavy, {"x.mass": 0.01, "x.coulomb": 0.01}), axis)
    assert doubts == {"x.mass": ["at the limit of the fit"], "x.coulomb": []}
    uncertain = with_standard_deviations(heavy, {"x.mass": 0.5, "x.coulomb": 0.01})
    (text,) = parameters_at_limit(uncertain, axis).values()
    assert text.startswith(
        "the recordings do not determine x.mass: the fit ends at 3.3 +- 1.7 times its declared"
    )
    assert parameters_at_limit(axis.replace({"x.mass": 3.2 * axis.parameters["x.mass"]}), axis) == {}


@pytest.mark.parametrize(("deviations", "doubts"), [(3.9, []), (4.0, ["at the limit of the fit"]), (5.0, [])])
def test_only_a_limit_that_acted_is_a_doubt(axis: Machine, deviations: float, doubts: list[str]) -> None:
    """A plain fit has no limits, so that motion determines a value beyond 4 deviations of the prior."""
    rough = axis.replace({"x.coulomb": axis.parameters["x.coulomb"] * np.exp(deviations * 0.7)})
    machine = with_standard_deviations(rough, {"x.coulomb": 0.01, "x.mass": 0.01})
    assert parameter_doubts(machine, axis) == {"x.coulomb": doubts, "x.mass": []}
    assert bool(parameters_at_limit(machine, axis)) == (deviations >= 4.0)


def test_damping_far_from_the_declared_one_is_reported_once(axis: Machine) -> None:
    """Viscous friction and back-EMF act alike; a plain fit may give all of it to one of them."""
    x, (drive,) = axis.coordinates[0], axis.drives
    total = x.viscous + drive.back_emf
    moved = {"x.viscous": 1e-6 * x.viscous, "motor.Ke": drive.Ke * total / drive.back_emf}
    assert parameters_at_limit(axis.replace(moved), axis) == {}
    moved["motor.Ke"] *= 3.0
    (text,) = parameters_at_limit(axis.replace(moved), axis).values()
    assert text.startswith(
        "the damping of x (viscous friction and back-EMF together) is 3 times its declared value"
    )


def test_friction_that_the_file_does_not_declare_is_a_finding_if_it_is_certain(axis: Machine) -> None:
    smooth = axis.replace({"x.coulomb": 0.0})
    rough = smooth.replace({"x.coulomb": 3.0})
    (found,) = undeclared_friction(with_standard_deviations(rough, {"x.coulomb": 0.1, "x.mass": 0.1}), smooth)
    (drive,) = axis.drives
    largest = drive.gain * drive.rated_voltage / axis.coordinates[0].travel_per_unit
    assert (found.name, found.value, found.unit) == ("x.coulomb", 3.0, "N")
    assert found.std == pytest.approx(0.3)
    assert found.share == pytest.approx(3.0 / largest)
    assert undeclared_friction(rough, smooth)[0].std is None
    assert not undeclared_friction(with_standard_deviations(rough, {"x.coulomb": 0.5, "x.mass": 0.1}), smooth)
    assert not undeclared_friction(smooth.replace({"x.coulomb": 1e-3}), smooth)
    assert not undeclared_friction(rough, axis)
    assert parameters_at_limit(rough, smooth) == {}


@pytest.mark.parametrize(("name", "factor"), [("motor.Ke", np.exp(4 * 0.2)), ("x.viscous", np.exp(-4 * 0.7))])
def test_every_parameter_at_the_limit_of_the_fit_is_reported(axis: Machine, name: str, factor: float) -> None:
    """Only masses, belt stiffnesses and torque constants were named, not a wrong back-EMF."""
    assert axis.parameters[name] > 0.0
    far = axis.replace({name: axis.parameters[name] * factor})
    (text,) = parameters_at_limit(far, axis).values()
    assert text.startswith(f"{name} ends at the limit of the fit, {factor:.2g} times its declared value")
    assert parameters_at_limit(axis.replace({name: axis.parameters[name] * factor**0.9}), axis) == {}
    both = far.replace({"x.mass": axis.parameters["x.mass"] * np.exp(4 * 0.3)})
    assert list(parameters_at_limit(both, axis)) == ["x.mass", name]


def test_machine_without_uncertainty_has_no_doubts(axis: Machine) -> None:
    assert parameter_doubts(axis, axis) == {}


def test_a_belt_that_idlers_divide_is_compared_with_its_declared_section() -> None:
    declared = BUILTIN_MACHINES["hframe"]()
    idlers = EFFECTS["idler_inertia"].at("machine", J_left=2e-5, J_right=2e-5, B_left=1e-5, B_right=1e-5)
    divided = declared.with_effects(idlers)
    assert divided.parameters["left.rest_length"] < 0.6 * declared.parameters["left.rest_length"]
    assert parameters_at_limit(divided, declared) == {}
    longer = divided.replace({"left.rest_length": 1.6 * divided.parameters["left.rest_length"]})
    assert "is 1.6 times its declared value" in parameters_at_limit(longer, declared)["left.rest_length"]
    (row,) = parameter_rows(with_standard_deviations(longer, {"left.rest_length": 0.01}), declared)
    assert row.declared == f"{divided.parameters['left.rest_length']:.5g}"
    named = f"{idlers.label}.J_left"
    (row,) = parameter_rows(with_standard_deviations(divided, {named: 0.01}), declared)
    assert (row.name, row.declared) == (named, "")
