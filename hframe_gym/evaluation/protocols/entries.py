"""Entries of protocols: the controllers and agents that are scored, each identified by what determines it.

Agents are known by their files, controllers by their source, their files and the weights of their networks.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from ...controllers import CONTROLLERS, Controller, OutputFeedbackController, StateEstimator
from ...envs import observed_machine
from ...machine import Machine
from ...registry import load_plugins
from ..controller_creation import CONTROLLER_SOURCES, make_controller
from ..runner import rollout
from ..timed_controller import TimedController
from .protocol import Draws, Protocol, draw_values


class Entry(NamedTuple):
    """Controller or agent to which a result belongs.

    Attributes:
        name: Name in results and on the leaderboard.
        kind: "controller" (designed from the declared machine) or "agent" (learned).
        sha256: Hash of everything that determines the entry: files of an agent; source, files and weights of
            a controller.
        algorithm: Training algorithm, for example "ppo"; empty for a controller.
        model: What it knows of the declared machine, in a few words.
        observes: "state", "measurements", or "Kalman estimates" (`StateEstimator` of the package).
        training_steps: Environment steps of its training; None if unknown or without training.
        training_cpu_s: Processor time of its training, s; None if unknown or without training.
        control_us: Processor time of `act` per control period of one machine, us; None if it was not
            measured.
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
        name: Name of a registered controller, `module:name` of one, a shipped agent or an agent's folder, a
            model.zip, or a folder with one agent per task: the folders `reach` and `track`, or `reach.zip`
            and `track.zip`.

    Returns:
        The controller or agent, and the values of all draws (episodes) by part and metric, in the unit of the
        metric.

    Raises:
        InputError: If the name is unknown, the entry cannot run on the tasks, the simulated motion diverges,
            or the installed packages give other draws (episodes) than the protocol declares.
    """
    protocol.check()
    load_plugins()
    entries, controllers = zip(*(make_entry(name, protocol, part) for part in protocol.parts), strict=True)
    timed = [TimedController(controller) for controller in controllers]
    values = {
        part: draw_values(rollout(controller, protocol.scenario(part)))
        for part, controller in zip(protocol.parts, timed, strict=True)
    }
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
    """Create a controller or agent by name for a part (task) of a protocol, and the entry that describes it.

    The controller controls the machines of all draws at once.

    Controllers are designed from the declared machine. If the protocol observes sensors, a controller that
    needs the full state, or an agent that was trained with it, receives the estimates of a `StateEstimator`.

    Args:
        name: Controller such as "pid", agent or its folder, model.zip, or folder with one of them for each
            task.
        part: Name of the part, such as "reach".

    Returns:
        The entry, to which results belong, without `control_us`; and the controller.

    Raises:
        InputError: If the name is unknown or the controller cannot run on the task.
    """
    scenario = protocol.declared_scenario(part)
    collection = Path(name)
    of_task = agent_of_task(collection, scenario.task_name)
    name = name if of_task is None else str(of_task)
    controller = make_controller(name, scenario)
    # A registered name is that of a controller also where a folder has the same name.
    sources = () if name in CONTROLLERS else map(CONTROLLER_SOURCES.get, CONTROLLER_SOURCES)
    files = next(filter(None, (source.files(name, scenario) for source in sources)), None)
    entry = _controller_entry(name, controller)
    if files:
        entry = Entry(
            files.name if of_task is None else collection.name,
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


def agent_of_task(collection: Path, task: str) -> Path | None:
    """Return the agent of a task in a folder of several agents: its folder, or else its .zip file.

    Args:
        collection: Folder with one agent per task, named by the task: "reach" or "reach.zip".
        task: Name of the task, such as "reach".

    Returns:
        Path of the agent; None if the folder has neither.
    """
    folder, file = collection / task, collection / f"{task}.zip"
    return folder if folder.is_dir() else file if file.is_file() else None


def _controller_entry(name: str, controller: Controller) -> Entry:
    """Return the entry of a controller: modules of its package, its files and its weights identify it.

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
    """Return the weights of all networks of a controller, or its module, as bytes in a fixed order."""
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
