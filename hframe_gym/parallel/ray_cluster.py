"""Workers of Ray: on this machine, or on a cluster."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import InputError, naming_extra
from ..version import __version__
from .worker import ATTEMPTS, run_task, task_settings

LOCAL_RAY = "local"  # address that starts Ray on this machine
_CONNECTION_TIMEOUT_S = 5.0
_HEALTH_TIMEOUT_S = 20.0  # the check itself starts a Python process, which takes seconds on a busy machine


@contextmanager
def ray_workers(address: str, cores: int) -> Iterator[Callable[..., Any]]:
    """Connect to Ray in the `with` block, or use the connection of this process if it has one.

    A connection that this block makes is closed at its end. Ray repeats a task whose worker dies, up to
    `ATTEMPTS` times in all.

    Args:
        address: "local" to start Ray on this machine, "auto" for the cluster of this machine or of the
            environment variable RAY_ADDRESS, or "HOST:PORT" of a cluster's head node.
        cores: Cores that a local Ray uses; 1 means all. Ignored for a cluster.

    Yields:
        Function (function, item) that submits the call function(item), both picklable, and returns its
        `concurrent.futures.Future` at once.

    Raises:
        ImportError: If Ray is not installed.
        InputError: If the cluster cannot be reached.
    """
    # Ray then sends no usage statistics, and prints the workers' lines as they are.
    for variable in ("RAY_USAGE_STATS_ENABLED", "RAY_DEDUP_LOGS", "RAY_COLOR_PREFIX"):
        os.environ.setdefault(variable, "0")
    with naming_extra("ray", "--ray needs Ray"):
        import ray
    connected = not ray.is_initialized()
    if connected:
        _connect(ray, address, cores)
    remote: Any = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(run_task)
    settings = task_settings()
    try:
        yield lambda function, item: remote.remote(function, item, __version__, settings).future()
    finally:
        if connected:
            ray.shutdown()


def _connect(ray: Any, address: str, cores: int) -> None:
    """Connect to a cluster, or start Ray on this machine; within seconds, or with an error of one line."""
    options: dict[str, Any] = {}
    if address == LOCAL_RAY:
        options = {"num_cpus": cores if cores > 1 else None, "include_dashboard": False}
    elif address == "auto":
        address = os.environ.get("RAY_ADDRESS", "auto")
    if address not in (LOCAL_RAY, "auto"):
        _require_head_node(address)
    terminate = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address=address, logging_level="ERROR", **options)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise InputError(f"--ray {address}: {' '.join(str(error).split())}") from error
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, terminate)  # Ray replaces the handler


def _require_head_node(address: str) -> None:
    """Check that a Ray cluster answers at HOST:PORT, which `ray.init` would find out after minutes."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"--ray {address}: must be auto, or HOST:PORT of the head node of a Ray cluster")
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECTION_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise InputError(
            f"--ray {address}: cannot be reached ({error}); start it with: ray start --head"
        ) from error
    check = (sys.executable, "-m", "ray.scripts.scripts", "health-check", "--address", address)
    try:
        healthy = subprocess.run(check, capture_output=True, timeout=_HEALTH_TIMEOUT_S).returncode == 0
    except subprocess.TimeoutExpired:
        healthy = False
    if not healthy:
        raise InputError(f"--ray {address}: no head node of a Ray cluster answers there (ray health-check)")
