"""Python imports this module at its start if this folder is on PYTHONPATH."""

from hide_posix import install

install()
