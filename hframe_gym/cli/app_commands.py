"""Command app: the window on the loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from .application import app
from .output import log


@app.command("app")
def run_app(
    session: Annotated[
        Path, Argument(help="Folder of the session, with its machine, logs and results; created if missing.")
    ] = Path("session"),
    port: Annotated[int, Option(min=0, max=65535, help="Port on the loopback address; 0: any free one.")] = 0,
    no_open: Annotated[bool, Option("--no-open", help="Print the address, and open no browser.")] = False,
) -> None:
    """Open a local page for all steps: machine, logs, check, identify, results, control, export.

    Every step is a command, which the page shows and the session keeps in commands.sh. The page is served on
    this computer only, to whoever has the printed address, and requests nothing from a network. It needs the
    extra `app`.

    Example:  hframe app my_session
    """
    from ..app.server import serve

    serve(session, port, open_browser=not no_open, log=log)
