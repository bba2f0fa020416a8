"""Many environments and workers, long recordings, many runs, and identifications side by side."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np

from benchmarks.faults.commands import Row, environment, finish, row, run, start, write_inputs
from benchmarks.long_log import LAUNCHER
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording, write_recording
from tools.posix import peak_megabytes

Log = Callable[[str], None]
ENVS, WORKERS, SIDE_BY_SIDE, RUNS = 65_536, 4, 8, 500
LONG_ROWS, RATE_HZ, MOVE_ROWS = 72_000_000, 10_000, 100_000
MAX_MB = 2000.0  # of one command


def load(log: Log) -> list[Row]:
    """Try many environments and workers, and identifications side by side."""
    rows = [
        _many_environments(),
        *(_workers(method) for method in ("fork", "spawn", "forkserver")),
        _side_by_side(),
    ]
    for finished in rows:
        log(f"{finished['what']}: {finished['note']} {finished['failures']}")
    return rows


def large_data(log: Log) -> list[Row]:
    """Check a folder of many runs and a very long recording, and identify from them."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="hframe-load-") as temporary:
        folder = Path(temporary)
        write_many_runs(folder / "many")
        write_long_run(folder / "long")
        for words in ("check many", "check long", "identify many", "identify long"):
            rows.append(_measured(*words.split(), folder))
            log(f"{rows[-1]['what']}: {rows[-1]['note']} {rows[-1]['failures']}")
    return rows


def _many_environments() -> Row:
    """Step very many environments and compare some of them with a small batch of the same seeds."""
    many, few = (HFrameVectorEnv(count, randomize="wide", max_episode_steps=40) for count in (ENVS, 8))
    observations = [envs.reset(seed=3)[0]["observation"][:8] for envs in (many, few)]
    rng, failures = np.random.default_rng(0), list[str]()
    begin = time.perf_counter()
    for step in range(50):
        actions = rng.uniform(-1.0, 1.0, (ENVS, 2)).astype(np.float32)
        results = many.step(actions), few.step(actions[:8])
        observations = [result[0]["observation"][:8] for result in results]
        if not np.isfinite(results[0][1]).all():
            failures.append(f"step {step}: a reward is not finite")
    if not np.array_equal(*observations):
        failures.append("differs from a batch of 8 with the same seeds")
    rate = 50 * ENVS / (time.perf_counter() - begin)
    return row(
        "load",
        f"{ENVS} environments, 50 steps",
        1,
        failures,
        f"{rate / 1e6:.2g} M steps/s, {peak_megabytes():.0f} MB",
    )


def _rewards(seed: int) -> list[float]:
    """Return the rewards of an episode in a single environment."""
    env = gym.make("HFrame-v0", randomize="default")
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    return [float(env.step(rng.uniform(-1, 1, 2).astype(np.float32))[1]) for _ in range(30)]


def _workers(method: str) -> Row:
    """Run episodes in worker processes; the parent has simulated before, so that its state is inherited."""
    expected = [_rewards(seed) for seed in range(2 * WORKERS)]
    with multiprocessing.get_context(method).Pool(WORKERS) as pool:
        found = pool.map_async(_rewards, range(2 * WORKERS)).get(timeout=600)
    failures = [f"seed {seed}" for seed in range(2 * WORKERS) if found[seed] != expected[seed]]
    return row("load", f"{WORKERS} workers by {method}", 2 * WORKERS, failures, "episodes equal to the bit")


