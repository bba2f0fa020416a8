"""Elementary functions with which effects state their formulas; `symbolic.elementwise` defines them."""

from .symbolic.elementwise import *  # noqa: F403
