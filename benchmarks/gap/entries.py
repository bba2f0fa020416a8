"""Entries: the interface of what can be scored, and the entries of the repository.

An entry is a class. The protocol makes one object per plant, calls `prepare` once, `practice` after each
practice episode of the online track, and `controller` once per task. A class of your own is named
`package.module:Class` on the command line.

| name | track | what controls the plant |
|---|---|---|
| `pid`, `predictive`, `adaptive-pid`, `textbook-pid` | zero-shot | designed from the declared machine |
| `ppo_mix`, `apg_mix`, `residual`, `sac`, ... | zero-shot | agents with laws of the declared machine |
| `history` | zero-shot | PPO that corrects `pid` and observes the last periods (`history_policy`) |
| `NAME-drift` | zero-shot | NAME; its state estimator also estimates slow errors of the encoders |
| `NAME-learned` | identified | NAME, and voltages learned from the recordings (`learned_residual`) |
| `NAME-refitted` | identified | NAME, designed from the machine whose own parameters are refitted |
| `NAME-corrected` | identified | NAME, designed from the machine with the effects that identification found |
| `NAME-posterior` | identified | the same; the state estimator begins with the posterior of the parameters |
| `NAME-online` | online | NAME's estimator keeps the parameters that it finds in practice |
| `REACH+TRACK` | zero-shot | two policies of yours: `model.zip` or `hframe train` (`saved_policies`) |
| `ppo-trained`, `ppo_mix-trained`, `apg-trained`, ... | identified | trained on the corrected machine |

State estimators of identified entries take the encoders for sensors that drift if the held-out recordings are
then more probable (`encoders_drift`).

The weights of an agent NAME are those of seed 0; `NAME-seed1-corrected` and the like are those of other
seeds, which `hframe train` trains first where the package does not ship them
(`benchmarks.agent_seeds.agent_folder`).
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import inspect
import json
import re
import sys
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar, Literal

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
from hframe_gym.errors import InputError
from hframe_gym.files import write_text
from hframe_gym.machine import Machine
from tests.reference_simulator import Array

Trackname = Literal["zero-shot", "identified", "online"]
MODELS = ("refitted", "corrected", "posterior")
HISTORY = "history"  # the entry of `history_policy`
VARIANTS = ("drift", "learned", *MODELS, "online")
# Relative standard deviation, added to the posterior: what identification cannot know, such as heat and wear.
_FLOOR = 0.02
# PPO continues a policy with a critic of random weights. At the learning rate of `ppo_mix_reach`, 1e-3, first
# updates slow moves on the machine of plant 0 by 5 %, which training does not make up; at this one they
# become 5 % faster.
_CONTINUED = {"learning_rate": [3e-4, 1e-5], "target_kl": 0.02}


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


class TrainedAgent(IdentifiedMachine):
    """An agent that is trained on the corrected machine of the plant, randomized over its posterior.

    Training continues from the shipped agents of seed 0; the agents of a plant are kept in its folder.

    Attributes:
        recipes: By task, recipe and shipped agent from which its training starts.
        steps: Environment steps of each training.
    """

    recipes: ClassVar[dict[str, tuple[str, str]]] = {}
    steps: ClassVar[int] = 200_000
    learned = True
    knowledge = "corrected machine, trained on its posterior"

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        super().prepare(declared, recorder, folder)
        self.folders = {task: folder / f"{self.name}-{task}-{self.steps}" for task in self.recipes}
        for task, out in self.folders.items():
            self._train(task, out)

    def _train(self, task: str, out: Path) -> None:
        """Train the agent of a task, unless its folder holds the one of this machine."""
        from hframe_gym.agents import load_recipe, train

        done, machine_key = out / "trained_on.txt", IdentifiedMachine.key(self)
        if done.is_file() and done.read_text("utf-8") == machine_key:
            return
        name, start = self.recipes[task]
        recipe = load_recipe(name, task)
        randomize = "identified" if self.machine.uncertainty is not None else "default"
        environment = {**recipe.env, "randomize": randomize}
        algorithm = recipe.algorithm | (_CONTINUED if recipe.kind == "ppo" else {})
        recipe = dataclasses.replace(
            recipe, steps=self.steps, env=environment, start=start, algorithm=algorithm
        )
        train(recipe, self.machine, task, seed=0, out=out, log=lambda line: None, force=True)
        write_text(done, str(machine_key))

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
            "training_steps": self.steps,
            "training_cpu_s": round(sum(card["curve"][-1]["cpu_s"] for card in cards.values()), 1),
            "kept_steps": {task: card["kept"] for task, card in cards.items()},
        }


# Recipes of the agents of an entry, by task; where a task has none of this name, the nearest of its kind.
AGENTS = {
    "ppo": {"reach": "ppo", "track": "ppo"},
    "ppo_mix": {"reach": "ppo_mix", "track": "residual"},
    "sac": {"reach": "sac", "track": "sac"},
    "sac_mix": {"reach": "sac_mix", "track": "sac"},
    "apg": {"reach": "apg", "track": "apg"},
    "apg_mix": {"reach": "apg_mix", "track": "apg_wide"},
    "apg_wide": {"reach": "apg_wide", "track": "apg_wide"},
    "residual": {"reach": "residual", "track": "residual"},
}
TRAINED = {  # recipe and shipped start of each task
    "ppo": {"reach": ("adapt", "ppo"), "track": ("ppo", "ppo")},
    "apg": {"reach": ("adapt_mix", "apg_mix"), "track": ("apg", "apg")},
    "ppo_mix": {"reach": ("ppo_mix", "ppo_mix"), "track": ("residual", "residual")},
    "residual": {"reach": ("residual", "residual"), "track": ("residual", "residual")},
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


def entry_names() -> list[str]:
    """Return the names of the repository's entries; NAME-seedN... is an agent with another seed than 0."""
    designs = [name for name in CONTROLLERS if not CONTROLLERS.get(name).set_points] + list(AGENTS)
    variants = [f"{name}-{variant}" for name in designs for variant in VARIANTS]
    return [*designs, HISTORY, *variants, *(f"{agent}-trained" for agent in TRAINED)]


