"""Definitions of the library: completeness, bounds, sites, tables, registration."""

from __future__ import annotations

import dataclasses
import pickle
import re
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS, effect_sites, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.errors import InputError
from hframe_gym.machine import (
    BUILTIN_MACHINES,
    HOOKS,
    UNITS,
    Contact,
    Effect,
    EffectParameter,
    Machine,
    argument_names,
    carried_through_contacts,
)
from tests.effects.one_of_each import CASES, ELSEWHERE, Case, history

EVERY_EFFECT = pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
WITH_AMPLITUDE = {name: case for name, case in CASES.items() if EFFECTS[name].amplitudes}
UNIT_SYMBOLS = {"1", "s", "V", "A", "W", "m", "rad", "N", "Nm", "Nms", "kg", "Hz"}


@EVERY_EFFECT
def test_definition_is_complete(effect: Effect, hframe: Machine) -> None:
    """Hooks, formula, source, a site, and parameters with bounds, units and starting values."""
    assert effect.structure or any(getattr(effect, name) for name in HOOKS)
    assert effect.formula
    assert effect.source
    elsewhere = ELSEWHERE.get(effect.name)
    assert effect_sites(effect, BUILTIN_MACHINES[elsewhere[0]]() if elsewhere else hframe)
    roles = [p.role for p in effect.parameters]
    # The screening evaluates sine and cosine of one amplitude.
    assert roles.count("amplitude") <= 1
    assert roles.count("phase") <= roles.count("amplitude")
    for p in effect.parameters:
        assert p.lower < p.upper
        symbols = set(re.sub(r"\^\d", "", p.unit).replace("/", " ").split())
        assert p.unit in {*UNITS["linear"], "voltage"} or symbols <= UNIT_SYMBOLS
        assert p.scale > 0.0
        if p.role == "shape" and p.lower > 0.0:  # a search starts at these values, in typical units
            assert p.grid
            assert min(p.grid) > 0.0


@EVERY_EFFECT
def test_every_parameter_is_used(effect: Effect) -> None:
    """By a hook, or by a structure, whose parameters enter through ties."""
    arguments = {
        name for hook in HOOKS if getattr(effect, hook) for name in argument_names(getattr(effect, hook))
    }
    assert effect.structure or {p.name for p in effect.parameters} <= arguments


@pytest.mark.parametrize(
    ("parameter", "force", "message"),
    [
        ("m", lambda q, m: -m * q, "parameter m has the name of a quantity of the formula force"),
        ("c", lambda p, c: -c * p, r"argument p of the formula force is neither a parameter \(c\) nor"),
        (
            "rate",
            lambda v, rate: -raet * v,  # type: ignore[name-defined]  # noqa: F821
            r"the formula force uses raet, which is not defined; did you mean 'rate'\? .*parameters rate and "
            r"the quantities .*\bq, v\b",
        ),
        (
            "c",
            lambda c: -c * v,  # type: ignore[name-defined]  # noqa: F821
            "force uses v, which is not defined; make it an argument",
        ),
    ],
)
def test_a_name_means_one_thing(parameter: str, force: Callable[..., Any], message: str) -> None:
    """A parameter must not hide a quantity; misspelled names are refused with the definition."""
    with pytest.raises(InputError, match=message):
        Effect(
            name="mistaken",
            family="mistaken",
            site="coordinate",
            formula="",
            source="",
            force=force,
            parameters=(EffectParameter(parameter, "1", 0.0, 1.0, scale=1.0),),
        )


def test_a_formula_may_use_attributes_and_names_of_its_module_and_of_python() -> None:
    Effect(
        name="drag",
        site="coordinate",
        formula="",
        source="",
        force=lambda v, c: -c * np.sign(v) * abs(v),
        parameters=(EffectParameter("c", "1", 0.0, 1.0, scale=1.0),),
    )


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("forces", r"the unit of k is 'forces'; give .* alone; did you mean 'force'\?"),
        ("force/position^2", r"the unit of k is 'force/position\^2'; .* alone$"),
        ("N/m^2", ""),
        ("ohm/degC", ""),
        ("rad/position", ""),
    ],
)
def test_a_unit_is_a_unit_or_the_name_of_one_quantity(unit: str, message: str) -> None:
    """A misspelled name would be shown as a unit, and its start values not relative to the machine."""
    with pytest.raises(InputError, match=message) if message else nullcontext():
        Effect(
            name="spring",
            site="coordinate",
            formula="",
            source="",
            force=lambda q, k: -k * q,
            parameters=(EffectParameter("k", unit, 0.0, 1.0, scale=1.0),),
        )


