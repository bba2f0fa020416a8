"""File formats of logs, one per file of this folder, each registered by its name.

base            interface and registry
tables          columns that share their times, for formats in which each signal has its own
messages        numbers in messages of any structure
ros_messages    messages of ROS by their definitions
matlab_vectors  program that reads the arrays of a MATLAB file in a process of its own

All other modules are formats: each registers one.
"""

from ....registry import import_modules
from .base import LOG_FORMATS, START_BYTES, LogFormat

__all__ = ["LOG_FORMATS", "START_BYTES", "LogFormat"]

import_modules(__name__, __path__, skip=("matlab_vectors",))  # a format in this folder registers itself