def get_entry(name: str) -> type[GapEntry]:
    """Return the class of an entry.

    Args:
        name: Name of an entry of the repository, `REACH+TRACK` of two saved policies, or
            `package.module:Class`.

    Returns:
        The class; the protocol makes one object per plant.

    Raises:
        InputError: If there is no such entry, or its class lacks a method.
    """
    module, _, attribute = name.partition(":")
    if attribute:
        try:
            found = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"entry {name!r}: {error}; modules are found in the current folder and on PYTHONPATH"
            ) from None
        if not (isinstance(found, type) and issubclass(found, GapEntry)):
            raise InputError(f"entry {name!r} is not a subclass of benchmarks.gap.entries.GapEntry")
        if missing := found.__abstractmethods__:
            raise InputError(f"entry {name!r} lacks the method {' and '.join(sorted(missing))}")
        return found
    base, _, variant = name.rpartition("-")
    if base in TRAINED and variant == "trained":
        return _made(f"{base}-seed0-trained", TrainedAgent, recipes=TRAINED[base])
    if variant not in VARIANTS:
        base, variant = name, "declared"
    from benchmarks.gap.learned_residual import LearnedResidual

    others: dict[str, type[DesignedEntry]] = {
        "declared": DeclaredMachine,
        "drift": DriftingEncoders,
        "learned": LearnedResidual,
        "online": OnlineMachine,
    }
    machine = others.get(variant, IdentifiedMachine)
    settings = {"model": variant, "knowledge": f"{variant} machine"} if variant in MODELS else {}
    if base in CONTROLLERS:
        return _made(name, RegisteredController, machine, registered=base, **settings)
    agent, _, seed = base.partition("-seed")
    if agent in AGENTS and (seed.isdigit() or base == agent):
        seed = seed or "0"
        agents = {task: f"{shipped}-seed{seed}" for task, shipped in AGENTS[agent].items()}
        name = f"{agent}-seed{seed}{name.removeprefix(base)}"  # every result states its seed
        return _made(name, SeededAgent, machine, agents=agents, **settings)
    if agent == HISTORY and (seed.isdigit() or base == agent) and variant == "declared":
        from benchmarks.gap.history_policy import HistoryPolicy

        return _made(f"{HISTORY}-seed{seed or 0}", HistoryPolicy, seed=int(seed or 0))
    from benchmarks.gap.saved_policies import SavedPolicies, read_name

    if saved := read_name(name):
        return _made(saved.label, SavedPolicies, paths=saved.paths, measured=saved.measured)
    raise InputError(
        f"entry {name!r} is unknown; choose of {', '.join(entry_names())}, "
        "REACH+TRACK of two saved policies, or package.module:Class"
    )


def _made(name: str, *bases: type[GapEntry], **attributes: object) -> type[GapEntry]:
    """Return a class of an entry with its name and settings."""
    fixed = {"name": name, "generated": True, "__module__": __name__}
    return type(bases[0].__name__, bases, {**fixed, **attributes})
