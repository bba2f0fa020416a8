"""Worker processes of this machine."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from queue import SimpleQueue
from typing import Any

from ..version import __version__
from .worker import ATTEMPTS, run_task, task_settings


class _LocalWorker:
    """Process of this machine that runs one task at a time and is replaced if it dies."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._process: int | None = None  # its number
        self._stopped = False

    def run(self, *task: Any) -> Any:
        """Run a task; repeat it if the process dies."""
        for attempt in range(1, ATTEMPTS + 1):
            try:
                pool = self._pool or self._start()
                return pool.submit(run_task, *task).result()
            except BrokenProcessPool:
                self._pool = self._process = None
                if self._stopped or attempt == ATTEMPTS:
                    raise
        return None

    def stop(self) -> None:
        """End the process, also during a task."""
        self._stopped = True
        for process in active_children():
            if process.pid == self._process:
                process.kill()

    def _start(self) -> ProcessPoolExecutor:
        """Start the process."""
        self._pool = ProcessPoolExecutor(1, get_context("spawn"), _end_with_parent)
        self._process = self._pool.submit(os.getpid).result()
        if self._stopped:  # in the meantime
            self.stop()
        return self._pool


def _end_with_parent() -> None:
    """Let this worker end when the process that started it has ended, however that ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent ends this one
    parent = parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def local_processes(count: int) -> Iterator[Callable[..., Any]]:
    """Provide `count` worker processes of this machine in the `with` block.

    A process starts with its first task. A task whose process dies is repeated by a new one, up to
    `ATTEMPTS` times in all. At the end of the block all processes are killed, also during a task, and tasks
    that have not begun are canceled.

    Yields:
        Function (function, item) that submits the call function(item), both picklable, and returns its
        `concurrent.futures.Future` at once.
    """
    workers = [_LocalWorker() for _ in range(count)]
    idle: SimpleQueue[_LocalWorker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def run(*task: Any) -> Any:
        worker = idle.get()
        try:
            return worker.run(*task)
        finally:
            idle.put(worker)

    settings = task_settings()
    threads = ThreadPoolExecutor(count)
    try:
        yield lambda function, item: threads.submit(run, function, item, __version__, settings)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.stop()
        threads.shutdown()
