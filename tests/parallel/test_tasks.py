"""Tasks in worker processes: order, results, workers that die, errors, and the end of the program."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer

from hframe_gym.agents import load_recipe, train, train_seeds
from hframe_gym.agents.checkpoint_signature import refuse_unsigned
from hframe_gym.cli.application import CommandWithChoices
from hframe_gym.cli.options import RayOption
from hframe_gym.errors import InputError
from hframe_gym.files import files_of, write_files
from hframe_gym.parallel import local_processes, map_tasks, worker
from hframe_gym.recordings import save_machine, write_recording
from tests.identification.single_axis import AXIS, axis_recordings
from tests.parallel.worker_tasks import draw, fail, threads_of

ROOT = Path(__file__).parents[2]


@pytest.mark.integration
def test_a_task_whose_worker_dies_is_repeated_and_nothing_is_lost_or_counted_twice(tmp_path: Path) -> None:
    seeds = [5, 3, 8, 1, 9, 2]
    plain = list(map_tasks(draw, seeds))
    finished: list[int] = []
    task = partial(draw, folder=tmp_path, dies=8)
    assert list(map_tasks(task, seeds, jobs=2, completed=lambda i, _: finished.append(i))) == plain
    assert sorted(finished) == [0, 1, 2, 3, 4, 5]
    attempts = {seed: (tmp_path / f"started_{seed}").read_text().split() for seed in seeds}
    assert {seed: len(processes) for seed, processes in attempts.items()} == {
        seed: 1 + (seed == 8) for seed in seeds
    }
    assert len(set(attempts[8])) == 2
    assert str(os.getpid()) not in {process for processes in attempts.values() for process in processes}


@pytest.mark.integration
@pytest.mark.parametrize("jobs", [1, 2])
def test_no_inputs_give_no_results(jobs: int) -> None:
    assert list(map_tasks(draw, [], jobs=jobs)) == []


def test_a_task_that_always_kills_its_worker_is_named(tmp_path: Path) -> None:
    task = partial(draw, folder=tmp_path, dies=4, times=99)
    with pytest.raises(InputError, match=r"^task 2 ended 3 worker processes, perhaps for lack of memory"):
        list(map_tasks(task, [3, 4], jobs=2))
    assert len((tmp_path / "started_4").read_text().split()) == worker.ATTEMPTS


@pytest.mark.integration
def test_an_error_ends_the_other_tasks_and_stays_as_it_was_raised() -> None:
    begin = time.monotonic()
    with pytest.raises(InputError, match=r"^seed 1: is wrong$"):
        list(map_tasks(fail, [0, 1, 2], jobs=2))
    assert time.monotonic() - begin < 300.0  # task 2 takes 600 s


def test_workers_use_one_thread_and_the_program_keeps_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HFRAME_THREADS", "7")
    assert list(map_tasks(threads_of, [0], jobs=2)) == [("1", "1")]
    assert os.environ["HFRAME_THREADS"] == "7"


def test_another_version_in_a_worker_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_processes, "__version__", "99.0")
    with pytest.raises(
        InputError, match=r"a worker has hframe_gym .*, this program 99\.0: install the same version"
    ):
        list(map_tasks(draw, [0], jobs=2))


@pytest.mark.integration
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads the list of processes of Linux")
def test_workers_end_with_a_program_that_is_killed(tmp_path: Path) -> None:
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom hframe_gym.parallel import map_tasks\n"
        "from tests.parallel.worker_tasks import announce\n"
        "if __name__ == '__main__':\n    list(map_tasks(announce, [sys.argv[1]] * 2, jobs=2))\n"
    )
    script = tmp_path / "program.py"
    script.write_text(code)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    program = subprocess.Popen([sys.executable, str(script), str(tmp_path)], env=environment)
    while len(workers := list(tmp_path.glob("worker_*"))) < 2:
        assert program.poll() is None
        time.sleep(0.05)
    program.kill()
    program.wait()
    numbers = [int(path.name.removeprefix("worker_")) for path in workers]
    deadline = time.monotonic() + 60.0
    while any(map(_runs, numbers)):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def _runs(process: int) -> bool:
    """Return whether a process runs, by Linux's list of processes."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_files_travel_from_a_worker_to_a_folder(tmp_path: Path) -> None:
    def write(folder: Path) -> str:
        (folder / "logs").mkdir()
        (folder / "logs" / "a.txt").write_text("a")
        (folder / "b.bin").write_bytes(b"\x00b")
        return "done"

    result, files = files_of(write)
    assert (result, files) == ("done", {"b.bin": b"\x00b", "logs/a.txt": b"a"})
    write_files(tmp_path / "out", files)
    assert (tmp_path / "out" / "logs" / "a.txt").read_text() == "a"
    assert (tmp_path / "out" / "b.bin").read_bytes() == b"\x00b"


def test_a_missing_ray_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"^--ray needs Ray: pip install 'hframe_gym\[ray\]'$"):
        list(map_tasks(draw, [0], ray="auto"))


