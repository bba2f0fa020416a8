"""Map a function over inputs in this process, in local processes, or on a Ray cluster, with the same results.

A task is one call of the function, on one core. If its worker process ends unexpectedly (killed, out of
memory, a lost node), another one repeats the task from the beginning. The calling program receives every
result exactly once and writes all files; workers write no common files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool

from ..errors import InputError
from .local_processes import local_processes
from .ray_cluster import ray_workers
from .worker import ATTEMPTS, Item, Result


def map_tasks(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    jobs: int = 1,
    ray: str | None = None,
    completed: Callable[[int, Result], None] | None = None,
) -> Iterator[Result]:
    """Call a function for each input, possibly in parallel, and yield the results in the order of the inputs.

    If the worker process of a task ends unexpectedly, the task starts again, up to three attempts in total.
    The function must depend on its input alone and write no files, so that a repetition gives the same
    result.

    Args:
        function: Function of one input. For jobs > 1 or with `ray` it must be picklable: a function of a
            module, for example, or a `functools.partial` of one.
        items: Inputs of the function, one per call; for jobs > 1 or with `ray` they must be picklable, too.
        jobs: Number of local worker processes; with 1, the function runs in this process. With ray="local":
            number of cores that Ray uses, where 1 means all. Ignored for a Ray cluster.
        ray: None for local processes; "local" to start Ray on this machine; "auto" for the running cluster
            that this machine belongs to; or "HOST:PORT" of a cluster's head node.
        completed: Called with the index of an input and its result as soon as the result is available, for
            example to write it to a file. The calls come in any order, one at a time.

    Yields:
        Result of each input, in the order of the inputs.

    Raises:
        InputError: If the cluster cannot be reached, a worker has another version of this package, or the
            worker of a task ended in all attempts.
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
    backend = local_processes(min(jobs, len(items))) if ray is None else ray_workers(ray, jobs)
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
                f"task {index + 1} ended {ATTEMPTS} worker processes, perhaps for lack of memory: "
                f"give it a machine with more memory, or run fewer tasks at a time ({type(error).__name__})"
            ) from error
        raise
