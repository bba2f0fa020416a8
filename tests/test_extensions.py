"""A toy effect, controller, task, reward, sensor kind and log format, defined here alone, work everywhere."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import env_checker

import hframe_gym
from hframe_gym import cli
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS, register_effect, unregister_effect
from hframe_gym.envs import REWARDS, TASKS, Task
from hframe_gym.machine import BUILTIN_MACHINES, SENSOR_KINDS, Effect, EffectParameter, Machine, SensorKind
from hframe_gym.recordings import Recording, load_machine, load_recordings, save_machine
from hframe_gym.recordings.logs import LOG_FORMATS, Log, LogFormat, log_columns


def cubic_spring(q, k):  # type: ignore[no-untyped-def]
    """Return -k q^3."""
    return -k * q**3


TOY_EFFECT = Effect(
    name="toy_cubic_spring",
    site="coordinate",
    formula="f = -k q^3",
    source="this test",
    force=cubic_spring,
    fits_site=lambda machine, site: machine.coordinate(site).kind == "linear",
    parameters=(EffectParameter("k", "N/m^3", 0.0, 1e9, scale=1e3, role="amplitude"),),
)


class ToyController(Controller):
    """Proportional feedback of the observed x and y."""

    feedback = "observation"

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return the actions, shape (B, 2)."""
        error = observation["desired_goal"] - observation["observation"][:, :2]
        return np.clip(
            -20.0 * np.stack([error[:, 1] + error[:, 0], error[:, 1] - error[:, 0]], axis=1), -1.0, 1.0
        )


@dataclass(frozen=True)
class ToyTask(Task):
    """Move from the origin along x by a distance, m."""

    distance: float = 0.05
    draws: ClassVar[int] = 0

    @property
    def parameters(self) -> dict[str, float]:
        """Return what can be randomized."""
        return {"distance": self.distance}

    def begin(
        self, workspace: Any, uniforms: Any, parameters: Mapping[str, Any] | None = None
    ) -> tuple[Any, Any]:
        """Return starts and goals."""
        goals = np.zeros((len(uniforms), 2))
        goals[:, 0] = self.distance if parameters is None else parameters["distance"]
        return np.zeros((len(uniforms), 2)), goals

    def goal(self, plan: Any, elapsed_s: Any) -> Any:
        """Return the goals, which do not move."""
        return plan if elapsed_s.ndim == 1 else np.repeat(plan[:, None], elapsed_s.shape[1], axis=1)


@dataclass(frozen=True)
class ToyReward:
    """Minus the sum of the distances along x and y in multiples of the tolerance band."""

    band: float

    def __call__(self, achieved: Any, desired: Any) -> Any:
        """Return the rewards, shape (n,)."""
        return -np.abs(achieved.astype(float) - desired).sum(axis=1) / self.band


class ToyCounter(SensorKind):
    """A counter that rounds down; its noise comes after rounding."""

    @staticmethod
    def measure(reading: Any, noise: Any, resolution: Any, normal: Any) -> Any:
        """Return the measured values."""
        return np.floor(reading / resolution) * resolution + noise * normal


class ToyLogs(LogFormat):
    """Files of 32-bit numbers: voltage, position, voltage, position, ... at 1 kHz."""

    suffixes = (".toy",)

    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the first bytes."""
        return start.startswith(b"TOY!")

    def open(self, path: Path) -> list[Log]:
        """Return one log of three columns, shape (rows,) each."""
        values = np.frombuffer(path.read_bytes()[4:], np.float32).reshape(-1, 2).astype(float)
        table = np.column_stack([np.arange(len(values)) * 1e-3, values])
        columns = log_columns(["t [s]", "U [V]", "pos [mm]"], [""] * 3, ["number"] * 3)
        return [
            Log(
                path,
                columns,
                ("it is a toy",),
                lambda indices, progress: ([table[:, k] for k in indices], []),
            )
        ]


PARTS: list[tuple[Any, str, Any]] = [
    (LOG_FORMATS, "toy-logs", ToyLogs),
    (CONTROLLERS, "toy-controller", ToyController),
    (TASKS, "toy-task", ToyTask),
    (REWARDS, "toy-reward", ToyReward),
    (SENSOR_KINDS, "toy-counter", ToyCounter),
]


@pytest.fixture(autouse=True)
def toys() -> Iterator[None]:
    """Register the parts for one test. A user's module writes `@TASKS.register("toy-task")` there."""
    register_effect(TOY_EFFECT)
    for registry, name, part in PARTS:
        registry.register(name)(part)
    yield
    for registry, name, _ in PARTS:
        registry.unregister(name)
    unregister_effect(TOY_EFFECT.name)


