"""Read the files of agents and of training runs as data, before anything is built from them.

agent.json says how to build the policy of an agent. card.json says how the agent was trained, and how well it
performs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from ..errors import InputError
from ..files import complete_commit, read_json
from ..operating_system import quoted

SCHEMA = 2  # version of the formats of agent.json and card.json
AGENT_FILES = ("agent.json", "machine.json", "policy.safetensors")
# The last one exists for SAC, TQC and CrossQ only.
RESUME_FILES = ("card.json", "checkpoint.zip", "environment.pkl", "replay.pkl")

Positive = Annotated[FiniteFloat, Field(gt=0.0)]
Fraction = Annotated[FiniteFloat, Field(ge=0.0, le=1.0)]
Layers = Annotated[list[Annotated[int, Field(ge=1, le=4096)]], Field(max_length=8)]


class _Table(BaseModel):
    """Base of the tables of agent.json: unknown entries and implicit type conversions are errors."""

    model_config = ConfigDict(extra="forbid", strict=True)


class _Policy(_Table):
    """Keyword arguments of the policy class."""

    net_arch: Layers | dict[Literal["pi", "vf", "qf"], Layers] = [64, 64]
    log_std_init: Annotated[FiniteFloat, Field(ge=-20.0, le=5.0)] = 0.0
    n_critics: Annotated[int, Field(ge=1, le=16)] = 2
    n_quantiles: Annotated[int, Field(ge=1, le=1000)] = 25
    batch_norm_momentum: Fraction = 0.01
    renorm_warmup_steps: Annotated[int, Field(ge=0)] = 100_000
    ortho_init: bool = True
    use_expln: bool = False


class _Actuation(_Table):
    """Keyword arguments of `ResidualAction`."""

    base: str | None = None
    least: Fraction = 1.0
    most: Fraction = 1.0
    full_at_m: Positive = 5e-3
    full_at_m_s: Positive = 0.2
    estimates: bool = False
    integral: bool = False
    transfers: Annotated[list[Annotated[int, Field(ge=0, le=1000)]], Field(max_length=100)] = []
    plans: Annotated[list[Annotated[int, Field(ge=1, le=1000)]], Field(max_length=100)] = []
    parts: bool = False
    hold_m: Annotated[FiniteFloat, Field(ge=0.0, le=1e3)] = 0.0
    hold_m_s: Positive = 0.015


class _Settings(_Table):
    """Recipe of the training; only the parts that are used after it are checked."""

    model_config = ConfigDict(extra="ignore", strict=True)

    policy: _Policy
    actuation: _Actuation
    env: dict[str, Any] = {}


class _Features(_Table):
    """Keyword arguments of `LogScaleFeatures`."""

    radii: Annotated[list[FiniteFloat], Field(max_length=100)]
    rest: Annotated[list[Annotated[list[FiniteFloat], Field(max_length=100)]], Field(max_length=100)]
    gains: dict[
        str, Annotated[list[Annotated[list[FiniteFloat], Field(max_length=1000)]], Field(max_length=1000)]
    ] = {}
    meters: Annotated[FiniteFloat, Field(gt=0.0, le=1.0)] = 1.0


class _AgentJson(_Table):
    """Content of agent.json."""

    model_config = ConfigDict(extra="ignore", strict=True)

    schema_: int = Field(alias="schema")
    name: Annotated[str, Field(max_length=200)]
    task: Annotated[str, Field(max_length=200)]
    kind: Literal["ppo", "sac", "tqc", "crossq", "apg"]
    machine: Annotated[str, Field(max_length=1000)]
    seed: int
    recipe: Annotated[str, Field(max_length=200)]
    settings: _Settings
    period: Positive
    features: _Features
    previews: Annotated[int, Field(ge=0, le=1000)]


def read_agent_json(folder: Path) -> dict[str, Any]:
    """Read agent.json, which states how to build an agent's policy, and check all values.

    Returns:
        Content of the file, with the entries `AGENT_KEYS`.

    Raises:
        InputError: If one of the `AGENT_FILES` is missing, or agent.json is damaged, of another version,
            lacks an entry or has a value of the wrong type or out of range.
    """
    for name in AGENT_FILES:
        if not (folder / name).is_file():
            raise InputError(f"{folder} is not an agent: {name} is missing")
    file = folder / "agent.json"
    content = read_json(file)
    version = content.get("schema") if isinstance(content, dict) else None
    if version != SCHEMA or isinstance(version, bool):
        raise InputError(f"{file}: schema is {repr(version)[:40]}, this version reads {SCHEMA}")
    try:
        _AgentJson.model_validate(content)
    except ValidationError as error:
        missing = [".".join(map(str, e["loc"])) for e in error.errors() if e["type"] == "missing"]
        if missing:
            raise InputError(f"{file}: entries are missing: {', '.join(missing)}") from None
        first = error.errors()[0]
        raise InputError(f"{file}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    return dict(content)


def refuse_to_replace(folder: Path, recipe: str, task: str, machine: str, seed: int, alone: bool) -> None:
    """Raise an error if a folder holds an agent or a run's checkpoint, which new files would replace.

    Args:
        folder: Folder for the files of a training run; it need not exist.
        recipe: Name of the recipe of this run, such as "ppo_reach".
        task: Name of its task.
        machine: Name of its machine.
        seed: Its seed.
        alone: Whether the command trains this seed only. Only then does it accept --resume, which the message
            proposes.

    Raises:
        InputError: If the folder holds such files. The message says what they are and how to replace the run
            in the folder or to continue it, which is possible if that run has a checkpoint and the same
            settings.
    """
    complete_commit(folder)
    # A user may have written machine.json.
    files = [name for name in (*AGENT_FILES, *RESUME_FILES) if name != "machine.json"]
    present = [name for name in files if (folder / name).exists()]
    if not present:
        return
    resumable = all((folder / name).is_file() for name in (*AGENT_FILES, *RESUME_FILES[:3]))
    try:
        card = read_json(folder / "card.json")
        steps = f", {card['curve'][-1]['steps']} steps" if card["curve"] else ""
        described = f"the agent {card['name']} of machine {card['machine']!r}, seed {card['seed']}{steps}"
        resumable = resumable and [card[k] for k in ("recipe", "task", "machine", "seed")] == [
            recipe,
            task,
            machine,
            seed,
        ]
    except (InputError, OSError, KeyError, TypeError, IndexError):  # damaged, or of another version
        described, resumable = ", ".join(present), False
    advice = ["choose another folder"]
    if resumable:
        command = (
            f"hframe train {recipe.rpartition('_')[0]} --seed {seed} --resume --out {quoted(str(folder))}"
        )
        by = "with --resume" if alone else f"alone with `{command}` (other options as before, without --ray)"
        advice.append(f"continue the run {by}")
    raise InputError(
        f"{folder}: holds {described}, which training would replace; "
        f"{', '.join(advice)}, or replace it with --force"
    )


def read_training_card(file: Path) -> dict[str, Any]:
    """Read the settings and results of a training run to resume.

    Args:
        file: File card.json that the run wrote.

    Returns:
        Content of the file; it has at least recipe, task, seed, `kept` (training steps of the saved agent)
        and `curve` (rows of the learning curve).

    Raises:
        InputError: If the file cannot be read or is damaged.
    """
    card = read_json(file)
    try:
        columns = {tuple(row) for row in card["curve"]}
        numbers = [card["kept"], *(value for row in card["curve"] for value in row.values())]
        is_valid = (
            all(isinstance(value, int | float) and abs(value) < 1e15 for value in numbers)
            and len(columns) == 1
        )
        if (
            is_valid
            and {"steps", "seconds", "cpu_s"} <= set(*columns)
            and {"recipe", "task", "seed"} <= set(card)
        ):
            return dict(card)
    except (KeyError, TypeError, IndexError, AttributeError):
        pass
    raise InputError(f"nothing to resume: {file} is damaged")
