"""The functions of `symbolic.elementwise` under the name by which effects, also users', import them."""

from .symbolic.elementwise import *  # noqa: F403 - its __all__ is the list
