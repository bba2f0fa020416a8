"""The functions of `symbolic.elementwise`, under a shorter name from which effects import them."""

from .symbolic.elementwise import *  # noqa: F403 - its __all__ is the list
