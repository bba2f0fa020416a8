"""One thread for the linear algebra of NumPy and SciPy, so that results are the same to the last bit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from threading import Lock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


class _Limit:
    """Limit of the process to one thread, which lasts as long as one of those who asked for it needs it."""

    def __init__(self) -> None:
        self._lock, self._needed = Lock(), 0
        self._limit: Any = None

    def begin(self) -> None:
        """Limit the libraries unless they are limited."""
        with self._lock:
            self._needed += 1
            if self._needed == 1:
                self._limit = _linear_algebra_threads().limit(limits=1, user_api="blas")

    def end(self) -> None:
        """Let the libraries use as many threads as before, after the last one has ended."""
        with self._lock:
            self._needed -= 1
            if self._needed == 0:
                self._limit.restore_original_limits()


_LIMIT = _Limit()


@contextmanager
def single_threaded_linear_algebra() -> Iterator[None]:
    """Limit the linear algebra libraries of NumPy and SciPy to one thread, as a context or a decorator.

    More threads change the order of sums, and with it the last bits of results. A nested use takes no time.
    """
    _LIMIT.begin()
    try:
        yield
    finally:
        _LIMIT.end()


@lru_cache(maxsize=1)
def _linear_algebra_threads() -> ThreadpoolController:
    """Return the control of the threads of loaded libraries; finding them takes milliseconds."""
    import scipy.linalg  # noqa: F401  # has a library of its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
