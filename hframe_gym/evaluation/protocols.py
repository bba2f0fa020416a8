"""Protocols: benchmarks in which everything is fixed, so that scores of different people and years are comparable.

A protocol fixes the machine, randomization, sensors, drives, control period and metrics. Its *parts* are tasks that are
scored separately. Its *draws* are the episodes: a start, a goal and sampled machine parameters each, the same for every
*entry* (the controller or agent that is scored). A digest of all settings and draws is part of the definition
(`Protocol.digest`). Before a run the digest is computed again: if the package has changed what it covers, no result is
written, and the benchmark needs a new version (`reach-v2`), never a new digest.

    reach-v1    point-to-point moves, full state, ideal drives, randomization "default"
    track-v1    circle, square and Lissajous figure, otherwise as reach-v1
    hard-v1     moves, circle and square with the sensors and drives of a rig, randomization "wide", and effects that no
                controller's model declares (see `undeclared_effects`)

`protocol_results` writes and reads the files with the scores.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array
from ..controllers import CONTROLLERS, Controller, OutputFeedbackController, StateEstimator
from ..envs import RANDOMIZATION_PRESETS, Reach, Task, Track, as_machine, observed_machine
from ..envs.actuators import ACTUATOR_PRESETS
from ..errors import InputError, suggestion
from ..machine import Machine
from ..recordings.machine_file import machine_to_dict
from ..registry import load_plugins
from .metrics import BANDS, condition_digests, settling_times
from .runner import rollout
from .scenario import CONTROLLER_SOURCES, Episodes, Scenario, episode_conditions, make_controller
from .timed_controller import TimedController
from .undeclared_effects import effect_rules, with_absent_effects

Draws = dict[str, list[float | None]]
DECIMALS = 6  # of the values in results, s and mm: hides differences between processors, far below any effect
# Draws of these seeds decide nothing: no tuning, no selection of agents.
SEED_OF_RESULTS, SEED_OF_HARD = 1000, 71_000
GAP = "gap-v1"  # runs in a clone of the repository only
FIXED_OPTIONS = ("machine", "task", "path", "randomize", "sensors", "period", "episodes", "seed")


@dataclass(frozen=True)
class Protocol:
    """A benchmark with all its settings.

    Attributes:
        name: Name with the version, for example "reach-v1".
        parts: Tasks by the name of the part, each scored separately.
        digest: First 16 hexadecimal digits of a SHA-256 of the settings and of all draws.
        summary: What the benchmark asks for, one sentence.
        randomize: Name of the randomization preset of the simulated machine.
        undeclared_effects: Whether each draw also has effects that the declared machine lacks.
        sensors: What controllers observe, "state" or "rig".
        drives: What applies the voltages, "ideal" or "rig".
        period: Control period, s.
        draws: Number of episodes of each part.
        seed: Seed of the first episode.
        duration_s: Length of an episode, s.
    """

    name: str
    parts: Mapping[str, Task]
    digest: str
    summary: str
    machine: str = "hframe"
    randomize: str = "default"
    undeclared_effects: bool = False
    sensors: str = "state"
    drives: str = "ideal"
    period: float = 0.01
    draws: int = 512
    seed: int = SEED_OF_RESULTS
    duration_s: float = 1.5

    @cached_property
    def declared_machine(self) -> Machine:
        """Machine that controllers know: nominal parameters, with the converters and current limits of the drives."""
        machine = as_machine(self.machine)
        actuators = ACTUATOR_PRESETS[self.drives] if self.drives != "ideal" else None
        return actuators.apply(machine) if actuators else machine

    def scenario(self, part: str) -> Scenario:
        """Return the settings with which the episodes of a part, for example "reach", are simulated.

        The machine includes effects that controllers do not know, if the protocol has any.
        """
        machine, rules = as_machine(self.machine), RANDOMIZATION_PRESETS[self.randomize]
        if self.undeclared_effects:
            machine, rules = with_absent_effects(machine), (*rules, *effect_rules())
        return Scenario(
            machine,
            self.parts[part],
            rules if self.undeclared_effects else self.randomize,  # type: ignore[arg-type]
            self.sensors,  # type: ignore[arg-type]
            self.draws,
            self.seed,
            self.period,
            self.duration_s,
            self.drives,  # type: ignore[arg-type]
        )

    def declared_scenario(self, part: str) -> Scenario:
        """Return the settings from which a controller is designed that will run in a part (task) of the benchmark.

        They differ from the simulated ones: the machine lacks undeclared effects, and the full state is observed.
        """
        return dataclasses.replace(
            self.scenario(part),
            machine=self.declared_machine,
            randomize=self.randomize,  # type: ignore[arg-type]
            sensors="state",
        )

    def compute_digest(self) -> str:
        """Compute the `digest` of this installation's settings and episodes; this takes about a second."""
        settings = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("parts", "digest", "summary")
        }
        content: dict[str, Any] = {"settings": settings, "machine": machine_to_dict(self.declared_machine)}
        for part, task in self.parts.items():
            conditions = episode_conditions(self.scenario(part))
            content[part] = [repr(task), machine_to_dict(conditions.machine), condition_digests(conditions)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def check(self) -> None:
        """Raise an InputError if this installation gives other settings or episodes than `digest` states."""
        digest = self.compute_digest()
        if digest != self.digest:
            raise InputError(
                f"protocol {self.name}: the installed packages give other settings or draws (digest {digest}, not "
                f"{self.digest}), so scores would not be comparable; install a release of hframe_gym with this protocol"
            )


def _track(path: str) -> Track:
    """Return the task of a path, 50 mm wide, at 0.3 m/s."""
    return Track(path=path, size=0.05, speed=0.3)


PROTOCOLS: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol(
            "reach-v1",
            {"reach": Reach()},
            "2cd343ef8e91485b",
            "Move the tool to a point and keep it there; the masses, friction and belts of each draw are unknown.",
        ),
        Protocol(
            "track-v1",
            {path: _track(path) for path in ("circle", "square", "lissajous")},
            "0183eb18afcc531c",
            "Follow a path at 0.3 m/s; the masses, friction and belts of each draw are unknown.",
        ),
        Protocol(
            "hard-v1",
            {"reach": Reach(), "circle": _track("circle"), "square": _track("square")},
            "ca92cbc61f7531fb",
            "Moves and paths with a rig's sensors and drives, parameters far from the model's, and effects that the "
            "model does not declare.",
            randomize="wide",
            undeclared_effects=True,
            sensors="rig",
            drives="rig",
            seed=SEED_OF_HARD,
        ),
    )
}


