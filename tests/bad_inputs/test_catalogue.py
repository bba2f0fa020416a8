"""Every bad input of catalogue.toml is refused: exit code 2, the stated line, nothing written or run."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from .catalogue import BadInput, load
from .commands import PREFIX, REFUSED, run_command

pytestmark = pytest.mark.integration
CASES = load()
READERS = (
    ".csv",
    ".csv.gz",
    ".parquet",
    ".txt",
    ".mat",
    ".toml",
    "m.json",
    "path.csv",
    "answer",
    "agent",
    "card.json",
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_input_is_refused_with_its_message(case: BadInput, tmp_path: Path) -> None:
    case.write(tmp_path)
    outcome = run_command(case.words, tmp_path)
    assert outcome.problem == ""
    assert outcome.code == REFUSED
    (line,) = outcome.errors
    message = line.removeprefix(PREFIX)
    assert message == case.error or re.fullmatch(re.escape(case.error).replace("…", ".+"), message), message
    assert outcome.written == ()


def test_the_catalogue_covers_every_reader_and_command() -> None:
    assert len(CASES) >= 200
    assert [name for name, count in Counter(case.name for case in CASES).items() if count > 1] == []
    files = [name for case in CASES for name in case.files]
    for reader in READERS:
        assert sum(name.endswith(reader) for name in files) >= 3, reader
    commands = Counter(case.words[0] for case in CASES)
    assert set(commands) >= {
        *("simulate", "check", "identify", "import", "report", "effects", "machines", "kernel"),
        *("train", "evaluate", "export", "play", "examples"),
    }