@pytest.fixture
def _idle_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace Ray by a module that is not connected: an address is checked before Ray is called."""
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False))


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("cluster", "--ray cluster: must be auto, or HOST:PORT of the head node"),
        ("127.0.0.1:port", "--ray 127.0.0.1:port: must be auto, or HOST:PORT"),
        ("127.0.0.1:99999", "--ray 127.0.0.1:99999: cannot be reached"),
    ],
)
@pytest.mark.usefixtures("_idle_ray")
def test_addresses_that_cannot_be_a_cluster(address: str, message: str) -> None:
    with pytest.raises(InputError, match=message.replace(".", r"\.")):
        list(map_tasks(draw, [0], ray=address))


@pytest.mark.usefixtures("_idle_ray")
def test_an_address_where_nothing_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    with pytest.raises(InputError, match=f"127.0.0.1:{free}: cannot be reached"):
        list(map_tasks(draw, [0], ray=f"127.0.0.1:{free}"))


@pytest.mark.parametrize(
    ("words", "address"),
    [
        (["--ray"], "local"),
        (["--ray", "pid", "--out", "out"], "local"),
        (["--ray", "package.module:name"], "local"),
        (["--ray", "auto", "pid"], "auto"),
        (["--ray", "10.0.0.1:6379"], "10.0.0.1:6379"),
        (["--ray=head:6379"], "head:6379"),
        (["pid"], None),
    ],
)
def test_the_option_ray_may_have_no_address(words: list[str], address: str | None) -> None:
    application = typer.Typer()
    received = []

    @application.command(cls=CommandWithChoices)
    def command(controllers: list[str] = typer.Argument(None), out: str = "", ray: RayOption = None) -> None:  # noqa: B008
        received.append(ray)

    application(words, standalone_mode=False)
    assert received == [address]


@pytest.mark.train
def test_seeds_in_processes_are_those_of_single_runs(tmp_path: Path) -> None:
    def ignore(line: str) -> None:
        pass

    recipe = load_recipe("ppo", "reach")
    few = {"n_steps": 16, "batch_size": 64}
    recipe = replace(recipe, env=recipe.env | {"num_envs": 16}, algorithm=recipe.algorithm | few)
    options: dict[str, Any] = {"steps": 1, "randomize": "none", "log": ignore}
    cards = train_seeds(recipe, seeds=(3, 5), out=tmp_path, jobs=2, show_curves=False, **options)
    assert sorted(cards) == [3, 5]
    first, second, alone = (tmp_path / name for name in ("seed_3", "seed_5", "single"))
    single = train(recipe, seed=5, out=alone, **options)
    assert [row["final_error_mm"] for row in cards[5]["curve"]] == [
        row["final_error_mm"] for row in single["curve"]
    ]
    policies = [(folder / "policy.safetensors").read_bytes() for folder in (first, second, alone)]
    assert policies[1] == policies[2] != policies[0]
    for folder in (first, second):
        refuse_unsigned(folder / "checkpoint.zip")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["seed_3", "seed_5", "single"]
    with pytest.raises(InputError, match="seeds 1, 1: one is given twice"):
        train_seeds(recipe, seeds=(1, 1), out=tmp_path, **options)


@pytest.mark.integration
def test_a_folder_of_rigs_becomes_a_folder_of_results(tmp_path: Path) -> None:
    """One rig is identified, one lacks the held-out run, and one has other channels than the machine."""
    save_machine(AXIS, tmp_path / "axis.json")
    for rig, name in (("good", "run"), ("other", "log")):
        (tmp_path / "rigs" / rig).mkdir(parents=True)
        for k, run in enumerate(axis_recordings(AXIS, rows=1000, volts=6.0)):
            write_recording(tmp_path / "rigs" / rig / f"{name}_{k}.csv", run, AXIS)
    (tmp_path / "rigs" / "servo").mkdir()
    for name in ("a", "b"):
        (tmp_path / "rigs" / "servo" / f"{name}.csv").write_text("time_s,u_V,arm_rad\n0,0,0\n0.01,0,0\n")
    command = [sys.executable, "-m", "hframe_gym", "identify", str(tmp_path / "rigs")]
    command += [
        "--machine",
        str(tmp_path / "axis.json"),
        "--out",
        str(tmp_path / "out"),
        "--hold-out",
        "run_1",
    ]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 2
    other, servo = done.stderr.splitlines()
    assert other.startswith("hframe: other: ")
    assert servo.startswith("hframe: servo: ")
    assert "column u_V" in servo
    assert "good: No effect is missing" in done.stdout
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["good"]
    page = (tmp_path / "out" / "good" / "report.html").read_text()
    assert f"--machine {tmp_path / 'out' / 'good' / 'machine.json'}" in page
    assert json.loads((tmp_path / "out" / "good" / "report.json").read_text())["verdict"] == "no_effect"
