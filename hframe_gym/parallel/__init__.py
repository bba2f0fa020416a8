"""Tasks in parallel, on this machine or on a cluster of Ray, with the same results as one after the other."""

from .ray_cluster import LOCAL_RAY
from .tasks import map_tasks
from .threads import single_threaded_linear_algebra

__all__ = ["LOCAL_RAY", "map_tasks", "single_threaded_linear_algebra"]