def with_toys(machine: Machine) -> Machine:
    """Return a machine with the toy effect at x, and the toy sensor kind at x_m."""
    counter = dataclasses.replace(machine.sensor("x_m"), kind="toy-counter", resolution=1e-3, noise=1e-5)
    return machine.with_components(counter).with_effects(TOY_EFFECT.at("x", k=5e4))


@pytest.fixture
def machine_path(hframe: Machine, tmp_path: Path) -> Path:
    """Return the machine.json of the H-frame with the toy effect and the toy sensor kind."""
    save_machine(with_toys(hframe), tmp_path / "machine.json")
    return tmp_path / "machine.json"


def test_a_machine_file_keeps_the_effect_and_the_sensor_kind(machine_path: Path, hframe: Machine) -> None:
    loaded = load_machine(machine_path)
    assert loaded.parameters == with_toys(hframe).parameters
    assert loaded.unit("toy_cubic_spring@x.k") == "N/m^3"
    assert loaded.sensor("x_m").kind == "toy-counter"
    time_s, inputs = np.arange(300) * 1e-3, np.full((300, 2), (-6.0, -3.0))
    assert (
        np.ptp(simulate(loaded, time_s, inputs).outputs[-1] - simulate(hframe, time_s, inputs).outputs[-1])
        > 1e-3
    )


def test_hframe_import_reads_the_file_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    values = np.column_stack([np.full(50, 3.0), np.arange(50) * 0.5]).astype(np.float32)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.toy").write_bytes(b"TOY!" + values.tobytes())
    maps = [f"{axis.input_channels[0]}=U", f"{axis.output_channels[0]}=pos"]
    maps += [f"{channel}=none" for channel in axis.output_channels[1:]]
    words = ["import", str(tmp_path / "logs"), "--machine", "axis", "--out", str(tmp_path / "runs")]
    run_command([*words, *(word for pair in maps for word in ("--map", pair))], monkeypatch)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_allclose(run.outputs[:, 0], 0.5e-3 * np.arange(50))


RULES = [
    {"parameter": "toy_cubic_spring@x.k", "distribution": ["uniform", 0.5, 2.0]},
    {"parameter": "x_m.noise", "distribution": ["uniform", 0.5, 2.0]},
    {"parameter": "task.distance", "distribution": ["uniform", 0.5, 2.0]},
]
RANGES = {"toy_cubic_spring@x.k": (2.5e4, 1e5), "x_m.noise": (0.5e-5, 2e-5), "task.distance": (0.025, 0.1)}


@pytest.mark.parametrize("prefix", ["", f"{__name__}:"], ids=["name", "module and name"])
def test_environments_use_the_parts_and_randomize_their_parameters(machine_path: Path, prefix: str) -> None:
    options: dict[str, Any] = {
        "machine": str(machine_path),
        "task": f"{prefix}toy-task",
        "sensors": "machine",
    }
    options |= {"reward": f"{prefix}toy-reward", "randomize": RULES}
    env = gym.make("HFrame-v0", **options)
    env_checker.check_env(env.unwrapped, skip_render_check=True)
    envs = gym.make_vec("HFrame-v0", num_envs=50, **options)
    one, info = env.reset(seed=4)
    many, infos = envs.reset(seed=0)
    for name, (low, high) in RANGES.items():
        samples = infos["parameters"][name]
        assert low <= samples.min() < samples.max() <= high
        assert np.ptp(samples) > 0.5 * (high - low)
        assert info["parameters"][name] == samples[4]
    np.testing.assert_allclose(many["desired_goal"][:, 0], infos["parameters"]["task.distance"], rtol=1e-6)
    for _ in range(8):
        action = np.full(2, (-0.5, -0.3), np.float32)
        one, reward, _, _, _ = env.step(action)
        many, rewards, _, _, infos = envs.step(np.tile(action, (50, 1)))
        np.testing.assert_array_equal(one["observation"], many["observation"][4])
        assert reward == rewards[4]
    expected = ToyReward(ToyTask.band)(many["achieved_goal"], many["desired_goal"])
    np.testing.assert_array_equal(rewards, expected)
    x = np.asarray(many["observation"][:, 0], float)
    error = x - np.floor(envs.unwrapped.batch.simulator.tool_positions()[:, 0] / 1e-3) * 1e-3  # type: ignore[attr-defined]
    assert 0.0 < np.abs(error).max() < 5 * RANGES["x_m.noise"][1]