def test_a_definition_without_formula_is_refused() -> None:
    """It would change nothing, and a search would try it in vain."""
    with pytest.raises(InputError, match="effect idle: has no formula; give one of force, "):
        Effect(name="idle", site="coordinate", formula="", source="", parameters=())


def test_a_definition_for_an_unknown_kind_of_site_is_refused() -> None:
    with pytest.raises(InputError, match="effect idle: the site is 'carriage'; choose one of coordinate, "):
        Effect("idle", "carriage", (), "", "", force=lambda q: -q)  # type: ignore[arg-type]


def test_an_unknown_role_is_refused() -> None:
    """A parameter that is meant as an amplitude, and is none, is not found by a search."""
    with pytest.raises(InputError, match="parameter k: the role is 'amp'; choose one of amplitude, "):
        EffectParameter("k", "1", 0.0, 1.0, scale=1.0, role="amp")  # type: ignore[arg-type]


def test_quantities_of_the_hooks_are_described() -> None:
    """The table of the docstring lists the same hooks and quantities."""
    rows = re.findall(
        r"^    (\w+) {2,}\S.*? {2,}(.*(?:\n {60,}[\w, ]+$)*)", Effect.__doc__ or "", re.MULTILINE
    )
    described = {hook: tuple(re.findall(r"\w+", quantities)) for hook, quantities in rows}
    assert {hook: described.get(hook, ()) for hook in HOOKS} == HOOKS


@EVERY_EFFECT
def test_wrong_parameters_are_refused(effect: Effect) -> None:
    """Names must be complete and values within bounds."""
    case = CASES[effect.name] if effect.name in CASES else ELSEWHERE[effect.name][1]
    with pytest.raises(ValueError, match=f"effect {effect.name} at {case.site} takes"):
        effect.at(case.site, nonsense=1.0)
    first = effect.parameters[0]
    wrong = case.parameters | {first.name: first.upper * 2 + 1}
    with pytest.raises(ValueError, match=f"{first.name} = .* is outside"):
        effect.at(case.site, **wrong)


@pytest.mark.parametrize("case", WITH_AMPLITUDE.values(), ids=WITH_AMPLITUDE)
def test_zero_amplitude_changes_nothing(case: Case, hframe: Machine) -> None:
    """The readings equal those of the machine without the effect."""
    time_s, inputs = history(0, seconds=0.3)
    [amplitude] = EFFECTS[case.name].amplitudes
    effect = case.effect.with_parameters(case.parameters | {amplitude: 0.0})
    difference = (
        hframe.with_effects(effect).simulate(time_s, inputs).outputs - hframe.simulate(time_s, inputs).outputs
    )
    # A step evaluates nonlinear belts twice and linear ones once, which changes the error of the integrator.
    assert np.abs(difference).max() < (
        1e-6 if case.site == "belts" or case.name == "eccentric_pulley" else 1e-12
    )


def test_effect_that_does_not_fit_has_no_site() -> None:
    """An axis without belts and with one sensor."""
    axis = BUILTIN_MACHINES["axis"]()
    for name in (
        "belt_play",
        "eccentric_pulley",
        "bridge_yaw",
        "idler_inertia",
        "sensor_skew",
        "sensor_scale",
    ):
        assert effect_sites(EFFECTS[name], axis) == ()


@pytest.mark.parametrize("belt", ["left", "right", "bottom"])
def test_idlers_need_the_belts_of_an_h_frame(belt: str, hframe: Machine) -> None:
    """One belt with another factor, one belt too few, and a name in use."""
    other = [
        dataclasses.replace(b, extension=b.extension | {"x": 3.0}) if b.name == belt else b
        for b in hframe.belts
    ]
    fewer = [b for b in hframe.belts if b.name != belt]
    taken = [dataclasses.replace(b, name="left_rail") if b.name == "right" else b for b in hframe.belts]
    for belts in (other, fewer, taken):
        machine = dataclasses.replace(hframe, belts=tuple(belts))
        assert effect_sites(EFFECTS["idler_inertia"], machine) == ()
        with pytest.raises(ValueError, match="idler_inertia: does not fit machine 'hframe'"):
            machine.with_effects(CASES["idler_inertia"].effect)


