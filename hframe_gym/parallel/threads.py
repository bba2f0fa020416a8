"""One thread for the linear algebra of NumPy and SciPy, so that results are the same to the last bit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


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
