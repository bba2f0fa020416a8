"""Names of entries: those of the repository, and what a name on the command line means.

A class of your own is named `package.module:Class`.

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
| `ppo_mix-trained`, `sac_mix-trained`, ... | identified | trained on the corrected machine |

The weights of an agent NAME are those of seed 0; `NAME-seed1-corrected` and the like are those of other
seeds, which `hframe train` trains first where the package does not ship them
(`benchmarks.agent_seeds.agent_folder`).
"""

from __future__ import annotations

import importlib

from benchmarks.gap.entries import (
    MODELS,
    DeclaredMachine,
    DesignedEntry,
    DriftingEncoders,
    GapEntry,
    IdentifiedMachine,
    OnlineMachine,
    RegisteredController,
    SeededAgent,
    TrainedAgent,
)
from benchmarks.gap.learned_residual import LearnedResidual
from benchmarks.gap.saved_policies import SavedPolicies, read_name
from hframe_gym.controllers import CONTROLLERS
from hframe_gym.errors import InputError

HISTORY = "history"  # the entry of `history_policy`
MACHINES: dict[str, type[DesignedEntry]] = {
    "drift": DriftingEncoders,
    "learned": LearnedResidual,
    **dict.fromkeys(MODELS, IdentifiedMachine),
    "online": OnlineMachine,
}
VARIANTS = tuple(MACHINES)
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
    "apg_mix": {"reach": ("adapt_mix", "apg_mix"), "track": ("apg_wide", "apg_wide")},
    "ppo_mix": {"reach": ("ppo_mix", "ppo_mix"), "track": ("residual", "residual")},
    "residual": {"reach": ("residual", "residual"), "track": ("residual", "residual")},
    "sac_mix": {"reach": ("sac_mix", "sac_mix"), "track": ("sac", "sac")},
}


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
    machine = MACHINES.get(variant, DeclaredMachine)
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
        from benchmarks.gap.history_policy import HistoryPolicy  # needs the extra `agents`

        return _made(f"{HISTORY}-seed{seed or 0}", HistoryPolicy, seed=int(seed or 0))
    if saved := read_name(name):
        return _made(saved.label, SavedPolicies, paths=saved.paths, measured=saved.measured)
    raise InputError(
        f"entry {name!r} is unknown; choose one of {', '.join(entry_names())}, "
        "REACH+TRACK of two saved policies, or package.module:Class"
    )


def _made(name: str, *bases: type[GapEntry], **attributes: object) -> type[GapEntry]:
    """Return a class of an entry with its name and settings."""
    fixed = {"name": name, "generated": True, "__module__": __name__}
    return type(bases[0].__name__, bases, {**fixed, **attributes})