def get_protocol(name: str) -> Protocol:
    """Return a benchmark protocol by its name with the version, such as "reach-v1"; an InputError if unknown."""
    if name == GAP:
        raise InputError(
            f"protocol {GAP} has plants of the independent simulator, which is not installed with the package: run "
            "python -m benchmarks.gap run ENTRY in a clone of the repository (docs/gap.md)"
        )
    if name not in PROTOCOLS:
        raise InputError(
            f"protocol {name!r} is unknown; choose one of {', '.join(PROTOCOLS)}{suggestion(name, PROTOCOLS)}"
        )
    return PROTOCOLS[name]


class Entry(NamedTuple):
    """Controller or agent to which a result belongs.

    Attributes:
        name: Name in results and on the leaderboard.
        kind: "controller" (designed from the declared machine) or "agent" (learned).
        sha256: Hash of what determines it: files of an agent; source, files and weights of a controller.
        algorithm: How it was trained, for example "ppo"; empty for a controller.
        observes: "state", "measurements", or "Kalman estimates" (`StateEstimator` of the package).
        training_steps: Environment steps of its training; None if unknown or without training.
        training_cpu_s: Processor time of its training, s; None if unknown or without training.
        control_us: Processor time of `act` per control period of one machine, us; None if it was not measured.
    """

    name: str
    kind: str
    sha256: str
    algorithm: str = ""
    observes: str = "state"
    model: str = "not stated"
    training_steps: int | None = None
    training_cpu_s: float | None = None
    control_us: float | None = None


