"""Models of stable-baselines3 (`model.save("model.zip")`) as controllers.

Importing this module registers them with `hframe_gym.evaluation.make_controller`. Loading such a file
executes code that it may contain: evaluate only files whose origin you trust.
"""

from __future__ import annotations

import dataclasses
import json
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from typing_extensions import override

from ..arrays import Mask
from ..controllers import EpisodeStarts, PolicyController
from ..envs import EnvOptions, as_sensors
from ..envs.observation.spaces import ObservationFormat
from ..errors import InputError
from ..evaluation import CONTROLLER_SOURCES, ControllerFiles, ControllerSource, Scenario, environments_of
from ..machine import Machine
from .optional_dependencies import CONTRIB_ALGORITHMS, import_optional, single_threaded_torch

# Options of the forms of observations that an environment can have.
_FORMS = tuple(
    EnvOptions(normalize=normalize, flat=flat, error=error)
    for error in (False, True)
    for flat in (False, True)
    for normalize in (False, True)
)
# In place of the settings of a replay buffer, which a policy does not need: one of a million transitions
# would be allocated, and that of hindsight experience replay refuses to exist without its environment.
_NO_REPLAY: dict[str, Any] = {"buffer_size": 1, "replay_buffer_class": None, "replay_buffer_kwargs": {}}
# Module of the policy classes of PPO and A2C; those of the other algorithms are in a module of their name.
_ON_POLICY = "stable_baselines3.common.policies"
_RECURRENT = "sb3_contrib.common.recurrent.policies"


class Sb3Model(PolicyController):
    """Controller that applies the mean action of a model to observations in the format of its training.

    Args:
        model: Model of stable-baselines3.
        form: Format of the model's observations, into which observations by key in SI units are converted.
        period: Control period, s.
        full_state: Whether the model observes the full state instead of sensors.
    """

    def __init__(
        self, model: Any, form: ObservationFormat, machine: Machine, period: float, full_state: bool = True
    ) -> None:
        super().__init__(self._mean_actions, form, machine, period, full_state)
        self.model = model
        self._starts, self._memory = EpisodeStarts(), None  # the memory of a recurrent policy

    @override
    def reset(self, mask: Mask | None = None) -> None:
        """Clear the memory of a recurrent policy for the machines in `mask`; None: all."""
        self._starts.reset(mask)

    def _mean_actions(self, observation: Any) -> Any:
        """Return the mean actions of the model."""
        parts = observation.values() if isinstance(observation, dict) else [observation]
        if self._starts.resize(len(next(iter(parts)))):
            self._memory = None
        with single_threaded_torch():
            actions, self._memory = self.model.predict(
                observation, self._memory, self._starts.mask, deterministic=True
            )
        self._starts.clear()
        return actions


@CONTROLLER_SOURCES.register("stable-baselines3")
class ZipSource(ControllerSource):
    """Source of models in files `NAME.zip` of stable-baselines3."""

    @staticmethod
    @override
    def make(name: str, scenario: Scenario) -> Sb3Model | None:
        """Load a model from a zip file, and determine the format of observations that it was trained with.

        Returns None if the name is not that of a zip file.

        Raises:
            InputError: If the file is no model of stable-baselines3, its observations or actions are not
                those of an environment of this scenario (the message says which are missing), or
                `VecNormalize` scaled them.
        """
        if not _is_zip(name):
            return None
        model = _load(Path(name))
        _check_scaling(name, model)
        one = dataclasses.replace(scenario, episodes=1)
        observed = EnvOptions(sensors=one.sensors, period=one.period)
        environments = [environments_of(one, **observed | form) for form in _FORMS]
        wanted = environments[0].single_action_space
        if not _same(model.action_space, wanted):
            raise InputError(
                f"{name}: its actions are {model.action_space}, "
                f"those of machine {scenario.declared_machine.name!r} are {wanted}"
            )
        for envs in environments:
            if _same(model.observation_space, envs.single_observation_space):
                full_state = as_sensors(scenario.sensors) is None
                return Sb3Model(
                    model, envs.batch.format, scenario.declared_machine, scenario.period, full_state
                )
        offered = [envs.single_observation_space for envs in environments]
        raise InputError(
            f"{name}: {_difference(model.observation_space, _nearest(model.observation_space, offered))}"
        )

    @staticmethod
    @override
    def describe(scenario: Scenario) -> str:
        """Return "a model that stable-baselines3 saved (NAME.zip)"."""
        return "a model that stable-baselines3 saved (NAME.zip)"

    @staticmethod
    @override
    def files(name: str, scenario: Scenario) -> ControllerFiles | None:
        """List the file, whose content identifies the model, its algorithm and number of training steps.

        Returns None if the name is not that of a zip file.
        """
        if not _is_zip(name):
            return None
        data = _data(Path(name))
        sensors = scenario.sensors if isinstance(scenario.sensors, str) else "own"
        steps = data.get("num_timesteps")
        return ControllerFiles(
            Path(name).stem,
            (Path(name),),
            sensors,
            _algorithm(Path(name), data).lower(),
            "none",
            steps if isinstance(steps, int) else None,
        )


def _is_zip(name: str) -> bool:
    """Return whether a user's name of a controller is that of a zip file."""
    return name.endswith(".zip") and Path(name).is_file()


def _data(path: Path) -> dict[str, Any]:
    """Return the settings in a model's file; raise InputError if it has none."""
    try:
        with zipfile.ZipFile(path) as archive:
            return dict(json.loads(archive.read("data")))
    except KeyError:
        raise InputError(
            f"{path}: is no model that stable-baselines3 saved (it has no file named data)"
        ) from None
    except (zipfile.BadZipFile, ValueError, OSError) as error:
        raise InputError(f"{path}: is no model that stable-baselines3 saved ({error})") from None


