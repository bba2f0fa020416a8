"""Values in units of datasheets are converted in the message about a wrong unit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine, save_machine
from hframe_gym.recordings.machine_file.other_units import converted


@pytest.mark.parametrize(
    ("value", "given", "unit", "expected"),
    [
        (24.4, "mNm/A", "Nm/A", 0.0244),
        (24.4, "Nmm/A", "Nm/A", 0.0244),
        (391.0, "rpm/V", "Vs/rad", 60.0 / (2 * np.pi * 391.0)),
        (391.0, "rpm/V", "Nm/A", 60.0 / (2 * np.pi * 391.0)),
        (2.56, "V/krpm", "Vs/rad", 2.56 * 60.0 / (2 * np.pi * 1000.0)),
        (14.2, "gcm²", "kg m^2", 14.2e-7),
        (2.0, "Ohm", "ohm", 2.0),
        (12.0, "mm", "m", 0.012),
        (90.0, "deg", "rad", np.pi / 2),
        (5.0, "Ncm", "Nm", 0.05),
        (5.0, "Nmm", "N", None),  # a torque at a carriage: no factor makes it a force
        (0.0, "rpm/V", "Vs/rad", None),
    ],
)
def test_units_of_datasheets_are_converted(
    value: float, given: str, unit: str, expected: float | None
) -> None:
    result = converted(value, given, unit)
    assert result == (None if expected is None else pytest.approx(expected))


def test_the_message_says_what_to_write(hframe: Machine, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    save_machine(hframe, path)
    content = json.loads(path.read_text())
    content["drives"][0]["Kt"] = {"value": 24.4, "unit": "mNm/A"}
    path.write_text(json.dumps(content))
    expected = (
        r'drives\.\w+\.Kt: unit is \'mNm/A\', must be \'Nm/A\'; write {"value": 0\.0244, "unit": "Nm/A"}$'
    )
    with pytest.raises(InputError, match=expected):
        load_machine(path)