def _side_by_side() -> Row:
    """Start identifications at once with an empty cache of compiled code."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_inputs(folder / "inputs")
        cache = {"HFRAME_CACHE": str(folder / "cache"), "NUMBA_CACHE_DIR": str(folder / "numba")}
        words = [
            ("identify", str(folder / "inputs" / "a"), "--machine", "axis", "--out", f"out{i}")
            for i in range(SIDE_BY_SIDE)
        ]
        began = time.perf_counter()
        finished = [finish(process, began) for process in [start(w, folder, cache) for w in words]]
        failures = [
            f"run {i}: code {f.code}, {f.errors}" for i, f in enumerate(finished) if f.code or f.errors
        ]
        answers = [json.loads((folder / f"out{i}" / "report.json").read_text()) for i in range(SIDE_BY_SIDE)]
        for answer in answers:
            del answer["seconds"]
        failures += [f"run {i}: another answer" for i, answer in enumerate(answers) if answer != answers[0]]
        again = run((*words[0][:-1], "again"), folder, cache)
    note = (
        f"equal answers; {max(f.seconds for f in finished):.0f} s together, "
        f"{again.seconds:.0f} s for one more"
    )
    return row("load", f"{SIDE_BY_SIDE} identifications at once, empty cache", SIDE_BY_SIDE, failures, note)


def _voltages(rng: np.random.Generator, rows: int, held: int) -> np.ndarray:
    """Return random voltage steps, shape (rows, 1), with rests at both ends."""
    volts = np.repeat(rng.uniform(-2.0, 2.0, (rows // held, 1)), held, axis=0)
    volts[: rows // 20], volts[-rows // 5 :] = 0.0, 0.0
    return volts


def write_many_runs(folder: Path) -> None:
    """Write many short runs of an axis with a hidden effect."""
    axis = BUILTIN_MACHINES["axis"]()
    truth = axis.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02))
    rng = np.random.default_rng(1)
    folder.mkdir(parents=True)
    for k in range(RUNS):
        time_s = np.arange(2500) * 1e-3
        inputs = _voltages(rng, 2500, 50)
        outputs = truth.simulate(time_s, inputs).outputs + rng.normal(0.0, 20e-6, (2500, 1))
        write_recording(folder / f"run_{k:03d}.parquet", Recording("", time_s, inputs, outputs), axis)


def write_long_run(folder: Path) -> None:
    """Write a recording of two hours at 10 kHz, moves of 10 s and rests between them, and 3 short ones."""
    import pyarrow as arrow
    from pyarrow import parquet

    axis = BUILTIN_MACHINES["axis"]()
    truth = axis.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02))
    rng = np.random.default_rng(2)
    folder.mkdir(parents=True)
    names = ["time_s", *axis.input_channels, *axis.output_channels]
    for k, rows in enumerate((LONG_ROWS, MOVE_ROWS, MOVE_ROWS, MOVE_ROWS)):
        schema = arrow.schema([(name, arrow.float64()) for name in names])
        with parquet.ParquetWriter(folder / f"run_{k}.parquet", schema) as file:
            at_rest = np.zeros(2)
            for begin in range(0, rows, MOVE_ROWS):
                time_s = np.arange(MOVE_ROWS) / RATE_HZ
                inputs = _voltages(rng, MOVE_ROWS, 500)
                motion = truth.simulate(time_s, inputs, at_rest)
                at_rest = np.array([motion.outputs[-1, 0], 0.0])
                noise = rng.normal(0.0, 20e-6, MOVE_ROWS)
                columns = (time_s + begin / RATE_HZ, inputs[:, 0], motion.outputs[:, 0] + noise)
                file.write_table(arrow.table(dict(zip(names, columns, strict=True))))


def _measured(command: str, data: str, folder: Path) -> Row:
    """Run a command in a process of its own and measure its memory and time."""
    words = (command, str(folder / data), "--machine", "axis")
    words += ("--out", str(folder / "out" / data)) if command == "identify" else ()
    launched = [sys.executable, "-c", LAUNCHER, sys.executable, "-m", "hframe_gym", *words]
    finished = subprocess.run(launched, capture_output=True, text=True, env=environment())
    *output, usage = finished.stdout.strip().splitlines()
    if not usage.startswith("{"):
        return row(
            "load", f"`{command}` on {data}", 1, ["the process that measures it was ended"], "not measured"
        )
    peak, wall = json.loads(usage)["peak_MB"], json.loads(usage)["wall_s"]
    failures = [finished.stderr.strip()[-500:]] if finished.returncode else []
    failures += [f"{peak:.0f} MB"] if peak > MAX_MB else []
    estimate = next((line.rpartition(": ")[2] for line in output if "min (a third" in line), "")
    note = f"{peak:.0f} MB, {wall:.0f} s" + (f"; estimate: {estimate}" if estimate else "")
    what = f"{RUNS} runs of 2500 rows" if data == "many" else f"a recording of {LONG_ROWS / 1e6:.0f} M rows"
    return row("load", f"`{command}` on {what}", 1, failures, note)
