"""The type of a function that receives progress messages, one line each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

LineLog: TypeAlias = Callable[[str], object]
"""Function that is called with a line of text about work in progress, without its end, such as `print`."""
