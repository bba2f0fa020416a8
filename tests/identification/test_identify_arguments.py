"""Arguments of `identify` that are of another type: what to give instead is said before any work is done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hframe_gym.errors import InputError
from hframe_gym.identification import identify


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"recordings": "runs"}, r"call load_recordings\('runs', machine\)"),
        ({"recordings": Path("runs")}, r"call load_recordings\('runs', machine\)"),
        ({"recordings": []}, "needs a list of two or more recordings"),
        ({"recordings": object()}, "needs a list of two or more recordings"),
        ({"held_out": "run_03"}, r"give a list of names: \['run_03'\]"),
        ({"criteria": {"max_effects": 1}}, "give SelectionCriteria"),
        ({"budget": "60"}, "give seconds of processor time"),
        ({"machine": "corex"}, "did you mean 'corexy'"),
    ],
)
def test_an_argument_of_another_type_is_refused(arguments: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"recordings": [object()], "machine": "hframe", **arguments}
    with pytest.raises(InputError, match=message):
        identify(**given)
