"""The exported gains are those with which the controllers act."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController, TextbookPID
from hframe_gym.errors import InputError
from hframe_gym.exporters import EXPORTERS
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine


def exported(machine: Machine, period: float) -> list[dict[str, object]]:
    files = EXPORTERS.get("gains")(machine=machine, period=period).files(machine)  # type: ignore[call-arg, attr-defined]
    content = json.loads(files["gains.json"])
    assert content["period_s"] == period
    assert len(files["gains.csv"].splitlines()) > len(content["gains"])
    return list(content["gains"])


def test_the_textbook_pid_acts_with_its_gains(hframe: Machine) -> None:
    gains = {(g["output"], g["input"], g["gain"]): g["value"] for g in exported(hframe, 0.002)}
    controller = TextbookPID(hframe, 0.002)
    error = np.array([1e-4, -5e-5])
    actions = controller.act_on_state(np.zeros((1, 8)), error[None, None])
    for drive, action in zip(hframe.drives, actions[0], strict=True):
        output = f"voltage of {drive.name}"
        volts = sum(
            (gains[output, f"error of {a}", "P"] + 0.002 * gains[output, f"error of {a}", "I"]) * e
            for a, e in zip("xy", error, strict=True)
        )
        assert action * drive.rated_voltage == pytest.approx(volts)
    assert gains["force along x", "error of x", "Td = D/P"] == pytest.approx(
        controller.derivative[0] / controller.proportional[0]
    )


def test_the_state_feedback_is_that_near_the_goal(hframe: Machine) -> None:
    gains = [g for g in exported(hframe, 0.01) if g["controller"] == "pid"]
    units = {g["input"]: g["unit"] for g in gains}
    assert (units["position of x"], units["velocity of phi1"]) == ("V/m", "V/(rad/s)")
    frictionless = hframe.replace({f"{c.name}.coulomb": 0.0 for c in hframe.coordinates})
    controller = ModelBasedController(frictionless, 0.01)
    names = [
        *(f"position of {c.name}" for c in hframe.coordinates),
        *(f"velocity of {c.name}" for c in hframe.coordinates),
    ]
    deviation = 1e-6 * np.array([1.0, -1.0, 20.0, 30.0, 5.0, 3.0, -100.0, 80.0])  # m, rad, m/s, rad/s
    travel = deviation * np.tile(hframe.travel_per_unit, 2)
    actions = controller.act_on_state(travel[None], np.zeros((1, 1, 2)))[0]
    for drive, action in zip(hframe.drives, actions, strict=True):
        of_drive = {
            g["input"]: float(str(g["value"])) for g in gains if g["output"] == f"voltage of {drive.name}"
        }
        volts = -sum(of_drive[name] * d for name, d in zip(names, deviation, strict=True))
        assert action * drive.rated_voltage == pytest.approx(volts, rel=0.02)


def test_an_unstable_period_is_stated() -> None:
    machine = load_machine("corexy")
    with pytest.warns(
        UserWarning, match="textbook-pid is unstable on machine 'corexy' at a control period of 0.01 s"
    ):
        files = EXPORTERS.get("gains")(machine=machine).files(machine)  # type: ignore[call-arg, attr-defined]
    assert "# Warning: textbook-pid is unstable" in files["gains.csv"]


def test_a_machine_that_the_controllers_do_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="machine 'hframe-order20': the controllers need one or two axes"):
        exported(load_machine("hframe-order20"), 0.01)
