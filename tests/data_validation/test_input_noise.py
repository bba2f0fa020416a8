"""Measured inputs: noise is named, commands are not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.data_validation.input_noise import check_input_noise
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording

TIME = np.arange(2000) * 1e-3


def machine_with(channel: str) -> Machine:
    axis = BUILTIN_MACHINES["axis"]()
    return axis.replace(drives=(dataclasses.replace(axis.drives[0], channel=channel),))


def found(channel: str, values: np.ndarray, measured: np.ndarray | None = None) -> list[str]:
    outputs = np.zeros(len(TIME)) if measured is None else measured
    recording = Recording("run", TIME, values[:, None], outputs[:, None])
    return [finding.message for finding in check_input_noise([recording], machine_with(channel))]


@pytest.mark.parametrize("noise", [0.2, 0.5])
def test_the_noise_of_a_measured_current_is_named_with_its_size(noise: float) -> None:
    """Within a tenth of what was added to a current of 2 A."""
    rng = np.random.default_rng(0)
    current = 2.0 * np.sqrt(2.0) * np.sin(15.0 * TIME) + noise * rng.normal(size=len(TIME))
    (message,) = found("motor_A", current)
    stated = float(message.partition("noise of ")[2].partition(" ")[0])
    assert stated == pytest.approx(noise, rel=0.1)


@pytest.mark.parametrize(
    ("channel", "values"),
    [
        # 0.7 %
        ("motor_A", 2.0 * np.sin(15.0 * TIME) + 0.01 * np.random.default_rng(0).normal(size=len(TIME))),
        ("motor_A", 2.0 * np.sign(np.sin(15.0 * TIME))),
        ("motor_Nm", np.repeat(np.random.default_rng(0).normal(size=100), 20)),  # random steps
        ("motor_A", np.zeros(len(TIME))),
        ("v_V", np.random.default_rng(0).normal(size=len(TIME))),  # a random voltage is a command
    ],
)
def test_commands_and_quiet_measurements_are_not_reported(channel: str, values: np.ndarray) -> None:
    assert found(channel, values) == []


def test_the_command_of_a_controller_that_differentiates_an_encoder_is_not_reported() -> None:
    """The drive follows it, however rough it is; noise of a current sensor beside its encoder is reported."""
    encoder = np.rint(np.sin(15.0 * TIME) / 0.01) * 0.01
    encoder[500:520] = np.nan
    error = np.nan_to_num(0.2 * np.cos(3.0 * TIME) - encoder)
    command = (3.0 * error + 0.06 * np.diff(error, prepend=error[0]) / 1e-3).clip(-3.0, 3.0)
    noise = np.random.default_rng(0).normal(size=len(TIME))
    assert found("motor_A", command) != []  # without the encoder, it passes for noise
    assert found("motor_A", command, encoder) == []
    assert found("motor_A", np.sin(15.0 * TIME) + 0.2 * noise, encoder) != []