def _algorithm(path: Path, data: Mapping[str, Any]) -> str:
    """Return the class name of a model's algorithm; raise InputError if it is none of those known here."""
    policy = data.get("policy_class")
    module = str(policy.get("__module__", "")) if isinstance(policy, dict) else ""
    if module == _RECURRENT:
        return "RecurrentPPO"
    if module == _ON_POLICY:
        return "PPO" if "n_epochs" in data else "A2C"
    name = module.split(".")[-2] if module.count(".") >= 2 else ""
    if name in ("sac", "td3", *CONTRIB_ALGORITHMS):
        return "CrossQ" if name == "crossq" else name.upper()
    raise InputError(
        f"{path}: its policy is of the module {module or 'unknown'}; the algorithms are PPO, RecurrentPPO, "
        "A2C, SAC, TD3, TQC and CrossQ. Wrap another one in a registered controller (docs/extending.md)"
    )


def _load(path: Path) -> Any:
    """Load a model."""
    name = _algorithm(path, _data(path))
    contrib = name == "RecurrentPPO" or name.lower() in CONTRIB_ALGORITHMS
    package = import_optional("sb3_contrib" if contrib else "stable_baselines3")
    try:
        return getattr(package, name).load(path, device="cpu", custom_objects=_NO_REPLAY)
    except (ValueError, TypeError, RuntimeError, KeyError, AttributeError, ModuleNotFoundError) as error:
        raise InputError(f"{path}: cannot be loaded: {' '.join(str(error).split())[:200]}") from None


def _check_scaling(name: str, model: Any) -> None:
    """Raise InputError if `VecNormalize` scaled the training's observations; warn if it may have done so.

    Its statistics are not in the file, but the last observations are: scaled to a standard deviation of 1,
    they leave the observation space, which `VecNormalize` does not change, and observations of the
    environment never do. Where they do not, an algorithm without a replay buffer has original observations
    only if there was a `VecNormalize`, which may have scaled nothing but the rewards.
    """
    last, space = getattr(model, "_last_obs", None), model.observation_space
    advice = (
        "Evaluate a controller of your own that loads the model and its statistics "
        "(docs/with_your_library.md, VecNormalize)"
    )
    if last is not None and not _within(space, last):
        raise InputError(
            f"{name}: was trained on observations that were scaled, "
            "as by VecNormalize: they lie outside their space. "
            f"The statistics, without which the actions mean nothing, are not in this file. {advice}"
        )
    has_replay = hasattr(model, "replay_buffer")
    if not has_replay and getattr(model, "_last_original_obs", None) is not None:
        warnings.warn(
            f"{name}: was trained with VecNormalize, whose statistics are not in this file. If it scaled "
            f"only rewards (norm_obs=False), all is well; otherwise the actions mean nothing. {advice}",
            stacklevel=2,
        )


def _within(space: Any, observation: Any) -> bool:
    """Return whether observations, one a row, lie in a space but for rounding."""
    if isinstance(space, spaces.Dict):
        return all(_within(box, observation[key]) for key, box in space.spaces.items() if key in observation)
    if not isinstance(space, spaces.Box):
        return True
    margin = 1e-5 * np.maximum(1.0, np.abs(np.where(np.isfinite(space.high), space.high, 1.0)))  # of float32
    return bool(np.all(observation >= space.low - margin) and np.all(observation <= space.high + margin))


def _same(space: Any, other: Any) -> bool:
    """Return whether two observation spaces are equal but for rounding."""
    if isinstance(space, spaces.Dict) and isinstance(other, spaces.Dict):
        return set(space.spaces) == set(other.spaces) and all(
            _same(space[key], other[key]) for key in other.spaces
        )
    if not (isinstance(space, spaces.Box) and isinstance(other, spaces.Box)) or space.shape != other.shape:
        return False
    return bool(
        np.allclose(space.low, other.low, rtol=1e-5) and np.allclose(space.high, other.high, rtol=1e-5)
    )


def _nearest(space: Any, offered: Sequence[Any]) -> Any:
    """Return the dict among the observation spaces whose keys differ least from those of a model's."""
    dicts = [other for other in offered if isinstance(other, spaces.Dict)]
    keys = set(space.spaces) if isinstance(space, spaces.Dict) else set(dicts[0].spaces)
    return min(dicts, key=lambda other: len(keys ^ set(other.spaces)))


def _difference(space: Any, wanted: Any) -> str:
    """Return a sentence about what a model observes and the environment does not have, or the reverse."""
    if isinstance(space, spaces.Dict):
        missing = ", ".join(key for key in wanted.spaces if key not in space.spaces)
        superfluous = ", ".join(key for key in space.spaces if key not in wanted.spaces)
        shapes = [
            f"{key} has shape {space[key].shape}, not {wanted[key].shape}"
            for key in wanted.spaces
            if key in space.spaces and space[key].shape != wanted[key].shape
        ]
        reasons = [
            *([f"it does not observe {missing}"] if missing else []),
            *([f"it observes {superfluous}, which the environment lacks"] if superfluous else []),
            *shapes,
        ]
        found = "; ".join(reasons) or "the bounds of its observations are others"
    else:
        size = sum(int(np.prod(box.shape)) for box in wanted.spaces.values())
        shape = getattr(space, "shape", None)
        found = (
            f"it observes one array of shape {shape}, not ({size},)"
            if shape != (size,)
            else "its bounds are others"
        )
    return (
        f"was trained on other observations: {found}. Evaluate it with the machine, task and sensors of its "
        "training; a model behind a wrapper that scales, stacks or adds "
        "observations needs a registered controller (docs/extending.md)"
    )
