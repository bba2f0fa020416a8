"""Strategy for command lines with options of any value, on valid files."""

from __future__ import annotations

import json

from hypothesis import strategies as st

from .materials import log_text, machine_content, path_text, run_text
from .mutations import TEXTS
from .readers import Case, contents_of

WORDS = (
    *(
        "0",
        "-1",
        "1",
        "2",
        "3.5",
        "nan",
        "inf",
        "-inf",
        "1e-9",
        "1e-5",
        "1e308",
        "1e400",
        "9" * 30,
        "x_m",
        "x_m=1",
    ),
    *(
        "v1_V=U1",
        "x_m=mm",
        "x_m=nan",
        "x.mass=2",
        "x.mass=nan",
        "=",
        "a=b=c",
        "0.3,0.2",
        "0.3,nan",
        "nothere",
    ),
    *(
        "hframe",
        "axis",
        "m.json",
        "run.csv",
        "path.csv",
        "runs",
        "answer",
        "pid",
        "textbook-pid",
        "os:system",
        ".",
        "/",
    ),
    *("circle", "reach", "track", "state", "rig", "none", "wide", "identified", "csv", "parquet"),
    *(text for text in TEXTS if "\x00" not in text and len(text) < 400),
)
# Command lines that take a fraction of a second, and the options that each one accepts.
COMMANDS: dict[str, tuple[str, ...]] = {
    "simulate --inputs run.csv --out o.csv": ("--machine", "--inputs"),
    "check runs": ("--machine", "--json"),
    "import log.txt --map v1_V=U1 --map v2_V=U2 --out imported": (
        *(
            "--map",
            "--unit",
            "--scale",
            "--mapping",
            "--min-rest",
            "--format",
            "--machine",
            "--split-at-rests",
        ),
        "--split-every",
    ),
    "machines new --like corexy --out new.json": (
        *(
            "--like",
            "--name",
            "--travel",
            "--mass",
            "--pulley-radius",
            "--travel-per-turn",
            "--gear-ratio",
            "--rotor-inertia",
            "--Kt",
        ),
        *("--resistance", "--rated-voltage", "--encoder-lines", "--set", "--linear-sensor"),
    ),
    "machines show m.json": ("--plot",),
    "kernel m.json": (),
    "report answer": (),
    "effects new found --from answer --out f.py": ("--formula", "--table", "--from"),
    "evaluate textbook-pid --episodes 1 --out out": (
        *("--machine", "--task", "--path", "--randomize", "--sensors", "--seed", "--episodes"),
    ),
    "identify runs --hold-out nothere --out out": ("--machine", "--jobs", "--hold-out"),
    "train ppo --resume --out nothere": ("--machine", "--task", "--seed", "--randomize", "--steps"),
    "play nobody": ("--machine", "--task", "--path", "--sensors", "--speed", "--frames", "--period"),
    "export nobody --out out": ("--machine", "--task", "--sensors", "--period", "--episodes", "--seed"),
}
FLAGS = ("--split-at-rests", "--linear-sensor")


@st.composite
def command_with_options(draw: st.DrawFn) -> Case:
    """Return a strategy for a command with one or two options, or an argument, of any value."""
    command = draw(st.sampled_from(sorted(COMMANDS)))
    words = command.split()
    options = COMMANDS[command]
    for _ in range(draw(st.integers(1, 2))):
        if not options:
            words[-1] = draw(st.sampled_from(WORDS))
            break
        option = draw(st.sampled_from(options))
        words += [option] if option in FLAGS else [option, draw(st.sampled_from(WORDS))]
    run = run_text().encode()
    files = {
        "run.csv": run,
        "runs/a.csv": run,
        "runs/b.csv": run,
        "log.txt": log_text().encode(),
        "path.csv": path_text().encode(),
        "m.json": json.dumps(machine_content()).encode(),
        **contents_of("answer", "answer"),
    }
    return Case(files, tuple(words))
