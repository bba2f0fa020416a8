"""Are logs of millions of rows checked and imported within 2 GB of memory and 60 s?

    python -m benchmarks.long_log [--rows 3000000] [--machine axis]

Simulates a session of moves of 8 s with rests of 2 s between them at 1 kHz, with noise, and writes it as one
CSV file. It is written once more as a spreadsheet would: UTF-16, semicolons, decimal commas, millimeters, and
a position in every fifth row only. `hframe check` and `hframe import` run in processes of their own; their
wall time, processor time and largest resident memory are in results/long_log.json. The requirement is 2 GB
and 60 s of wall time.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.results_file import write_results
from hframe_gym.arrays import Array
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine
from tools.command_line import command_line
from tools.posix import require_posix

PERIOD = 1e-3  # s
CYCLE, MOVE = 10_000, slice(1000, 9000)  # rows of a cycle, and those of its motion
FREQUENCIES = (0.4, 0.9, 2.1, 5.3, 11.7)  # Hz
AMPLITUDE = 0.13  # of the rated voltage, of each frequency
SEED = 0
MAX_BYTES = 2e9
MAX_SECONDS = 60.0
# A process inherits the resident memory of the one that starts it, so a small one starts the command.
LAUNCHER = """
import json, resource, subprocess, sys, time
start = time.perf_counter()
code = subprocess.run(sys.argv[1:]).returncode
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
wall, cpu = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
print(json.dumps({"wall_s": wall, "cpu_s": cpu, "peak_MB": usage.ru_maxrss * 1024 / 1e6}))
sys.exit(code)
"""


def simulate_session(machine: Machine, rows: int) -> tuple[Array, Array, Array]:
    """Simulate moves with rests between them; every second move is the reverse of the one before.

    Args:
        rows: Number of samples.

    Returns:
        Times, s, shape (rows,), voltages, V, shape (rows, drives), and measurements, m or rad,
        shape (rows, sensors).
    """
    generator = np.random.default_rng(SEED)
    time_s = np.round(np.arange(rows) * PERIOD, 3)
    cycle = np.zeros((CYCLE, len(machine.drives)))
    for column, drive in zip(cycle.T, machine.drives, strict=True):
        phases = generator.uniform(0, 2 * np.pi, len(FREQUENCIES))
        sines = [np.sin(2 * np.pi * f * time_s[:CYCLE] + p) for f, p in zip(FREQUENCIES, phases, strict=True)]
        column[MOVE] = AMPLITUDE * drive.rated_voltage * np.sum(sines, axis=0)[MOVE]
    signs = (-1.0) ** (np.arange(rows) // CYCLE)
    inputs = np.round(np.tile(cycle, (rows // CYCLE + 1, 1))[:rows] * signs[:, None], 5)
    outputs = machine.simulate(time_s, inputs).outputs
    for column, sensor in zip(outputs.T, machine.sensors, strict=True):
        column += sensor.noise * generator.normal(size=rows)
        if sensor.resolution:
            column[:] = np.round(column / sensor.resolution) * sensor.resolution
    return time_s, inputs, outputs


def write_spreadsheet(path: Path, machine: Machine, time_s: Array, inputs: Array, outputs: Array) -> None:
    """Write a log as a spreadsheet does, with the last output in every fifth row."""
    names = ["Time [ms]", *machine.input_channels, *machine.output_channels[:-1], "last [mm]"]
    with open(path, "w", encoding="utf-16") as file:
        file.write("sep=;\n" + ";".join(names) + "\n")
        table = np.column_stack([1e3 * time_s, inputs, outputs[:, :-1]]).tolist()
        for row, (values, last) in enumerate(zip(table, (1e3 * outputs[:, -1]).tolist(), strict=True)):
            cells = [*(f"{value:.9g}" for value in values), f"{last:.6f}" if row % 5 == 0 else ""]
            file.write(";".join(cells).replace(".", ",") + "\n")


def measure(*words: str) -> dict[str, float]:
    """Run an `hframe` command in a new process and print its last line.

    Args:
        *words: Command and its arguments.

    Returns:
        Wall and processor time, s, and the largest resident memory, MB.
    """
    command = [sys.executable, "-m", "hframe_gym", *words]
    finished = subprocess.run([sys.executable, "-c", LAUNCHER, *command], capture_output=True, text=True)
    if finished.returncode:
        raise SystemExit(f"hframe {' '.join(words)} failed: {finished.stderr}")
    *output, usage = finished.stdout.strip().splitlines()
    print(output[-1], flush=True)
    return json.loads(usage)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the logs, run the commands, and print what they take."""
    require_posix("benchmarks.long_log")
    parser = command_line(__doc__)
    parser.add_argument("--rows", type=int, default=3_000_000)
    parser.add_argument("--machine", default="axis")
    options = parser.parse_args(arguments)
    machine = load_machine(options.machine)
    session = simulate_session(machine, options.rows)
    results = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "logs").mkdir()
        plain, sheet = folder / "logs" / "log.csv", folder / "sheet.txt"
        header = ",".join(["time_s", *machine.input_channels, *machine.output_channels])
        np.savetxt(plain, np.column_stack(session), fmt="%.11g", delimiter=",", header=header, comments="")
        write_spreadsheet(sheet, machine, *session)
        rest = ("--machine", options.machine, "--split-at-rests")
        last = f"{machine.output_channels[-1]}=last"
        commands = {
            "check": ("check", str(plain.parent), "--machine", options.machine),
            "import": ("import", str(plain), "--out", str(folder / "runs"), "--machine", options.machine),
            "import, cut": ("import", str(plain), "--out", str(folder / "cut"), *rest),
            "import, spreadsheet": (
                "import",
                str(sheet),
                "--out",
                str(folder / "sheet"),
                "--map",
                last,
                *rest,
            ),
        }
        sizes = {"log_MB": plain.stat().st_size / 1e6, "spreadsheet_MB": sheet.stat().st_size / 1e6}
        for name, words in commands.items():
            results[name] = measure(*words)
            print(name, {key: round(value, 1) for key, value in results[name].items()}, flush=True)
    content = {"rows": options.rows, "machine_name": machine.name, **sizes, "results": results}
    write_results(
        "long_log", {"bar": {"peak_MB": MAX_BYTES / 1e6, "wall_s": MAX_SECONDS}, **content}, seed=SEED
    )


if __name__ == "__main__":
    main()
