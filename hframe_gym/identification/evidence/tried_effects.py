"""Effects that a search tried: those that it selected, and those that reduced the error but failed a test."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from ...machine import AppliedEffect, Machine
from ..fit.estimation import Fit


@dataclass(frozen=True)
class SelectedEffect:
    """An effect that the forward selection added to the machine.

    Attributes:
        effect: The effect with its fitted parameters.
        gain: Reduction of chi-squared per sample on the fitted runs.
        machine_without: The machine fitted without the effect: with all other effects if they have been
            tested together, else as it was before the effect was added.
        rival_effects: Other effects, with fitted parameters, that explain the data equally well.
    """

    effect: AppliedEffect
    gain: float
    machine_without: Machine
    rival_effects: tuple[AppliedEffect, ...] = ()

    @property
    def rivals(self) -> tuple[str, ...]:
        """Labels (name@site) of the rivals, then other causes that no recording tells apart, in words."""
        return (*(rival.label for rival in self.rival_effects), *self.effect.definition.equivalent)

    def with_values(self, machine: Machine, machine_without: Machine | None = None) -> SelectedEffect:
        """Return a copy in which the effect has the parameter values of another fitted machine.

        Args:
            machine: Machine that contains the effect, usually a later fit.
            machine_without: New value of `machine_without`. Default: unchanged.

        Returns:
            Copy with the updated effect.
        """
        return dataclasses.replace(
            self,
            effect=next(e for e in machine.effects if e.label == self.effect.label),
            machine_without=machine_without or self.machine_without,
        )


# Fit of a machine with all selected effects, and these effects.
Selection = tuple[Fit, tuple[SelectedEffect, ...]]
# Fit without the next effect, and trial fits with one effect each, at the same observer bandwidth, the best
# one first.
Step = tuple[Fit, list[Fit]]


@dataclass(frozen=True)
class ConsideredEffect:
    """An effect that reduces the error of the fitted runs but was not selected.

    Attributes:
        effect: The effect with the parameters of its trial fit.
        machine: Machine that was fitted with the effect.
        machine_without: Machine that was fitted without the effect.
        reason: Why it was not selected; a clause that follows "it ".
    """

    effect: AppliedEffect
    machine: Machine
    machine_without: Machine
    reason: str
