"""Tests of the protocols: frozen draws and undeclared effects."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.envs import HFrameVectorEnv, LogUniform
from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    EFFECT_FAMILIES,
    PROTOCOLS,
    acting_effects,
    episode_conditions,
    get_protocol,
    installed_versions,
    package_versions,
    run_protocol,
    with_absent_effects,
)
from hframe_gym.evaluation.undeclared_effects import EXPECTED_EFFECTS, SMALLEST_SIZE, Sometimes
from hframe_gym.machine import BUILTIN_MACHINES
from tests.evaluation.protocols.small_protocols import small

pytestmark = pytest.mark.integration


HFRAME = BUILTIN_MACHINES["hframe"]()


def test_results_state_the_version_of_the_code_that_ran(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not that of the installation, which an editable one keeps; packages not installed are omitted."""
    monkeypatch.setattr(package_versions, "__version__", "99.0")
    versions = installed_versions(("hframe_gym", "numpy", "no_such_package"))
    assert versions == {"hframe_gym": "99.0", "numpy": np.__version__}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_the_draws_of_a_protocol_never_change(name: str) -> None:
    """A failure means that scores are no longer comparable: add a new version, do not change the digest."""
    PROTOCOLS[name].check()


def test_a_changed_setting_changes_the_digest_and_is_refused() -> None:
    protocol = small("reach-v1")
    for change in ({"seed": 7}, {"period": 0.005}, {"randomize": "wide"}, {"drives": "rig"}):
        changed = dataclasses.replace(protocol, **change)  # type: ignore[arg-type]
        assert changed.compute_digest() != protocol.digest
        with pytest.raises(InputError, match="would not be comparable"):
            run_protocol("pid", changed)


def test_the_protocols_have_512_draws_that_do_not_overlap() -> None:
    assert list(PROTOCOLS) == ["reach-v1", "track-v1", "hard-v1"]
    assert all(p.draws == 512 for p in PROTOCOLS.values())
    assert PROTOCOLS["hard-v1"].seed > PROTOCOLS["reach-v1"].seed + 512
    with pytest.raises(InputError, match="choose one of reach-v1, track-v1, hard-v1"):
        get_protocol("reach-v2")
    with pytest.raises(InputError, match=r"python -m benchmarks\.gap run ENTRY in a clone"):
        get_protocol("gap-v1")


def test_absent_effects_do_not_change_the_motion() -> None:
    """Only the order of floating-point operations and the integration of delays differ."""
    rng = np.random.default_rng(0)
    envs = [HFrameVectorEnv(8, machine=m, drives="rig") for m in (HFRAME, with_absent_effects(HFRAME))]
    for env in envs:
        env.reset(seed=5)
    for _ in range(15):
        actions = rng.uniform(-1.0, 1.0, (8, 2))
        for env in envs:
            env.step(actions)
    tools = [env.batch.simulator.tool_positions() for env in envs]
    np.testing.assert_allclose(tools[1], tools[0], atol=2e-6)


def test_hard_draws_two_effects_on_average_with_sizes_in_their_ranges() -> None:
    protocol = PROTOCOLS["hard-v1"]
    conditions = episode_conditions(protocol.scenario("reach"))
    families = {family.name: family for family in EFFECT_FAMILIES}
    counts, seen = [], set()
    for row in conditions.parameters:
        machine = acting_effects(conditions.machine, row)
        acting = [e for e in machine.effects if e.name != "current_limit" or e.parameters["I"] < 12.0]
        counts.append(len(acting))
        for effect in acting:
            family = families[effect.name]
            low, high = family.ranges[effect.site]
            size = effect.parameters[family.size]
            assert low <= abs(size) <= high
            assert size > 0.0 or family.signed
            seen.add(effect.name)
    assert seen == set(families)
    assert np.mean(counts) == pytest.approx(EXPECTED_EFFECTS, abs=3.0 * np.sqrt(EXPECTED_EFFECTS / 512))
    assert protocol.declared_machine.effects
    assert {e.name for e in protocol.declared_machine.effects} == {"current_limit"}


def test_acting_effects_move_as_the_environment() -> None:
    """The machine with the acting effects alone is the one that the bound is computed for."""
    protocol = small("hard-v1", draws=12)
    scenario = protocol.scenario("reach")
    conditions = episode_conditions(scenario)
    env = HFrameVectorEnv(12, machine=scenario.machine, randomize=scenario.randomize, drives="rig")
    env.reset(seed=scenario.seed)
    actions = np.random.default_rng(1).uniform(-0.5, 0.5, (12, 12, 2))
    for action in actions:
        env.step(action)
    draw = next(
        b
        for b, row in enumerate(conditions.parameters)
        if len(acting_effects(conditions.machine, row).effects) > 2
    )
    single = HFrameVectorEnv(
        1, machine=acting_effects(conditions.machine, conditions.parameters[draw]), drives="machine"
    )
    single.reset(seed=0, options={"start": conditions.start[draw], "target": conditions.goal[draw]})
    for action in actions:
        single.step(action[draw : draw + 1])
    np.testing.assert_allclose(
        single.batch.simulator.tool_positions()[0], env.batch.simulator.tool_positions()[draw], atol=5e-6
    )


def test_sometimes_is_a_log_uniform_number_with_the_given_probability() -> None:
    u = (np.arange(10_000) + 0.5) / 10_000
    values = Sometimes(0.2, 1.0, 3.0, signed=True).quantile(u)
    assert np.all(np.diff(values) >= 0.0)
    assert np.mean(values != 0.0) == pytest.approx(0.2, abs=1e-3)
    np.testing.assert_allclose(np.sort(-values[values < 0.0]), values[values > 0.0], rtol=1e-2)
    limit = Sometimes(0.5, 5.0, 11.0, otherwise=12.0).quantile(u)
    np.testing.assert_allclose(limit[: len(u) // 2], LogUniform(5.0, 11.0).quantile(u[: len(u) // 2] / 0.5))
    assert np.all(limit[len(u) // 2 :] == 12.0)
    for arguments in ((0.0, 1.0, 2.0), (0.5, 1.0, 3.0, 2.0), (0.5, 1.0, 2.0, 3.0, True), (0.5, 2.0, 1.0)):
        with pytest.raises(InputError):
            Sometimes(*arguments)
    assert 0.0 < SMALLEST_SIZE < 1.0
