"""Run the `hframe` command with `python -m hframe_gym`."""

from .cli import main

main()