def run_protocol(name: str, protocol: Protocol) -> tuple[Entry, dict[str, Draws]]:
    """Run a controller or an agent through all parts of a protocol.

    Args:
        name: Name of a registered controller, `module:name` of one, a shipped agent or an agent's folder, or a folder
            with one agent per task in the folders `reach` and `track`.

    Returns:
        The controller or agent, and the values of all draws (episodes) by part and metric, in the unit of the metric.

    Raises:
        InputError: If the name is unknown, the entry cannot run on the tasks, the simulated motion diverges, or the
            installed packages give other draws (episodes) than the protocol declares.
    """
    protocol.check()
    load_plugins()
    values, entries, timed = {}, [], []
    for part in protocol.parts:
        entry, controller = make_entry(name, protocol, part)
        entries.append(entry)
        timed.append(TimedController(controller))
        values[part] = draw_values(rollout(timed[-1], protocol.scenario(part)))
    cost = 1e6 * sum(t.cpu_s for t in timed) / sum(t.actions for t in timed)
    return _combined(entries)._replace(control_us=round(cost, 1)), values


def _combined(entries: Sequence[Entry]) -> Entry:
    """Return the entry of a collection: agents of several tasks share a name, and their costs add up."""
    different = list({entry.sha256: entry for entry in entries}.values())
    if len(different) == 1:
        return entries[0]

    def joined(field: str) -> str:
        parts = (part for entry in different for part in getattr(entry, field).split(", "))
        return ", ".join(dict.fromkeys(parts))

    def total(field: str) -> Any:
        numbers = [getattr(entry, field) for entry in different]
        return None if None in numbers else round(sum(numbers), 1)

    return entries[0]._replace(
        sha256=hashlib.sha256("".join(entry.sha256 for entry in different).encode()).hexdigest(),
        algorithm=joined("algorithm"),
        model=joined("model"),
        training_steps=total("training_steps"),
        training_cpu_s=total("training_cpu_s"),
    )


def make_entry(name: str, protocol: Protocol, part: str) -> tuple[Entry, Controller]:
    """Create the controller or agent of a given name for a part (task) of a protocol; it controls all draws at once.

    Controllers are designed from the declared machine. If the protocol observes sensors, a controller that needs the
    full state, or an agent that was trained with it, receives the estimates of a `StateEstimator`.

    Args:
        name: Controller such as "pid", agent or its folder, or folder with one agent each in `reach` and `track`.

    Raises:
        InputError: If the name is unknown or the controller cannot run on the task.
    """
    scenario = protocol.declared_scenario(part)
    collection, folder = name, Path(name) / scenario.task_name
    name = str(folder) if folder.is_dir() else name
    controller = make_controller(name, scenario)
    # A registered name is that of a controller also where a folder has the same name.
    sources = () if name in CONTROLLERS else map(CONTROLLER_SOURCES.get, CONTROLLER_SOURCES)
    files = next(filter(None, (source.files(name, scenario) for source in sources)), None)
    entry = _controller_entry(name, controller)
    if files:
        entry = Entry(
            Path(collection).name if folder.is_dir() else files.name,
            "agent",
            _hash(files.files),
            files.algorithm,
            model=files.model,
            training_steps=files.training_steps,
            training_cpu_s=files.training_cpu_s,
        )
    needs_state = files.sensors == "state" if files else controller.feedback != "observation"
    observed = observed_machine(protocol.declared_machine, protocol.sensors)  # type: ignore[arg-type]
    if observed is not None and needs_state:
        controller = OutputFeedbackController(controller, StateEstimator(observed, protocol.period))
        return entry._replace(observes="Kalman estimates"), controller
    return entry._replace(observes="state" if observed is None else "measurements"), controller


