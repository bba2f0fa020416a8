"""A trained policy as a controller, and its files.

A folder holds policy.safetensors (weights), agent.json (how to build the policy) and machine.json (the
machine on which it was trained). Loading them executes no code from the folder, so an agent may come from an
untrusted source.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Actions
from ..controllers import Controller, UnitCheck
from ..envs import SensorsLike, action_space, observation_space
from ..errors import InputError
from ..files import atomic_file, complete_commit, output_batch, write_text
from ..machine import Machine, observed_coordinates
from ..recordings import load_machine, save_machine
from .action_conversion import ActionConversion
from .agent_files import read_agent_json
from .features import feature_parameters
from .optional_dependencies import import_optional, single_threaded_torch
from .residual_action import ResidualAction, residual_action

# Entries of card.json that agent.json repeats: they identify the agent and are needed to build its policy.
AGENT_KEYS = (
    "schema",
    "name",
    "task",
    "kind",
    "machine",
    "seed",
    "recipe",
    "settings",
    "period",
    "features",
    "previews",
)
# Prefixes of the weights that only training uses; the files of an agent do not contain them.
CRITIC_PREFIXES = ("critic", "value_net", "mlp_extractor.value_net")
RELATIVE_TOLERANCE = 1e-9  # parameters that differ by less are equal: files hold them as decimal numbers


def policy_keywords(policy: Mapping[str, Any], features: Mapping[str, Any]) -> dict[str, Any]:
    """Build `policy_kwargs` of a stable-baselines3 algorithm, with `LogScaleFeatures` as the input layer.

    Args:
        policy: Keyword arguments of the policy class, for example layer sizes: the table [policy] of a
            recipe.
        features: Keyword arguments of `LogScaleFeatures`: kinematics of the machine and gains of controllers.
    """
    import_optional("stable_baselines3")
    from .sb3_adapters import LogScaleFeatures

    return {
        **policy,
        "features_extractor_class": LogScaleFeatures,
        "features_extractor_kwargs": dict(features),
    }


def policy_class(kind: str, actuation: Mapping[str, Any]) -> Any:
    """Return the class of the policy that an algorithm needs for dict observations.

    "apg" uses the policy of PPO, "sac" uses `LawPolicy` where the observation has the parts of the action
    (`parts` in `actuation`).

    Args:
        kind: Algorithm, one of `ALGORITHMS` of recipe.py, such as "ppo".
        actuation: Keyword arguments of `ResidualAction`: the table [actuation] of a recipe.
    """
    if kind == "crossq":
        # CrossQ has no policy for dicts. This one accepts them, because its first layer is
        # `LogScaleFeatures`.
        return import_optional("sb3_contrib.crossq").MlpPolicy
    if kind == "sac" and actuation.get("parts"):
        import_optional("stable_baselines3")
        from .law_policy import LawPolicy

        return LawPolicy
    module = {"sac": "stable_baselines3.sac", "tqc": "sb3_contrib.tqc"}.get(kind, "stable_baselines3.ppo")
    return import_optional(module).MultiInputPolicy


class Agent(Controller):
    """Controller of environments that applies the mean action of a trained policy, without exploration.

    Args:
        policy: Policy of stable-baselines3.
        mapping: Converts outputs of the policy to actions; None if the outputs are the actions.
        card: Contents of agent.json (`AGENT_KEYS`: recipe, task, control period, ...); further entries are
            not saved.
        conversion: Conversion of the policy's actions, if it was trained on another machine. Default: none.

    Raises:
        InputError: If the control period in the card is not positive.
    """

    feedback = "observation"

    def __init__(
        self,
        policy: Any,
        mapping: ResidualAction | None,
        machine: Machine,
        card: Mapping[str, Any],
        conversion: ActionConversion | None = None,
    ) -> None:
        super().__init__(machine, card["period"])
        self._conversion = conversion
        self.policy = policy
        self.mapping = mapping
        self.card = dict(card)
        self._sensors = self.card.get("settings", {}).get("env", {}).get("sensors", "state")

    @override
    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Compute the actions of the policy without exploration.

        Raises:
            InputError: If the observation has no preview of the goal that the policy needs, or one that it
                does not know, entries of another shape, or other units than SI.
        """
        self._check_units(observation)
        previews = "preview" in self.policy.observation_space.spaces
        if previews != ("preview" in observation):
            raise InputError(
                f"agent {self.card['name']}: was trained {'with' if previews else 'without'} a preview "
                f"of the goal, for the task {self.card['task']}; run it on the task {self.card['task']}"
            )
        for key, space in self.policy.observation_space.spaces.items():
            if key in observation and observation[key].shape[1:] != space.shape:
                raise InputError(
                    f"agent {self.card['name']}: {key} has shape {observation[key].shape}, "
                    f"but the agent was trained on (batch, {space.shape[0]}); "
                    "evaluate it with the machine and the sensors of its training"
                )
        policy_input = self.mapping.augment(observation) if self.mapping else observation
        policy_input = {key: policy_input[key] for key in self.policy.observation_space.spaces}
        with single_threaded_torch():
            outputs, _ = self.policy.predict(policy_input, deterministic=True)
        if self.mapping:
            return self.mapping.action(outputs)
        actions = np.asarray(outputs, np.float64)
        return self._conversion.to_machine(actions) if self._conversion else actions

    @cached_property
    def _check_units(self) -> UnitCheck:
        """Check of the units of observations, made when it is needed."""
        return UnitCheck(self.machine, self._sensors == "state")

    @override
    def replace_last_action(self, actions: Actions) -> None:
        """Replace the last actions in the policy's next observation, if it observes them."""
        if self.mapping:
            self.mapping.replace_last_action(actions)

    @override
    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        if self.mapping:
            self.mapping.reset(mask)

    def structural_mismatch(self, machine: Machine) -> str | None:
        """Return why the agent cannot run on a machine, as a clause such as "was trained on ...", or None."""
        return structural_mismatch(self.machine, machine)

    def mismatch(self, machine: Machine, period: float, sensors: SensorsLike = "state") -> str | None:
        """Return a warning if an evaluation differs from the training in machine, control period or sensors.

        It is None if nothing differs.

        Args:
            period: Control period of the evaluation, s.
            sensors: What the agent observes in the evaluation: "state", or a sensor suite or its name.
        """
        differences = []
        if machine.name != self.machine.name:
            differences.append(f"trained on machine {self.machine.name!r}, evaluated on {machine.name!r}")
        elif not same_parameters(machine, self.machine):
            differences.append(f"trained on a machine {machine.name!r} with other parameters")
        if not np.isclose(period, self.period):
            differences.append(
                f"trained with a control period of {self.period:g} s, evaluated at {period:g} s"
            )
        trained = self.card["settings"].get("env", {}).get("sensors", "state")
        if sensors != trained:
            observed = sensors if isinstance(sensors, str) else "a sensor suite"
            differences.append(f"trained with sensors {trained!r}, evaluated with {observed!r}")
        if not differences:
            return None
        return f"agent {self.card['name']}: {'; '.join(differences)}. Its scores may be poor."

    def weights(self) -> dict[str, Any]:
        """Copy the weights that an agent needs to run; the critics, needed for training, are left out.

        Returns:
            Tensors of torch by their names in the policy's `state_dict`.
        """
        state = self.policy.state_dict()
        return {name: v.detach().clone() for name, v in state.items() if not name.startswith(CRITIC_PREFIXES)}

    def save(self, folder: str | Path, weights: Mapping[str, Any] | None = None) -> None:
        """Write the agent to a folder, from which `load` reads it.

        The files are policy.safetensors (weights), agent.json (how to build the policy) and machine.json
        (machine of the training). They are replaced together when all three are complete.

        Args:
            folder: Folder for the files; created if it does not exist.
            weights: Weights as `weights()` returned them. Default: the present ones.

        Raises:
            InputError: If the voltages of the policy are converted to another machine than that of its
                training, which the files hold.
        """
        if self._conversion:
            raise InputError(
                f"agent {self.card['name']}: was loaded for another machine than that of its training; copy "
                "its folder, and name the machine when you load the copy"
            )
        safetensors = import_optional("safetensors.torch")
        tensors = {name: value.contiguous() for name, value in (weights or self.weights()).items()}
        contents = {key: self.card[key] for key in AGENT_KEYS}
        with output_batch(folder):
            with atomic_file(Path(folder) / "policy.safetensors") as file:
                file.write(safetensors.save(tensors))
            save_machine(self.machine, Path(folder) / "machine.json")
            write_text(Path(folder) / "agent.json", json.dumps(contents, indent=1) + "\n")

    @classmethod
    def load(cls, folder: str | Path, machine: Machine | None = None) -> Agent:
        """Load an agent, ready to run, from a folder that `save` or the command `hframe train` wrote.

        Args:
            machine: Machine for which the agent's feedback laws, base controller, estimator of parameters and
                features are designed, such as an identified one; the weights stay as they are, and the
                voltages of a policy without a base controller are converted (`ActionConversion`). Default:
                that of the training.

        Raises:
            InputError: If a file is missing, damaged or of another version, or the machine has other numbers
                of axes, observed coordinates or drives than that of the training, has no `MotionModel`, or
                lacks a transfer of the agent.
        """
        path = Path(folder)
        complete_commit(path)
        card = read_agent_json(path)
        trained_on = load_machine(path / "machine.json")
        expected = feature_parameters(trained_on)
        if any(_shape(card["features"][key]) != _shape(expected[key]) for key in ("radii", "rest")):
            raise InputError(f"{path / 'agent.json'}: features do not fit the machine in machine.json")
        conversion = None
        if machine is None:
            machine = trained_on
        else:
            obstacle = structural_mismatch(trained_on, machine)
            if obstacle:
                raise InputError(f"{path}: the agent {obstacle}")
            features = feature_parameters(machine, card["period"], **card["settings"].get("features", {}))
            conversion = _conversion(trained_on, machine, card["settings"]["actuation"])
            if conversion and "gains" in features:
                features["gains"] = conversion.gains(features["gains"])
            card = {**card, "machine": machine.name, "features": features}
        mapping = residual_action(machine, card["settings"]["actuation"], card["period"], conversion)
        space = observation_space(machine, card["previews"])
        exploration = (
            {"use_sde": True} if card["settings"].get("algorithm", {}).get("use_sde") is True else {}
        )
        policy = policy_class(card["kind"], card["settings"]["actuation"])(
            mapping.observation_space(space) if mapping else space,
            mapping.action_space() if mapping else action_space(machine),
            lambda _: 0.0,  # learning rate, which only training uses
            **exploration,
            **policy_keywords(card["settings"]["policy"], card["features"]),
            optimizer_class=_no_optimizer,
        )
        load_weights(policy, path)
        policy.set_training_mode(False)
        return cls(policy, mapping, machine, card, conversion)


