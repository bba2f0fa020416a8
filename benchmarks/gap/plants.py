"""Draw the plants: stages of the independent simulator with undeclared parameters, effects and a residue.

A plant follows from a seed and an index alone. Its index modulo 4 is the number of its undeclared effects, so
that every number from zero to three occurs equally often. An effect is one of the library with probability
2/3, otherwise one that the library lacks. Every parameter differs from the declared machine by 5 to 20 %.
Every second plant of each number of effects has a residue: a small error that no single effect is. The
sensors are encoders and noisy lasers; the drives have 12-bit converters and a current limit of 12 A. The
package's simulator takes no part.

Left out are errors of the lasers' scale, skew, straightness and range: they move the goal as it is measured,
so that no controller could reach the true one. `idler_inertia`, which is another machine rather than a
deviation, is left out as well, and so is the drift of the recording's clock, which does not act in control.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.envs.actuation.actuators import ACTUATOR_PRESETS
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.reference_simulator import COORDINATES, Array, Rig, Stage
from tests.reference_simulator.parameter_arrays import parameter_arrays
from tests.reference_simulator.sensors import Sensors
from tests.rigs.hidden_effects import change_site, random_rig
from tests.rigs.outside_effects import FAMILIES, OutsideEffect
from tests.rigs.random_effects import (
    SITES,
    DrawnEffect,
    draw_effect,
    draw_outside,
    library_parameters,
    log_uniform,
)
from tests.rigs.random_rigs import Residue, draw_residue
from tests.rigs.true_machine import base_parameters

PUBLIC_SEED = 47_000  # of the published plants
COUNT = 24
CURRENT_LIMIT_A = 12.0
SMALLEST_SIZE = 0.3  # of an effect of the library; a smaller one is hidden by the errors of the parameters
_LIBRARY = tuple(
    name for name in SITES if name not in ("idler_inertia", "sensor_skew", "sensor_scale", "sensor_range")
)
_OUTSIDE = tuple(family for family in FAMILIES if family not in ("bent scale", "clock drift"))
_RESIDUES = ("missing force", "hysteresis", "colored noise", "clock jitter")
_OUTSIDE_SHARE, _OUTSIDE_DRAWS = 1.0 / 3.0, 4  # `draw_outside` draws one of four families
# The simulator models a belt that goes slack only without these (`parameter_arrays`).
_EXCLUSIVE = (
    frozenset({"belt_play", "belt_damping", "belt_slack", "belt_hardening", "belt relaxation"}),
    frozenset({"position_friction", "friction_slope"}),
    frozenset({"dwell friction", "presliding", "cable with memory"}),
    frozenset({"bridge_yaw", "frame resonance"}),
)
_RTOL, _ATOL = 1e-7, 1e-10  # cost a nanometer per episode

HiddenEffect = DrawnEffect | OutsideEffect


@dataclass(frozen=True)
class GapPlant:
    """Plant of the protocol.

    Attributes:
        seed: Seed of the set of plants.
        index: Number of the plant in the set.
        effects: Effects that the declared machine lacks.
        residue: Small error that is no single effect.
    """

    seed: int
    index: int
    effects: tuple[HiddenEffect, ...]
    residue: Residue

    @property
    def name(self) -> str:
        """Name of the plant."""
        return f"{self.seed}_{self.index:02d}"

    def describe(self) -> str:
        """Return what the plant hides, in a line of text."""
        texts = [e.label if isinstance(e, OutsideEffect) else f"{e.label} {e.size:.0%}" for e in self.effects]
        residue = f"; residue: {self.residue.note}" if self.residue.kind else ""
        return (" + ".join(texts) or "parameters alone") + residue

    @cached_property
    def stage(self) -> tuple[Rig, Sensors]:
        """The stage and its sensors with parameters, effects and residue."""
        rng = np.random.default_rng([self.seed, self.index, 1])
        rig, sensors = random_rig(rng), Sensors()
        strengths = 1.0 + rng.choice([-1.0, 1.0], 3) * rng.uniform(0.05, 0.2, 3)
        rig = dataclasses.replace(rig, belt_EA_N=tuple(float(s) * Rig().belt_EA_N[0] for s in strengths))
        for effect in self.effects:
            rig, sensors = effect.build(rig, sensors)
        limits = tuple(min(limit, CURRENT_LIMIT_A) for limit in rig.current_limit_A)
        rig = dataclasses.replace(rig, current_limit_A=limits, belt_energy_force=self.residue.energy_force)
        if self.residue.hysteresis:
            site, force, travel = self.residue.hysteresis
            rig, sensors = change_site(
                rig, sensors, sites=COORDINATES, site=site, hysteresis_force=force, hysteresis_travel=travel
            )
        return rig, sensors

    def at_rest(self, start_xy: Array | tuple[float, float], start_s: float) -> Stage:
        """Set up the stage at rest.

        Args:
            start_xy: Position of the carriage, m, shape (2,).
            start_s: Time on the session's clock, s.
        """
        return Stage(self.stage[0], start_xy, start_s, rtol=_RTOL, atol=_ATOL)

    @property
    def near_machine(self) -> Machine:
        """Machine of the package with the plant's parameters and those of its effects that the library has.

        It serves the bound only: no entry sees it.
        """
        rig = self.stage[0]
        machine = declared_machine().replace(base_parameters(rig), name="plant")
        for effect in self.effects:
            if isinstance(effect, OutsideEffect) or not effect.in_library or EFFECTS[effect.name].structure:
                continue  # the bound supports no further coordinates
            values = library_parameters(effect, rig)
            for site in effect.library_sites():
                if effect.name == "current_limit":
                    machine = machine.replace({f"current_limit@{site}.I": min(values["I"], CURRENT_LIMIT_A)})
                else:
                    machine = machine.with_effects(EFFECTS[effect.name].at(site, **values))
        return machine


def declared_machine() -> Machine:
    """Return the machine that every entry gets: the built-in H-frame with 12-bit converters and 12 A."""
    actuators = ACTUATOR_PRESETS["rig"]
    assert actuators is not None
    return actuators.apply(BUILTIN_MACHINES["hframe"]())


def draw_plant(seed: int, index: int) -> GapPlant:
    """Draw a plant.

    Args:
        seed: Seed of the set of plants.
        index: Number of the plant in the set.

    Returns:
        The plant; the same arguments give the same plant.
    """
    rng = np.random.default_rng([seed, index, 0])
    residue = draw_residue(str(rng.choice(_RESIDUES)), rng) if (index // 4) % 2 else Residue()
    while True:
        plant = GapPlant(seed, index, tuple(_draw_effects(rng, index % 4)), residue)
        if _can_be_simulated(plant):
            return plant


def _can_be_simulated(plant: GapPlant) -> bool:
    """Return whether the simulator covers the plant's combination of effects."""
    try:
        parameter_arrays(plant.stage[0])
    except ValueError:
        return False
    return True


def _draw_effects(rng: np.random.Generator, count: int) -> list[HiddenEffect]:
    """Draw effects of different kinds at different places."""
    drawn: list[HiddenEffect] = []
    used: set[str] = set()
    while len(drawn) < count:
        effect = _draw_one(rng)
        name = _name(effect)
        place = effect.site.replace("motor", "phi")
        excluded = {name}.union(*(group for group in _EXCLUSIVE if name in group))
        if place in used or any(_name(other) in excluded for other in drawn):
            continue
        used.add(place)
        drawn.append(effect)
    return drawn


def _draw_one(rng: np.random.Generator) -> HiddenEffect:
    """Draw one effect, of the library or beyond it."""
    if rng.random() >= _OUTSIDE_SHARE:
        name = str(rng.choice(_LIBRARY))
        return draw_effect(name, str(rng.choice(SITES[name])), log_uniform(rng, SMALLEST_SIZE, 1.0), rng)
    number = int(rng.integers(len(_OUTSIDE) + _OUTSIDE_DRAWS))
    return FAMILIES[_OUTSIDE[number]](rng) if number < len(_OUTSIDE) else draw_outside(rng)


def _name(effect: HiddenEffect) -> str:
    return effect.family if isinstance(effect, OutsideEffect) else effect.name
