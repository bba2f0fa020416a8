"""Fixtures of the tests of the commands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hframe_gym.machine import Machine
from hframe_gym.recordings import machine_to_dict


@pytest.fixture
def diverging_machine(tmp_path: Path, hframe: Machine) -> Path:
    """Return a machine.json whose belts push instead of pull once they are stretched by more than 1 um."""
    contents = machine_to_dict(hframe)
    contents["effects"] = [
        {"name": "belt_hardening", "site": "belts", "parameters": {"h": {"value": -1e12, "unit": "1/m^2"}}}
    ]
    path = tmp_path / "diverging.json"
    path.write_text(json.dumps(contents))
    return path