def _conversion(
    trained_on: Machine, machine: Machine, actuation: Mapping[str, Any]
) -> ActionConversion | None:
    """Return the conversion of a policy's actions to those of another machine, or None where it has none.

    A policy that corrects a base controller needs none: near the goal, where gains decide whether the tool
    oscillates, the feedback is that of the base, which is designed for the machine, and the correction has an
    authority of a few percent of the rated voltage.
    """
    takes_voltages = not machine.drive_laws
    if actuation.get("base") or not takes_voltages or same_parameters(machine, trained_on):
        return None
    return ActionConversion(trained_on, machine)


def _no_optimizer(*_: Any, **__: Any) -> None:
    """Return None in place of an optimizer: only training uses one, and importing PyTorch's is slow."""


def load_weights(policy: Any, folder: Path) -> None:
    """Replace the weights of a policy, which is modified, by those in policy.safetensors of a folder.

    The weights of the critics, which estimate returns in training, are not in the file and stay unchanged.

    Raises:
        InputError: If the file is missing or damaged, lacks weights of the policy, or has weights that the
            policy lacks or that are not finite.
    """
    safetensors = import_optional("safetensors.torch")
    file = folder / "policy.safetensors"
    try:
        weights = safetensors.load_file(file)
    except (import_optional("safetensors").SafetensorError, OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as weights: {' '.join(str(error).split())}") from error
    try:
        missing, unexpected = policy.load_state_dict(weights, strict=False)
    except RuntimeError:  # its message lists the shapes of all layers
        raise InputError(f"{file}: does not fit the policy that agent.json describes") from None
    if not all(bool(values.isfinite().all()) for values in weights.values()):
        raise InputError(f"{file}: has weights that are not finite")
    misfits = [*unexpected, *(name for name in missing if not name.startswith(CRITIC_PREFIXES))]
    if misfits:
        raise InputError(f"{file}: does not fit the policy, see {', '.join(sorted(misfits))}")


def _shape(values: list[Any]) -> list[int]:
    """Return the length of a list and those of the lists in it."""
    return [len(values), *(len(row) for row in values if isinstance(row, list))]


def structural_mismatch(trained_on: Machine, machine: Machine) -> str | None:
    """Return why an agent trained on one machine cannot run on another, or None if it can.

    Only the numbers of axes, observed coordinates and drives matter.

    Returns:
        Clause such as "was trained on a machine with 2 drives, but 'axis' has 1 drive".
    """
    counts, trained = _part_counts(machine), _part_counts(trained_on)
    differing = [part for part in counts if counts[part] != trained[part]]
    if not differing:
        return None
    present, former = (", ".join(_counted(c[part], part) for part in differing) for c in (counts, trained))
    return f"was trained on a machine with {former}, but {machine.name!r} has {present}"


def _part_counts(machine: Machine) -> dict[str, int]:
    """Return the numbers of parts that determine the shapes of observations and actions."""
    observed = len(observed_coordinates(machine))
    return {"axis": len(machine.tool_axes), "observed coordinate": observed, "drive": len(machine.drives)}


def _counted(count: int, noun: str) -> str:
    """Return a number with its noun, for example "2 axes"."""
    return f"{count} {noun}" if count == 1 else f"{count} {'axes' if noun == 'axis' else noun + 's'}"


def same_parameters(machine: Machine, other: Machine) -> bool:
    """Return whether two machines have the same parameters in the same order, equal but for rounding."""
    if list(machine.parameters) != list(other.parameters):
        return False
    values, other_values = (list(m.parameters.values()) for m in (machine, other))
    return bool(np.allclose(values, other_values, rtol=RELATIVE_TOLERANCE, atol=0.0))
