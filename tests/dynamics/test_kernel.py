from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.dynamics.kernel import cache_folder, generate, in_blocks, kernel_for
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Machine


def test_machines_of_one_shape_share_a_kernel(hframe: Machine) -> None:
    other = hframe.replace({"x.mass": 5.0, "left.EA": 1e4})
    assert kernel_for(hframe) is kernel_for(other)
    coordinates = tuple(dataclasses.replace(c, coulomb=0.0) for c in hframe.coordinates)
    assert kernel_for(hframe.replace(coordinates=coordinates)) is kernel_for(hframe)


def test_an_absent_effect_leaves_no_trace(hframe: Machine) -> None:
    plain, _ = generate(hframe)
    for effect, site in (("stribeck_friction", "x"), ("constant_force", "y"), ("input_delay", "drives")):
        definition = EFFECTS[effect]
        values = {p.name: max(p.lower, 0.01) for p in definition.parameters}
        text, _ = generate(hframe.with_effects(definition.at(site, **values)))
        assert effect in text
        assert effect not in plain
    assert "maximum(F_" not in plain


def test_a_kernel_file_is_named_by_its_text(hframe: Machine) -> None:
    first, second = kernel_for(hframe), kernel_for(hframe, forced=True)
    assert Path(first.source).parent == cache_folder()
    assert first.source != second.source
    assert Path(first.source).read_text() == generate(hframe)[0]


def test_a_folder_that_cannot_be_written_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("HFRAME_CACHE", str(tmp_path / "file" / "below"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_folder() == tmp_path / "cache" / "hframe_gym"


def test_blocks_hold_the_batch_and_repeat_the_last_stage() -> None:
    values = np.arange(22.0).reshape(11, 2)
    blocks = in_blocks(values)
    assert blocks.shape == (2, 2, 8)
    np.testing.assert_array_equal(blocks[1, :, 2], values[10])
    np.testing.assert_array_equal(blocks[1, :, 7], values[10])
