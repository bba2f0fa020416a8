"""The limit of linear algebra to one thread."""

from __future__ import annotations

import numpy as np  # noqa: F401  # the library that is limited
from threadpoolctl import threadpool_info, threadpool_limits

from hframe_gym.parallel import single_threaded_linear_algebra


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_linear_algebra_has_one_thread_until_the_last_one_who_needs_that_ends() -> None:
    """Those who need it may be threads that overlap: the first to begin is not the last to end."""
    with single_threaded_linear_algebra():  # the libraries are known
        pass
    with threadpool_limits(2, user_api="blas"):
        first, second = single_threaded_linear_algebra(), single_threaded_linear_algebra()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads() == {1}
        second.__exit__(None, None, None)
        assert threads() == {2}
