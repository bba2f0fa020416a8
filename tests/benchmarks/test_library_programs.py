"""Programs of the page for other libraries: found, shortened and measured, and the table of their errors."""

import ast
import json

import pytest

from benchmarks.library_programs import PAGE, PROGRAMS, code_of, draw, run, split_imports, with_steps
from tools.tables.agents import library_programs


@pytest.mark.parametrize("section", PROGRAMS)
def test_the_first_program_of_each_section_takes_another_number_of_steps(section):
    program = with_steps(code_of(section, PAGE.read_text("utf-8")), 1234)
    assert "1234" in ast.unparse(program)
    assert "150000" not in ast.unparse(program)
    imports, rest = split_imports(program)
    assert len(imports.body) + len(rest.body) == len(program.body)
    assert not any(isinstance(statement, ast.Import | ast.ImportFrom) for statement in rest.body)


def test_a_page_without_the_program_or_its_constant_is_refused():
    with pytest.raises(LookupError, match="no Python program in a section 'skrl'"):
        code_of("skrl", "# Page\n\n## Other\n\n```python\nSTEPS = 1\n```\n")
    with pytest.raises(LookupError, match="does not assign STEPS"):
        with_steps(ast.parse("steps = 1"), 2)


def test_a_measured_program_has_its_steps_time_and_error(monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setattr("benchmarks.library_programs.EPISODES", 4)
    row = run("CleanRL style", 1, 0)  # one rollout
    assert row["cpu_s"] > 0.0
    assert row["median_mm"] > 0.0
    assert 0.0 <= row["within_0.2mm"] <= row["within_1mm"] <= 1.0


def test_the_table_shows_the_longest_programs_over_their_seeds(tmp_path, monkeypatch):
    runs = [
        {"steps": steps, "seed": seed, "cpu_s": steps / 1e4, "median_mm": error, "within_0.2mm": 0.5}
        for steps, errors in ((10_000, (2.0, 3.0)), (150_000, (0.25, 0.31)))
        for seed, error in enumerate(errors)
    ]
    programs = {"skrl": {"package": "skrl", "version": "2.1.1", "runs": runs}}
    row = library_programs({"programs": programs}).splitlines()[-1]
    assert row == "| skrl | 2 | 150000 | 15 | 0.28 mm | 0.31 mm | 50 % |"
    monkeypatch.setattr("benchmarks.library_programs.FIGURES", tmp_path)
    draw(json.loads(json.dumps(programs)))
    assert (tmp_path / "library_programs.png").stat().st_size > 10_000
