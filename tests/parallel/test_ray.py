"""Ray: a worker that is killed, results equal to those without Ray, and addresses without a cluster."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("ray", reason="needs Ray: pip install 'hframe_gym[ray]'")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SEEDS = (0, 1, 2)
# Ray's workers have a lower priority by default, so that on a busy machine they would take long.
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "RAY_worker_niceness": "0"}
TRAIN = ("train", "ppo", "--steps", "50000", "--randomize", "none")


def start(*words: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hframe_gym", *map(str, words)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=ENVIRONMENT, cwd=ROOT, stdout=pipe, stderr=pipe, text=True)


def curve(folder: Path) -> list[dict[str, Any]]:
    rows = json.loads((folder / "card.json").read_text())["curve"]
    return [{key: value for key, value in row.items() if key not in ("seconds", "cpu_s")} for row in rows]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills a worker of Ray by a signal")
def test_with_two_workers_of_which_one_is_killed_every_seed_gives_the_agent_of_the_plain_run(
    tmp_path: Path,
) -> None:
    words = [word for seed in SEEDS for word in ("--seed", seed)]
    lines, killed = [], 0
    with start(*TRAIN, *words, "--ray", "--jobs", 2, "--out", tmp_path / "ray") as program:
        assert program.stdout
        assert program.stderr
        for line in program.stdout:
            lines.append(line)
            if (
                not killed
                and (found := re.search(r"pid=(\d+)\S* seed 1: +(\d+) steps", line))
                and int(found[2]) > 0
            ):
                killed = int(found[1])
                os.kill(killed, signal.SIGKILL)  # in the middle of the task: about 12 evaluations follow
        errors = program.stderr.read()
    assert program.returncode == 0, errors
    text = "".join(lines)
    starts = {seed: len(re.findall(rf"seed {seed}: +0 steps", text)) for seed in SEEDS}
    assert killed
    assert starts == {0: 1, 1: 2, 2: 1}
    assert [text.count(f"seed {seed}: wrote") for seed in SEEDS] == [1, 1, 1]
    for seed in SEEDS:
        plain = start(*TRAIN, "--seed", seed, "--out", tmp_path / f"plain_{seed}")
        _, errors = plain.communicate()
        assert plain.returncode == 0, errors
        with_ray, without = tmp_path / "ray" / f"seed_{seed}", tmp_path / f"plain_{seed}"
        assert len(curve(without)) > 3
        assert curve(with_ray) == curve(without)
        assert (with_ray / "policy.safetensors").read_bytes() == (without / "policy.safetensors").read_bytes()
    policies = {(tmp_path / f"plain_{seed}" / "policy.safetensors").read_bytes() for seed in SEEDS}
    assert len(policies) == len(SEEDS)


def test_scores_on_ray_are_those_without(tmp_path: Path) -> None:
    evaluate = ("evaluate", "pid", "textbook-pid", "ppo", "--episodes", 32)
    for options in (("--ray", "--out", tmp_path / "ray"), ("--out", tmp_path / "plain")):
        program = start(*evaluate, *options)
        _, errors = program.communicate()
        assert program.returncode == 0, errors
    assert (tmp_path / "ray" / "scores.json").read_bytes() == (
        tmp_path / "plain" / "scores.json"
    ).read_bytes()


def test_an_address_without_a_cluster_is_refused_in_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:  # accepts connections, and is no Ray
        busy = server.getsockname()[1]
        assert_refused(f"127.0.0.1:{busy}", "no head node of a Ray cluster answers there", tmp_path)
    assert_refused(f"127.0.0.1:{busy}", "cannot be reached", tmp_path)


def assert_refused(address: str, reason: str, folder: Path) -> None:
    begin = time.monotonic()
    program = start("evaluate", "pid", "--episodes", 2, "--ray", address, "--out", folder / "out")
    _, errors = program.communicate()
    assert program.returncode == 2
    assert errors.startswith(f"hframe: --ray {address}: {reason}")
    assert errors.count("\n") == 1
    assert not (folder / "out").exists()
    assert time.monotonic() - begin < 150.0  # ray.init alone takes 200 s, and ends the program by a signal
