"""One compiled kernel for a machine with any selection of some effects, so that a search compiles only once.

A kernel is the compiled code that simulates machines of one structure. It can be shared if the effects only add terms
to the equations: with an amplitude of zero, the term vanishes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...machine import HOOKS, AppliedEffect, Machine
from ..physics.effect_instances import instances_with_state
from .kernel import Kernel, is_generated, kernel_for

# Effects with these hooks only, and with an amplitude, change no bit of a simulation while their amplitudes are zero.
_ADDITIVE_HOOKS = {
    "force",
    "active_region",
    "coulomb",
    "viscous",
    "voltage",
    "measurement",
    "next_state",
    "initial_spread",
}
_MAX_SHARED_KERNELS = 8


class _SharedKernel:
    """Kernel of a machine with additive effects, which also simulates the machine without some of them.

    Attributes:
        kernel: Its compiled functions, with external forces.
    """

    def __init__(self, machine: Machine) -> None:
        self.kernel = kernel_for(machine, forced=True)
        *self._structure, _, self._ties = machine.shape
        self._effects = {(e.definition, e.site): _can_be_absent(e) for e in machine.effects}
        amplitudes = {f"{e.label}.{name}" for e in machine.effects for name in e.definition.amplitudes}
        values = {name: 0.0 if name in amplitudes else value for name, value in machine.parameters.items()}
        self._values_if_absent = np.array(list(values.values()))
        self._states = _state_names(machine)

    def simulates(self, machine: Machine) -> bool:
        """Return whether a machine is this one without some of its effects that can be absent."""
        *structure, _, ties = machine.shape
        effects = tuple((e.definition, e.site) for e in machine.effects)
        if structure != self._structure or ties != self._ties:
            return False
        kept = tuple(
            effect for effect, can_be_absent in self._effects.items() if effect in effects or not can_be_absent
        )
        return kept == effects

    def parameters(self, machine: Machine, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return parameters (B, P) of variants of a machine in the order of the kernel's layout."""
        table = np.tile(self._values_if_absent, (len(values), 1))
        table[:, [self.kernel.layout.parameters[name] for name in machine.parameters]] = values
        return table

    def start(self, machine: Machine, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return states of a machine at the first sample (B, 2 * coordinates + its effect states) for the kernel."""
        names = _state_names(machine)
        moving = start.shape[1] - len(names)
        table = np.zeros((len(start), moving + len(self._states)))
        table[:, :moving] = start[:, :moving]
        table[:, [moving + self._states.index(name) for name in names]] = start[:, moving:]
        return table


def _state_names(machine: Machine) -> list[tuple[str, str]]:
    """Return label and component of each effect with a state, in the order of the states."""
    return [(instance.effect.label, instance.component) for instance in instances_with_state(machine)]


_SHARED: deque[_SharedKernel] = deque(maxlen=_MAX_SHARED_KERNELS)


def _can_be_absent(effect: AppliedEffect) -> bool:
    """Return whether zero amplitudes make the effect disappear without a change of any bit."""
    hooks = {hook for hook in HOOKS if getattr(effect.definition, hook)}
    return bool(effect.definition.amplitudes) and hooks <= _ADDITIVE_HOOKS and effect.definition.structure is None


def share_kernel(machine: Machine, effects: Sequence[AppliedEffect]) -> None:
    """Prepare one kernel, the compiled simulation code, for a machine with any selection of some further effects.

    A search that tries many effects one at a time then compiles once, and not once per effect; `rollout_kernel` finds
    the shared kernel. Effects that are not selected get the amplitude zero and change no bit of a simulation. Effects
    that a zero amplitude does not remove in this way (delays, changes of current, bristle friction, effects that act on
    belts or add components) are left out of the kernel. If no other effect is given, nothing is prepared.

    Args:
        machine: Machine with the effects (deviations from the nominal model) that it has already.
        effects: Further effects that may be added to it, alone or in any combination. Effects that differ in parameter
            values only, which are data of the kernel, may occur several times.
    """
    additional = {effect.label: effect for effect in effects if _can_be_absent(effect)}
    if additional:
        _SHARED.append(_SharedKernel(machine.with_effects(*additional.values())))


def rollout_kernel(
    machine: Machine, parameters: NDArray[np.float64], start: NDArray[np.float64], *, forced: bool
) -> tuple[Kernel, NDArray[np.float64], NDArray[np.float64]]:
    """Return compiled functions that simulate a machine, with parameters and initial states arranged for them.

    The functions may be shared with machines that have more effects (deviations from the nominal model), so that their
    arrays can have more parameters and states than the machine. `share_kernel` prepares such functions.

    Args:
        parameters: P parameters in the order of `Machine.parameters`, SI, shape (B, P) for B variants of the machine.
        start: Belt travel (position, or radius * angle of a pulley), m, its rate, m/s, and states of effects at the
            first sample, shape (B, 2 * coordinates + effect states).
        forced: Whether an external force acts on the coordinates.

    Returns:
        kernel: Functions generated for this machine if they exist, else shared ones, else newly generated ones.
        parameters: Parameters in the order of the kernel, SI, shape (B, parameters of the kernel).
        start: Belt travel, m, its rate, m/s, and effect states of the kernel, shape (B, states of the kernel).
    """
    if not is_generated(machine, forced=forced):
        for shared in reversed(_SHARED):
            if shared.simulates(machine):
                return shared.kernel, shared.parameters(machine, parameters), shared.start(machine, start)
    return kernel_for(machine, forced=forced), parameters, start
