"""Map a function over inputs in this process, in local processes, or on a Ray cluster, with the same results.

A task is one call of the function, on one core. If its worker process ends unexpectedly (killed, out of memory, a lost
node), another one repeats the task from the beginning. The calling program receives every result exactly once and
writes all files; workers write no common files.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import InputError
from .files import atomic_file, output_batch, scratch_folder

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

LOCAL_RAY = "local"  # address that starts Ray on this machine
ATTEMPTS = 3  # of a task whose worker dies
# One thread per worker, so that workers do not compete for cores. The results do not depend on the number of threads.
_ONE_THREAD = dict.fromkeys(
    ("HFRAME_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
_CONNECTION_TIMEOUT_S = 5.0
_HEALTH_TIMEOUT_S = 20.0  # the check itself starts a Python process, which takes seconds on a busy machine

Item = TypeVar("Item")
Result = TypeVar("Result")
_Run = Callable[..., Any]


def map_tasks(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    jobs: int = 1,
    ray: str | None = None,
    completed: Callable[[int, Result], None] | None = None,
) -> Iterator[Result]:
    """Call a function for every input, possibly in parallel, and yield the results in the order of the inputs.

    If the worker process of a task ends unexpectedly, the task starts again, up to three attempts in total. The
    function must depend on its input alone and write no files, so that a repetition gives the same result.

    Args:
        function: Function of one input. For jobs > 1 or with `ray` it must be picklable: a function of a module, for
            example, or a `functools.partial` of one.
        items: Inputs of the function, one per call; for jobs > 1 or with `ray` they must be picklable, too.
        jobs: Number of local worker processes; with 1, the function runs in this process. With ray="local": number of
            cores that Ray uses, where 1 means all. Ignored for a Ray cluster.
        ray: None for local processes; "local" to start Ray on this machine; "auto" for the running cluster that
            this machine belongs to; or "HOST:PORT" of a cluster's head node.
        completed: Called with the index of an input and its result as soon as the result is available, for example to
            write it to a file. The calls come in any order, one at a time.

    Yields:
        Result of each input, in the order of the inputs.

    Raises:
        InputError: If the cluster cannot be reached, a worker has another version of this package, or the worker of a
            task ended in all attempts.
        ImportError: If Ray is requested and not installed; the message says how to install it.
        Exception: Any exception that the function raises. Other running tasks are then stopped.
    """
    if not items:
        return
    if ray is None and jobs < 2:
        for index, item in enumerate(items):
            result = function(item)
            if completed is not None:
                completed(index, result)
            yield result
        return
    backend = _local_processes(min(jobs, len(items))) if ray is None else _ray_workers(ray, jobs)
    with backend as submit:
        order = {submit(function, item): index for index, item in enumerate(items)}
        results: dict[int, Result] = {}
        for future in as_completed(list(order)):
            index = order.pop(future)
            results[index] = _result(future, index)
            if completed is not None:
                completed(index, results[index])
            while (following := len(items) - len(order) - len(results)) in results:
                yield results.pop(following)


def files_of(write: Callable[[Path], Result]) -> tuple[Result, dict[str, bytes]]:
    """Run a function that writes files to an empty folder; return its result, and the files by relative path.

    A worker process, which must not write to the folders of its caller, returns its files in this way; the calling
    process writes them with `write_files`.
    """
    with scratch_folder() as scratch:
        folder = scratch / "files"  # the scratch folder itself is locked
        folder.mkdir()
        result = write(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        return result, {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def write_files(folder: str | Path, files: Mapping[str, bytes]) -> None:
    """Write files, by relative path, to a folder; they appear together, or none of them.

    Raises:
        InputError: If another process writes to the folder.
        OSError: If the folder cannot be written, or the disk is full.
    """
    with output_batch(folder):
        for name, content in files.items():
            with atomic_file(Path(folder) / name) as file:
                file.write(content)


def _result(future: Future[Result], index: int) -> Result:
    """Return the result of a task; raise its exception as the function raised it."""
    try:
        return future.result()
    except Exception as error:
        if type(error).__module__.startswith("ray.") or isinstance(error, BrokenProcessPool):
            cause = getattr(error, "cause", None)  # of an exception in the function
            if isinstance(cause, BaseException):
                raise cause from None
            raise InputError(
                f"task {index + 1} ended {ATTEMPTS} worker processes, perhaps for lack of memory: give it a machine "
                f"with more memory, or run fewer tasks at a time ({type(error).__name__})"
            ) from error
        raise


@contextmanager
def single_threaded_linear_algebra() -> Iterator[None]:
    """Limit the linear algebra libraries of NumPy and SciPy to one thread, as a context or a decorator.

    More threads change the order of sums, and with it the last bits of results.
    """
    with _linear_algebra_threads().limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _linear_algebra_threads() -> ThreadpoolController:
    """Return the control of the threads; finding the libraries, which must be loaded before, takes milliseconds."""
    import scipy.linalg  # noqa: F401  # has a library of its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _run_task(
    function: Callable[[Item], Result], item: Item, version: str, settings: Mapping[str, str]
) -> Result:
    """Run a task in a worker, with one thread and the settings of the calling program."""
    from threadpoolctl import threadpool_limits

    if version != _version():
        raise InputError(
            f"a worker has hframe_gym {_version()}, this program {version}: install the same version on all machines"
        )
    os.environ.update(settings)
    with threadpool_limits(1):  # libraries that are loaded later read the variables
        return function(item)


def _version() -> str:
    """Return the version of this package."""
    return str(import_module(__name__.partition(".")[0]).__version__)


def _task_settings() -> dict[str, str]:
    """Return the environment variables of a worker: those of this package as they are here, and one thread."""
    return {k: v for k, v in os.environ.items() if k.startswith("HFRAME_")} | _ONE_THREAD


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
                return pool.submit(_run_task, *task).result()
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
def _local_processes(count: int) -> Iterator[_Run]:
    """Provide a function that submits a task to local processes."""
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

    settings = _task_settings()
    threads = ThreadPoolExecutor(count)
    try:
        yield lambda function, item: threads.submit(run, function, item, _version(), settings)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.stop()
        threads.shutdown()


@contextmanager
def _ray_workers(address: str, cores: int) -> Iterator[_Run]:
    """Provide a function that submits a task to Ray."""
    # Ray then sends no usage statistics, and prints the workers' lines as they are.
    for variable in ("RAY_USAGE_STATS_ENABLED", "RAY_DEDUP_LOGS", "RAY_COLOR_PREFIX"):
        os.environ.setdefault(variable, "0")
    try:
        import ray
    except ImportError as error:
        raise ImportError("--ray needs Ray: pip install 'hframe_gym[ray]'") from error
    connected = not ray.is_initialized()
    if connected:
        _connect(ray, address, cores)
    remote: Any = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_run_task)
    settings = _task_settings()
    try:
        yield lambda function, item: remote.remote(function, item, _version(), settings).future()
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
