"""What a single environment and a vector of environments have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .environment_batch import EnvironmentBatch
from .observation.spaces import SignalSpec
from .saved_state import FORMAT, batch_state, check_state, restore_batch


class BatchProperties:
    """Properties that a single environment and a vector of environments take from their batch."""

    batch: EnvironmentBatch

    @property
    def entries(self) -> tuple[SignalSpec, ...]:
        """Name, unit and bounds of every entry of the observation array `observation`, in order.

        Each also has `center` and `scale`: with `normalize=True` an observed entry is (value - center) /
        scale. With `flat=True`, the tuple lists the entries of the single observation array.
        """
        return self.batch.format.entries or self.batch.observations.entries

    @property
    def privileged_entries(self) -> tuple[SignalSpec, ...]:
        """Name, unit and bounds of every entry of `privileged`, the observation array for a critic, in order.

        The entries are the true state and then the randomized parameters. Each also has `center` and `scale`:
        with `normalize=True` an observed entry is (value - center) / scale. Empty unless `privileged=True`.
        """
        return self.batch.observations.privileged

    @property
    def compute_reward(self) -> Callable[[Any, Any, Any], Any]:
        """Function (achieved_goal, desired_goal, info) -> reward, such as for hindsight replay.

        The function takes goals as observed (m, rad or normalized), shape (axes,) or (n, axes).
        It returns a float or an array of shape (n,), dimensionless. For the goals that `step` returned, it
        returns exactly the rewards of `step`. Only the reward "progress" uses `info`: it reads the goals
        before the step (`previous_achieved_goal`).

        Raises:
            AttributeError: With `flat=True`, because the observation then has no goals.
        """
        if self.batch.config.flat:
            raise AttributeError(
                "with flat=True there is no compute_reward, because the observation has no goals"
            )
        return self.batch.rewards.compute

    def _shared_state(self, kind: str) -> dict[str, Any]:
        """Return the part of a saved state that single and vector environments have in common."""
        self.batch.require_reset("get_state")
        return {
            "format": FORMAT,
            "kind": kind,
            "fingerprint": self.batch.fingerprint,
            "batch": batch_state(self.batch),
        }

    def _restore_shared(self, state: Any, kind: str) -> None:
        """Check a saved state and restore the part that single and vector environments have in common."""
        check_state(state, kind, self.batch)
        restore_batch(self.batch, state["batch"])