def run_command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run `hframe` with these words in this process and assert that it succeeds."""
    monkeypatch.setattr(sys, "argv", ["hframe", *words])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code


@pytest.mark.integration
@pytest.mark.parametrize("prefix", ["", f"{__name__}:"], ids=["name", "module and name"])
def test_hframe_evaluate_scores_the_controller_on_the_task(
    machine_path: Path, prefix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [
        "evaluate",
        f"{prefix}toy-controller",
        "pid",
        "--task",
        f"{prefix}toy-task",
        "--sensors",
        "machine",
    ]
    words += ["--machine", str(machine_path), "--episodes", "4", "--out", str(tmp_path / "out")]
    run_command(words, monkeypatch)
    scores = json.loads((tmp_path / "out/scores.json").read_text())
    assert scores["task"] == f"{prefix}toy-task"
    assert set(scores["controllers"]) == {f"{prefix}toy-controller", "pid"}
    assert "settling_s" in scores["controllers"][f"{prefix}toy-controller"]


@pytest.mark.parametrize("command", ["effects", "evaluate --help"])
def test_commands_list_the_registered_parts(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_command(command.split(), monkeypatch)
    words = capsys.readouterr().out.replace(",", " ").split()
    assert {"toy_cubic_spring"} <= set(words) or {"toy-controller", "toy-task"} <= set(words)


def recorded_runs(machine: Machine, k: float, count: int = 3, samples: int = 2000) -> list[Recording]:
    """Return recordings of an axis with a cubic spring, moved to and fro, computed without the package."""
    axis, drive, noise = machine.coordinates[0], machine.drives[0], machine.sensors[0].noise
    force_per_volt = drive.gear_ratio * drive.Kt / drive.resistance
    viscous = axis.viscous + force_per_volt * drive.Ke * drive.gear_ratio
    rng, substeps = np.random.default_rng(0), 50
    h, runs = 1e-3 / substeps, []
    for i in range(count):
        steps = rng.uniform(2.0, 6.0, samples // 100) * np.resize([1.0, -1.0], samples // 100)
        volts, positions = np.repeat(steps, 100), []
        x = v = 0.0
        for voltage in volts:
            positions.append(x)
            for _ in range(substeps):
                free = v + h * (force_per_volt * voltage - viscous * v - k * x**3) / axis.mass
                v = math.copysign(max(abs(free) - h * axis.coulomb / axis.mass, 0.0), free)
                x += h * v
        measured = np.array(positions)[:, None] + noise * rng.standard_normal((samples, 1))
        runs.append(Recording(f"run_{i}", 1e-3 * np.arange(samples), volts[:, None], measured))
    return runs


@pytest.mark.oracle
def test_identify_names_the_effect() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    result = hframe_gym.identify(recorded_runs(axis, k=2e4), axis)
    assert result.verdict == "effect_found"
    [selected] = result.effects
    assert selected.effect.label == "toy_cubic_spring@x"
    # The recordings determine the ratios of forces: mass and drive gain are the declared ones only up to a
    # factor.
    values = result.after.machine.parameters
    assert values["toy_cubic_spring@x.k"] / values["x.mass"] == pytest.approx(
        2e4 / axis.parameters["x.mass"], rel=0.01
    )


def test_the_parts_are_removed_after_a_test() -> None:
    assert "toy_cubic_spring" in EFFECTS
    unregister_effect(TOY_EFFECT.name)
    assert "toy_cubic_spring" not in EFFECTS
    register_effect(TOY_EFFECT)
    for registry, name, part in PARTS:
        registry.unregister(name)
        assert name not in registry
        registry.register(name)(part)
