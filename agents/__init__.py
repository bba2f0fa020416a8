"""Learned controllers: training, recipes as data, and agents in a format whose loading runs no code.

Needs the extra `agents` (stable-baselines3, torch, safetensors); importing this package does not.
"""

from .training import train

__all__ = [
    "train",
]
