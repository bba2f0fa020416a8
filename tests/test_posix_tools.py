"""Programs of the repository that need POSIX say so on other systems, where the rest works."""

from __future__ import annotations

import sys
from importlib import import_module

import pytest


@pytest.mark.parametrize(
    "program",
    [
        "benchmarks.env_soak",
        "benchmarks.faults.__main__",
        "benchmarks.fuzzing",
        "benchmarks.long_log",
        "benchmarks.ray_scaling",
        "tools.mutation",
    ],
)
def test_a_program_that_needs_posix_refuses_other_systems_in_one_line(
    program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    main = import_module(program).main
    monkeypatch.setitem(sys.modules, "resource", None)
    monkeypatch.setattr(sys, "argv", [program, "--help"])
    name = program.removesuffix(".__main__")
    with pytest.raises(SystemExit, match=rf"^python -m {name}: .*docs/platforms.md\)$"):
        main()