def test_components_of_shared_sites(hframe: Machine) -> None:
    """A search tries all drives or belts first, then each; other effects on drives have no shared site."""
    assert effect_sites(EFFECTS["electrical_lag"], hframe) == ("drives", "motor1", "motor2")
    assert effect_sites(EFFECTS["input_delay"], hframe) == ("drives", "motor1", "motor2")
    assert effect_sites(EFFECTS["belt_play"], hframe) == ("belts", "left", "right", "bottom")
    assert effect_sites(EFFECTS["voltage_offset"], hframe) == ("motor1", "motor2")
    assert EFFECTS["electrical_lag"].at("drives", tau=1e-3).components(hframe) == ("motor1", "motor2")
    assert EFFECTS["belt_play"].at("left", d=1e-4).components(hframe) == ("left",)
    assert all(not effect.shared or effect.site == "drive" for effect in EFFECTS.values())
    axis = BUILTIN_MACHINES["axis"]()
    assert effect_sites(EFFECTS["input_delay"], axis) == ("drives",)
    assert effect_sites(EFFECTS["electrical_lag"], axis) == tuple(d.name for d in axis.drives)


def test_teeth_of_a_gear_are_no_belt(hframe: Machine) -> None:
    """Both gears may have a gap; effects at "belts" leave their teeth alone, far sides are displaced."""
    gears = [
        EFFECTS["gear_backlash"].at(m, **CASES["gear_backlash"].parameters) for m in ("motor1", "motor2")
    ]
    machine = hframe.with_effects(CASES["belt_damping"].effect, *gears)
    assert machine.contacts == (Contact("phi1", "phi1_load", 2e-3), Contact("phi2", "phi2_load", 2e-3))
    assert machine.effects[0].components(machine) == ("left", "right", "bottom")
    assert effect_sites(EFFECTS["belt_play"], machine) == ("belts", "left", "right", "bottom")
    assert effect_sites(EFFECTS["gear_backlash"], machine) == ()
    assert machine.parameters["phi1.mass"] + gears[0].parameters["J"] == pytest.approx(
        hframe.parameters["phi1.mass"]
    )
    moved = carried_through_contacts(machine, np.arange(6.0)[None])
    np.testing.assert_array_equal(moved, [[0.0, 1.0, 2.0, 3.0, 2.0, 3.0]])


def test_unknown_belt_is_refused(hframe: Machine) -> None:
    """The message lists the sites."""
    with pytest.raises(ValueError, match="has no site 'middle'; choose one of belts, left, right, bottom"):
        hframe.with_effects(EFFECTS["belt_play"].at("middle", d=1e-4))


def test_skew_fits_linear_sensors_only(hframe: Machine) -> None:
    """Encoders have no perpendicular axis."""
    assert effect_sites(EFFECTS["sensor_skew"], hframe) == ("x_m", "y_m")


def table(knots: np.ndarray, values: np.ndarray) -> dict[str, float]:
    """Return the parameters of a table."""
    return {f"k{i:02d}": k for i, k in enumerate(knots)} | {f"f{i:02d}": f for i, f in enumerate(values)}


@pytest.mark.parametrize(("kind", "hook"), [("smooth_force", "force"), ("smooth_friction", "coulomb")])
def test_table_is_linear_between_knots(kind: str, hook: str) -> None:
    """Compare with `np.interp`, beyond the ends too."""
    rng = np.random.default_rng(4)
    knots, values = np.sort(rng.normal(size=KNOTS)), rng.normal(size=KNOTS)
    name = f"{kind}[position of y]"
    effect = get_effect(name).at("x", **table(knots, values))
    u = np.linspace(knots[0] - 1.0, knots[-1] + 1.0, 500)
    np.testing.assert_allclose(effect(hook, u=u), np.interp(u, knots, values), atol=1e-12)


@pytest.mark.parametrize(
    "name",
    [
        "smooth_force[weight of x]",
        "smooth_force[position]",
        "smooth_nothing[time]",
        "smooth_force[position of y",
        "smooth_force[position of y]]",
        "rust",
    ],
)
def test_unknown_name_is_refused(name: str) -> None:
    """Neither an effect of the library nor a table."""
    with pytest.raises(KeyError):
        get_effect(name)


@EVERY_EFFECT
def test_definition_is_picklable(effect: Effect) -> None:
    """Environments in other processes need machines with effects."""
    assert pickle.loads(pickle.dumps(effect)) == effect


def test_table_is_picklable() -> None:
    """Tables are made on demand and must be equal after a round trip."""
    definition = get_effect("smooth_force[path of x]")
    assert pickle.loads(pickle.dumps(definition)) == definition


def test_a_table_over_the_path_counts_the_distance_in_both_directions() -> None:
    """A table over a position or the time needs no state."""
    step = get_effect("smooth_force[path of x]").next_state
    assert step is not None
    assert step(z=1.0, dq=-2.0) == step(z=1.0, dq=2.0) == 3.0
    assert get_effect("smooth_force[position of x]").next_state is None
    assert get_effect("smooth_friction[time]").next_state is None
