"""Learned controllers: training by recipe, agents on disk, and the agents that come with the package.

Training and running an agent need the extra `agents` (stable-baselines3, torch, safetensors, tensorboard); an
ImportError names it where it is missing. Importing this package does not need it; this registers trained
agents as controllers for `hframe_gym.evaluation.make_controller`.
"""

from .agent import Agent
from .controller_source import AgentSource, shipped_agent_folder, shipped_agent_names
from .recipe import Recipe, load_recipe, recipe_names
from .sb3_zip import Sb3Model, ZipSource
from .training import train
from .training_seeds import train_seeds

__all__ = [
    "Agent",
    "AgentSource",
    "Recipe",
    "Sb3Model",
    "ZipSource",
    "load_recipe",
    "recipe_names",
    "shipped_agent_folder",
    "shipped_agent_names",
    "train",
    "train_seeds",
]