def _controller_entry(name: str, controller: Controller) -> Entry:
    """Return the entry of a controller: modules of its package that it uses, its files and its weights identify it.

    A controller with weights is learned, whatever its class says.
    """
    found: dict[str, Path] = {}
    modules = [inspect.getmodule(type(controller))]
    package = modules[0].__package__ if modules[0] is not None else None
    while modules:
        module = modules.pop()
        if module is None or module.__name__ in found:
            continue
        found[module.__name__] = Path(inspect.getfile(module))
        used = {str(getattr(value, "__module__", "")) for value in vars(module).values()} & set(sys.modules)
        if package:
            modules += [sys.modules[name] for name in sorted(used) if f"{name}.".startswith(f"{package}.")]
    weights = _weights(controller)
    sources = tuple(found[module_name] for module_name in sorted(found))
    digest = _hash((*sources, *map(Path, controller.files)), weights)
    learned = bool(weights or controller.files)
    return Entry(
        name,
        "agent" if learned else "controller",
        digest,
        "own" if learned else "",
        model=controller.knowledge,
    )


def _weights(controller: Controller) -> list[bytes]:
    """Return the weights of all networks that a controller, or its module, holds, as bytes in a fixed order."""
    torch = sys.modules.get("torch")
    if torch is None:  # nothing can hold a network of torch
        return []
    module = inspect.getmodule(type(controller))
    shared = (
        [value for key, value in sorted(vars(module).items()) if not key.startswith("__")] if module else []
    )
    pending, seen, networks = [controller, *shared], set(), []
    while pending:
        value = pending.pop(0)
        if id(value) in seen or isinstance(value, type | ModuleType | FunctionType | Machine):
            continue
        seen.add(id(value))
        if isinstance(value, torch.nn.Module):
            networks.append(value)
        elif isinstance(value, Mapping):
            pending += value.values()
        elif isinstance(value, list | tuple | set):
            pending += value
        else:
            pending += getattr(value, "__dict__", {}).values()
    parts: list[bytes] = []
    for network in networks:
        for name, tensor in sorted(network.state_dict().items()):
            parts += [f"{name} {tuple(tensor.shape)} {tensor.dtype}".encode(), tensor.cpu().numpy().tobytes()]
    return parts


def _hash(files: tuple[Path, ...], others: Sequence[bytes] = ()) -> str:
    """Return the SHA-256 of the contents of files, in order, and of further bytes."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    for content in others:
        digest.update(content)
    return digest.hexdigest()


def draw_values(episodes: Episodes) -> Draws:
    """Compute the metrics of every episode of one task of a protocol; its scores follow from them.

    Returns:
        By name of the metric, a list of B values, rounded to 6 decimals. For moves to a point: `settling_s.1mm`,
        `settling_s.0.2mm` and `settling_s.0.05mm`, time until the tool stays this close to the goal, s, None if it does
        not; and `final_error_mm`, mm. For paths: `contour_rms_mm`, `contour_max_mm` and `tracking_rms_mm`, mm.
    """
    if episodes.contour is None:
        values: Draws = {}
        for band, radius in BANDS.items():
            times, success = settling_times(episodes.goal_error, episodes.time_s, radius)
            pairs = zip(times.tolist(), success.tolist(), strict=True)
            values[f"settling_s.{band}"] = [
                round(time, DECIMALS) if settled else None for time, settled in pairs
            ]
        return values | {"final_error_mm": _rounded(1e3 * episodes.goal_error[:, -1])}
    return {
        "contour_rms_mm": _rounded(1e3 * np.sqrt(np.mean(episodes.contour**2, axis=1))),
        "contour_max_mm": _rounded(1e3 * episodes.contour.max(axis=1)),
        "tracking_rms_mm": _rounded(1e3 * np.sqrt(np.mean(episodes.goal_error**2, axis=1))),
    }


def _rounded(values: Array) -> list[float | None]:
    """Return values (B,) rounded to `DECIMALS`."""
    return [round(value, DECIMALS) for value in values.tolist()]
