"""Help texts of options, where placeholders such as {tasks} stand for registered names, also of plugins."""

from __future__ import annotations

from collections.abc import Iterable

from .registry import load_plugins


def with_choices(text: str) -> str:
    """Return a help text with the registered names in place of placeholders such as {tasks}.

    `registered_choices` lists the placeholders; another one raises a KeyError. A text without braces is
    returned unchanged.
    """
    return text.format(**registered_choices()) if "{" in text else text


def registered_choices() -> dict[str, str]:
    """Return the names that options accept, by their placeholder in help texts: {"tasks": "reach, track"}.

    Plugins are imported first. The placeholders are agents, algorithms, controllers, protocols,
    randomizations, sensors, sensor_kinds and tasks.
    """
    from .agents import recipe_names, shipped_agent_names
    from .controllers import CONTROLLERS
    from .envs import RANDOMIZATION_PRESETS, SENSOR_PRESETS, TASKS
    from .evaluation import PROTOCOLS
    from .machine import SENSOR_KINDS

    load_plugins()
    algorithms = sorted({name.rpartition("_")[0] for name in recipe_names()})
    choices: dict[str, Iterable[str]] = {
        "agents": shipped_agent_names(),
        "algorithms": algorithms,
        "controllers": CONTROLLERS,
        "protocols": PROTOCOLS,
        "randomizations": RANDOMIZATION_PRESETS,
        "sensors": SENSOR_PRESETS,
        "sensor_kinds": SENSOR_KINDS,
        "tasks": TASKS,
    }
    return {placeholder: ", ".join(names) for placeholder, names in choices.items()}
