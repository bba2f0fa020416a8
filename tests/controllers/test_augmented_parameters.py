from __future__ import annotations

import numpy as np

from hframe_gym.controllers.augmented_parameters import AugmentedParameters
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine


def test_names_are_those_of_the_stage_that_are_not_zero(hframe: Machine) -> None:
    names = AugmentedParameters(hframe).names
    assert {"x.mass", "y.coulomb", "phi1.viscous", "bottom.EA", "motor2.Ke"} <= set(names)
    assert not {"x.radius", "left.rest_length", "motor1.resistance"} & set(names)
    linear = AugmentedParameters(BUILTIN_MACHINES["hframe-linear"]()).names
    assert not [name for name in linear if name.endswith("coulomb")]


def test_what_an_effect_brings_along_is_taken_as_it_is(hframe: Machine) -> None:
    pushed = hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.02))
    assert AugmentedParameters(pushed).names == AugmentedParameters(hframe).names


def test_parameters_are_the_declared_ones_times_their_factors(hframe: Machine) -> None:
    unknowns = AugmentedParameters(hframe)
    logarithms = np.zeros((2, len(unknowns.names)))
    i = unknowns.names.index("y.mass")
    logarithms[:, i] = np.log(1.2), 50.0
    rows = unknowns.parameters(logarithms)
    declared = np.array(list(hframe.parameters.values()))
    column = list(hframe.parameters).index("y.mass")
    np.testing.assert_allclose(rows[:, column] / declared[column], [1.2, 4.0])
    np.testing.assert_array_equal(np.delete(rows, column, axis=1), np.tile(np.delete(declared, column), (2, 1)))


def test_belts_are_mostly_off_together(hframe: Machine) -> None:
    unknowns = AugmentedParameters(hframe)
    belts = [i for i, name in enumerate(unknowns.names) if name.endswith(".EA")]
    own = unknowns.covariance[np.ix_(belts, belts)]
    correlation = own / np.sqrt(np.outer(np.diag(own), np.diag(own)))
    assert 0.5 < correlation[0, 1] < 1.0
    assert np.linalg.eigvalsh(unknowns.covariance).min() > 0.0
