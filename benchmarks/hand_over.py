"""Where does `ppo_mix` lose what an exact model gives? `pid` takes over from it at a distance from the goal.

    python -m benchmarks.hand_over [--draws 96]

Moves on the machines of `python -m benchmarks.model_error --machines`, observed exactly. Until the tool comes
within a distance of its goal, `ppo_mix`, seed 0, commands it, from there on `pid`; both have the declared
model, or both that of the machine. At 0 mm all of the move is that of `ppo_mix`. Results go to
results/hand_over.json.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from benchmarks.gap.plants import declared_machine, draw_plant
from benchmarks.gap.results import interval
from benchmarks.model_error import BAND_M, MACHINES, MACHINES_SEED, SEED, controller
from benchmarks.results_file import write_results
from hframe_gym.arrays import Actions, Mask
from hframe_gym.controllers import Controller
from hframe_gym.evaluation import Scenario, rollout, settling_times
from hframe_gym.machine import Machine
from tools.command_line import command_line

NAME = "hand_over"
DISTANCES_MM = (0.0, 5.0, 20.0, 50.0, 1000.0)  # the last one is beyond all goals: `pid` alone
NEAR_M = 5e-3  # distance to the goal from which on the braking is over


class HandOver(Controller):
    """Two controllers, of which the second takes over for good once the tool is near its goal.

    Args:
        first: Controller far from the goal.
        second: Controller from this distance on. Until then it observes what the first one commands.
        distance_m: The distance, m.
    """

    def __init__(self, first: Controller, second: Controller, distance_m: float) -> None:
        super().__init__(second.machine, second.period)
        self._both, self._distance_m = (first, second), distance_m
        self._over = np.zeros(0, np.bool_)

    @override
    def act(self, observation: Mapping[str, NDArray[Any]]) -> Actions:
        goal = observation["desired_goal"]
        distance = np.linalg.norm(goal - observation["observation"][:, : goal.shape[1]], axis=1)
        if len(self._over) != len(distance):
            self._over = np.zeros(len(distance), np.bool_)
        self._over = self._over | (distance < self._distance_m)
        far, near = (one.act(observation) for one in self._both)
        actions = np.clip(np.where(self._over[:, None], near, far), -1.0, 1.0)
        self.replace_last_action(actions)
        return actions

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self._over = np.zeros(0, np.bool_) if mask is None else self._over & ~mask
        for one in self._both:
            one.reset(mask)

    @override
    def replace_last_action(self, actions: Actions) -> None:
        for one in self._both:
            one.replace_last_action(actions)


def times_s(model: Machine, settings: Scenario, distance_mm: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the times until the tool stays within 5 mm and within 0.2 mm, s, each of shape (draws,)."""
    both = HandOver(controller("ppo_mix", model), controller("pid", model), 1e-3 * distance_mm)
    episodes = rollout(both, settings)
    near, settled = (
        settling_times(episodes.goal_error, episodes.time_s, band)[0] for band in (NEAR_M, BAND_M)
    )
    return near, settled


def row(distance_mm: float, draws: int) -> dict[str, Any]:
    """Score a hand-over with the "declared" and the "exact" model.

    Args:
        distance_mm: Distance to the goal at which `pid` takes over, mm.
        draws: Number of moves on each machine.

    Returns:
        By model the mean times until 5 mm and until 0.2 mm, s, each with its 95 % interval over the machines.
    """
    found: dict[str, Any] = {}
    for name in ("declared", "exact"):
        means = []
        for index in MACHINES:
            machine = draw_plant(MACHINES_SEED, index).near_machine
            settings = Scenario(machine, "reach", "none", episodes=draws, seed=SEED + index, drives="rig")
            model = machine if name == "exact" else declared_machine()
            means.append([values.mean() for values in times_s(model, settings, distance_mm)])
        near, settled = np.transpose(means)
        found[name] = {"near_s": interval(near), "settling_s": interval(settled)}
    return found


def main() -> None:
    """Score all distances and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--draws", type=int, default=96)
    draws = parser.parse_args().draws
    rows = []
    for distance_mm in DISTANCES_MM:
        rows.append({"distance_mm": distance_mm, **row(distance_mm, draws)})
        print(rows[-1], flush=True)
    print(write_results(NAME, {"draws": draws, "rows": rows}, seed=SEED))


if __name__ == "__main__":
    main()
