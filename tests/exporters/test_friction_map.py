"""The friction map against formulas of friction, and its standard deviations against the parameters'."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.exporters import EXPORTERS
from hframe_gym.machine import AppliedEffect, Machine, Uncertainty
from hframe_gym.recordings import load_machine
from tests.effects.one_of_each import CASES


def rows(machine: Machine, coordinate: str, **options: float) -> dict[str, np.ndarray]:
    """Return the columns of the map of one coordinate."""
    exporter = EXPORTERS.get("friction-map")(machine=machine, **options)  # type: ignore[call-arg]
    text = exporter.files(machine)["friction_map.csv"]  # type: ignore[attr-defined]
    head, *lines = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    kept = [line for line in lines if line[0] == coordinate]
    columns = dict(zip(head, zip(*kept, strict=True), strict=True))
    return {
        key: np.array([float(v) if v else np.nan for v in columns[key]])
        for key in ("position", "speed", "dry", "viscous", "effects", "total", "total_std")
    }


def with_effect(machine: Machine, effect: AppliedEffect) -> Machine:
    return machine.with_effects(effect)


def test_coulomb_and_viscous_friction_without_back_emf(hframe: Machine) -> None:
    for c in hframe.coordinates:
        found = rows(hframe, c.name)
        v = found["speed"]
        np.testing.assert_allclose(found["dry"], c.coulomb * np.sign(v))
        np.testing.assert_allclose(found["viscous"], c.viscous * v, rtol=1e-9)
        np.testing.assert_allclose(found["total"], found["dry"] + found["viscous"])
        assert np.all(found["effects"] == 0.0)
        assert np.isnan(found["total_std"]).all()
        assert np.isnan(found["position"]).all()


def test_stribeck_friction(hframe: Machine) -> None:
    found = rows(hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.02)), "x")
    v = found["speed"]
    np.testing.assert_allclose(found["dry"], (2.0 + np.exp(-((v / 0.02) ** 2))) * np.sign(v))


def test_friction_over_the_position(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["position_friction"].at("x", A=0.5, L=0.1, p=0.2))
    found = rows(machine, "x")
    q, v = found["position"], found["speed"]
    np.testing.assert_allclose(found["dry"], (2.0 + 0.5 * np.sin(2.0 * np.pi * q / 0.1 + 0.2)) * np.sign(v))
    assert (q.min(), q.max()) == (-0.28, 0.28)
    assert np.isnan(rows(machine, "y")["position"]).all()


def test_cogging_is_a_force_and_no_friction(hframe: Machine) -> None:
    found = rows(hframe.with_effects(EFFECTS["cogging"].at("motor1", A=0.02, n=11.0, p=0.0)), "phi1")
    np.testing.assert_allclose(found["effects"], -0.02 * np.sin(11.0 * found["position"]), atol=1e-12)
    assert len(np.unique(found["position"])) > 16 * 11  # no period is missed


@pytest.mark.parametrize("name", ["presliding", "dahl_hysteresis"])
def test_friction_with_a_memory_slides_steadily(name: str, hframe: Machine) -> None:
    found = rows(hframe.with_effects(CASES[name].effect), "x")
    fast = np.abs(found["speed"]) > 0.01
    dry = found["dry"] + found["effects"]
    assert np.all(dry[fast] * np.sign(found["speed"][fast]) > 0.0)
    slowest, next_slowest = (np.sort(np.abs(found["speed"]))[k] for k in (0, 2))
    assert dry[np.abs(found["speed"]) == slowest] == pytest.approx(
        dry[np.abs(found["speed"]) == next_slowest], rel=1e-3
    )


def test_friction_of_a_cold_machine(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["friction_warm_up"].at("machine", a=0.5, tau=60.0))
    assert rows(machine, "x", time=0.0)["dry"].max() == pytest.approx(3.0)
    assert rows(machine, "x")["dry"].max() == pytest.approx(2.0)


def test_standard_deviations_follow_from_those_of_the_parameters() -> None:
    machine = load_machine("axis")
    names = ("x.coulomb", "x.viscous")
    covariance = np.array([[0.04, -0.01], [-0.01, 0.09]])
    identified = dataclasses.replace(machine, uncertainty=Uncertainty(names, covariance))
    found = rows(identified, machine.coordinates[0].name)
    v = found["speed"]
    expected = np.sqrt(0.04 + 2.0 * -0.01 * v * np.sign(v) + 0.09 * v**2)
    np.testing.assert_allclose(found["total_std"], expected, rtol=1e-6)
