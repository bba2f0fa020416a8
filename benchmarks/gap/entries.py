"""Entries: the interface of what can be scored, and those that a machine and a design make.

An entry is a class. The protocol makes one object per plant, calls `prepare` once, `practice` after each
practice episode of the online track, and `controller` once per task. `catalog` names the entries.

State estimators of identified entries take the encoders for sensors that drift if the held-out recordings are
then more probable (`encoders_drift`).
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import re
import sys
from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from typing_extensions import override

from benchmarks.gap.control_loop import PERIOD_S, GapEpisodes
from benchmarks.gap.machines import identified
from benchmarks.gap.recorder import Recorder, standard_session
from hframe_gym.controllers import (
    CONTROLLERS,
    Controller,
    OutputFeedbackController,
    StateEstimator,
    encoders_drift,
)
from hframe_gym.envs import Task, observed_machine
from hframe_gym.files import write_text
from hframe_gym.machine import Machine
from tests.reference_simulator import Array

if TYPE_CHECKING:
    from hframe_gym.agents import Recipe

Trackname = Literal["zero-shot", "identified", "online"]
MODELS = ("refitted", "corrected", "posterior")
# Relative standard deviation, added to the posterior: what identification cannot know, such as heat and wear.
_FLOOR = 0.02
# Environment steps of a training on a plant, by kind of the algorithm: one to three minutes for both tasks.
_STEPS = {"ppo": 200_000, "apg": 200_000, "sac": 80_000}
# PPO continues a policy with a critic of random weights. At the learning rate of `ppo_mix_reach`, 1e-3, first
# updates slow moves on the machine of plant 0 by 5 %, which training does not make up; at this one they
# become 5 % faster. The critics of SAC learn alone for a quarter of the steps, from episodes of the policy.
_CONTINUED: dict[str, dict[str, Any]] = {
    "ppo": {"learning_rate": [3e-4, 1e-5], "target_kl": 0.02},
    "sac": {"learning_rate": [3e-4, 1e-5], "learning_starts": 0, "critic_steps": 20_000},
}


class GapEntry(ABC):
    """What the protocol scores on one plant. Subclass it, and name the class `package.module:Class`.

    Attributes:
        name: Name in results.
        track: "zero-shot" (no recording), "identified" (recordings) or "online" (practice episodes).
        knowledge: What it uses of the declared machine, a few words.
        learned: Whether a learned policy or model controls the plant.
    """

    name: str = ""
    learned: bool = False
    track: Trackname = "zero-shot"
    knowledge: str = "not stated"

    @abstractmethod
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        """Prepare for the control of a plant.

        Args:
            recorder: Recorder of the plant; it refuses on the zero-shot and the online track.
            folder: Folder of the plant, in which results of long work may be kept under the name of the
                entry.
        """

    @abstractmethod
    def controller(self, task: Task) -> Controller:
        """Return the controller of a task, for any number of episodes at once.

        Returns:
            Controller from the measurements x, y, m, phi1, phi2, rad.
        """

    def practice(self, episodes: GapEpisodes, controller: Controller) -> None:
        """Learn from a practice episode of the online track, which `controller(task)` has controlled.

        Args:
            episodes: The episode, without its true positions: `position` holds the measured ones of each
                period.
            controller: The controller after the episode.
        """
        raise NotImplementedError(
            f"{type(self).__name__} is of the online track and must learn from practice"
        )

    def about(self) -> dict[str, object]:
        """Return what a result should say about the preparation on this plant, as plain data."""
        return {}

    def key(self) -> str | None:
        """Return a hash of all that determines the control of the plant, or None if it is not known.

        Results of entries with equal keys on the same plant are equal, and are not computed twice.
        """
        return None

    @classmethod
    def files(cls) -> list[Path]:
        """Return the files that determine the entry besides its class, such as weights."""
        return []


def sha256_of(entry: type[GapEntry]) -> str:
    """Return a hash of what determines an entry: name, source of its classes, and its files.

    Of a class in another module than this one, the source of the module counts.
    """
    digest = hashlib.sha256(entry.name.encode())
    for base in entry.__mro__:
        if issubclass(base, GapEntry) and base is not GapEntry and not base.__dict__.get("generated"):
            here = base.__module__ == __name__
            digest.update(inspect.getsource(base if here else sys.modules[base.__module__]).encode())
    for file in entry.files():
        digest.update(file.read_bytes())
    return digest.hexdigest()


def from_measurements(
    controller: Controller, machine: Machine, covariance: Array | None = None, drifting_encoders: bool = False
) -> Controller:
    """Combine a controller that needs the full state with an estimator of the state from the measurements.

    Args:
        covariance: Covariance of the logarithms of the estimated parameters. Default: that of declared
            values.
        drifting_encoders: Whether the estimator also estimates errors of the encoders, which wander slowly.
    """
    observed = observed_machine(machine, "machine")
    assert observed is not None
    estimator = StateEstimator(observed, PERIOD_S, covariance, drifting_encoders)
    return OutputFeedbackController(controller, estimator)


def posterior_covariance(machine: Machine) -> Array | None:
    """Return the covariance of the log parameters that a state estimator estimates, after identification.

    Args:
        machine: Identified machine.

    Returns:
        Covariance, shape (k, k); None if the machine has none. A parameter that was not identified, such as
        the one motor constant that defines the unit of force, has the standard deviation of the floor, 2 %;
        one that was identified badly has that of a declared value.
    """
    if machine.uncertainty is None:
        return None
    observed = observed_machine(machine, "machine")
    assert observed is not None
    declared = StateEstimator(observed, PERIOD_S).augmented
    names = declared.names
    known = {name: i for i, name in enumerate(machine.uncertainty.names)}
    covariance = _FLOOR**2 * np.eye(len(names))
    pairs = [(row, known[name], machine.parameters[name]) for row, name in enumerate(names) if name in known]
    for row, i, value in pairs:
        for column, j, other in pairs:
            covariance[row, column] += machine.uncertainty.covariance[i, j] / (value * other)
    return _limited(covariance, declared.covariance)


def _limited(covariance: Array, prior: Array) -> Array:
    """Return a covariance with standard deviations of at most those of a prior, and the same correlations."""
    scale = np.sqrt(np.minimum(1.0, np.diag(prior) / np.diag(covariance)))
    return np.asarray(covariance * np.outer(scale, scale))


class DesignedEntry(GapEntry):
    """A controller that is designed from a machine and runs on its state estimator's estimates.

    `RegisteredController` and `SeededAgent` say how it is designed; `DeclaredMachine`, `IdentifiedMachine`
    and `OnlineMachine` say which machine it is. An entry is one of each.

    Attributes:
        machine: Machine of the controller and of the state estimator.
        covariance: Covariance of the logarithms of the parameters with which the estimator begins; None: the
            default.
        drifting_encoders: Whether the estimator also estimates errors of the encoders, which wander slowly.
    """

    machine: Machine
    covariance: Array | None = None
    drifting_encoders: bool = False

    def design(self, task: Task) -> Controller:
        """Return the controller of a task, which may need the full state."""
        raise NotImplementedError

    @override
    def controller(self, task: Task) -> Controller:
        return from_measurements(self.design(task), self.machine, self.covariance, self.drifting_encoders)


class RegisteredController(DesignedEntry):
    """A registered controller."""

    registered: ClassVar[str] = ""

    @classmethod
    @override
    def files(cls) -> list[Path]:
        return [Path(inspect.getfile(CONTROLLERS.get(cls.registered)))]

    @override
    def design(self, task: Task) -> Controller:
        return CONTROLLERS.get(self.registered)(self.machine, PERIOD_S)


class SeededAgent(DesignedEntry):
    """An agent of the package's recipes: its weights, with the control laws of the machine.

    Attributes:
        agents: Names of the agents by task, with the seeds of their training.
    """

    learned = True
    agents: ClassVar[dict[str, str]] = {}

    @classmethod
    @override
    def files(cls) -> list[Path]:
        from benchmarks.agent_seeds import agent_folder

        folders = [agent_folder(name, task) for task, name in cls.agents.items()]
        return [folder / file for folder in folders for file in ("agent.json", "policy.safetensors")]

    @override
    def design(self, task: Task) -> Controller:
        from benchmarks.agent_seeds import agent_folder
        from hframe_gym.agents import Agent

        return Agent.load(agent_folder(self.agents[task.name], task.name), self.machine)


class DeclaredMachine(DesignedEntry):
    """The machine is the declared one."""

    knowledge = "declared machine"

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        self.machine = declared


class DriftingEncoders(DeclaredMachine):
    """The machine is the declared one, and its state estimator takes the encoders for sensors that drift."""

    knowledge = "declared machine, encoders may drift"
    drifting_encoders = True


class IdentifiedMachine(DesignedEntry):
    """The machine is identified from the standard session.

    Attributes:
        model: "refitted" (own parameters alone), "corrected" (with effects) or "posterior" (with effects, and
            the estimator begins with the posterior of the parameters).
    """

    model: ClassVar[str] = "corrected"
    track: Trackname = "identified"

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        recordings = standard_session(recorder)
        # All entries of a plant share the identification.
        self.found = identified(recordings, declared, folder / "standard")
        self.machine = self.found.refitted if self.model == "refitted" else self.found.corrected
        self.covariance = posterior_covariance(self.machine) if self.model == "posterior" else None
        held_out = [recording for recording in recordings if recording.name in self.found.held_out]
        self.drifting_encoders = encoders_drift(self.machine, held_out, PERIOD_S)

    @override
    def key(self) -> str | None:
        # Without effects, refitted and corrected are the same.
        machine = self.machine
        sensors = [[s.channel, s.noise, s.resolution, s.zero] for s in machine.sensors]
        covariance = None if self.covariance is None else self.covariance.tolist()
        effects = [effect.label for effect in machine.effects]
        design = self.name.removesuffix(f"-{self.model}")
        content = [design, machine.parameters, effects, sensors, covariance, self.drifting_encoders]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    @override
    def about(self) -> dict[str, object]:
        effects = list(self.found.found)
        return {
            "verdict": self.found.verdict,
            "found": effects,
            "left": self.found.left,
            "cpu_s": self.found.cpu_s,
            "drifting_encoders": self.drifting_encoders,
        }


class OnlineMachine(DeclaredMachine):
    """The machine is the declared one, with the parameters that the estimator finds in practice episodes.

    After each episode the estimated ratios of the parameters become those of the model, and the estimator's
    covariance becomes its prior of the next episode, widened by the floor.
    """

    track: Trackname = "online"
    knowledge = "declared machine, estimates parameters"

    @override
    def practice(self, episodes: GapEpisodes, controller: Controller) -> None:
        assert isinstance(controller, OutputFeedbackController)
        estimator = controller.estimator
        assert isinstance(estimator, StateEstimator)
        names = estimator.augmented.names
        values = self.machine.parameters
        ratios = estimator.parameter_ratios[0]
        self.machine = self.machine.replace(
            {name: values[name] * float(ratio) for name, ratio in zip(names, ratios, strict=True)}
        )
        after = estimator.parameter_covariance[0] + _FLOOR**2 * np.eye(len(names))
        # Not wider than before the episode: an inflated covariance says that the model lacks something.
        self.covariance = _limited(after, estimator.augmented.covariance)


def continued(recipe: Recipe, start: str, randomize: str) -> Recipe:
    """Return the recipe by which a shipped agent is trained further on one machine.

    Args:
        recipe: Recipe of the agent.
        start: Name of the shipped agent.
        randomize: Randomization of the machine.
    """
    algorithm = recipe.algorithm | _CONTINUED.get(recipe.kind, {})
    if isinstance(algorithm.get("target_entropy"), list):  # the noise at the end of the agent's training
        algorithm["target_entropy"] = algorithm["target_entropy"][-1]
    environment = {**recipe.env, "randomize": randomize}
    return dataclasses.replace(
        recipe, steps=_STEPS[recipe.kind], env=environment, start=start, algorithm=algorithm
    )


class TrainedAgent(IdentifiedMachine):
    """An agent that is trained on the corrected machine of the plant, randomized over its posterior.

    Training continues from the shipped agents of seed 0; the agents of a plant are kept in its folder.

    Attributes:
        recipes: By task, recipe and shipped agent from which its training starts.
    """

    recipes: ClassVar[dict[str, tuple[str, str]]] = {}
    learned = True
    knowledge = "corrected machine, trained on its posterior"

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        super().prepare(declared, recorder, folder)
        self.folders = {task: folder / f"{self.name}-{task}" for task in self.recipes}
        for task, out in self.folders.items():
            self._train(task, out)

    def _train(self, task: str, out: Path) -> None:
        """Train the agent of a task, unless its folder holds the one of this machine and recipe."""
        from hframe_gym.agents import load_recipe, train

        name, start = self.recipes[task]
        randomize = "identified" if self.machine.uncertainty is not None else "default"
        recipe = continued(load_recipe(name, task), start, randomize)
        done, settings = out / "trained_on.txt", json.dumps(recipe.as_dict(), sort_keys=True)
        key = hashlib.sha256(f"{IdentifiedMachine.key(self)} {settings}".encode()).hexdigest()[:16]
        if done.is_file() and done.read_text("utf-8") == key:
            return
        train(recipe, self.machine, task, seed=0, out=out, log=lambda line: None, force=True)
        write_text(done, key)

    @override
    def design(self, task: Task) -> Controller:
        from hframe_gym.agents import Agent

        return Agent.load(self.folders[task.name])

    @override
    def key(self) -> str | None:
        return None

    @override
    def about(self) -> dict[str, object]:
        from hframe_gym.agents.agent_files import read_training_card

        cards = {task: read_training_card(folder / "card.json") for task, folder in self.folders.items()}
        return {
            **super().about(),
            "training_steps": {task: card["curve"][-1]["steps"] for task, card in cards.items()},
            "training_cpu_s": round(sum(card["curve"][-1]["cpu_s"] for card in cards.values()), 1),
            "kept_steps": {task: card["kept"] for task, card in cards.items()},
        }


def family(name: str) -> str:
    """Return the name of an entry without the seed of its agent, which results of several seeds share.

    Args:
        name: Name of an entry, for example "apg_mix-seed1-corrected".
    """
    return re.sub(r"-seed\d+", "", name)


def training_seed(name: str) -> int | None:
    """Return the seed of the agent of an entry; None if the entry is no agent.

    Args:
        name: Name of an entry, for example "apg_mix-seed1-corrected".
    """
    found = re.search(r"-seed(\d+)", name)
    return int(found[1]) if found else None
