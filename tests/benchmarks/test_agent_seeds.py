"""Trainings with several seeds: which runs are used again, and the table of their scores."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.agent_seeds import agent_folder, draw, trained
from hframe_gym.agents import load_recipe, shipped_agent_folder
from hframe_gym.errors import InputError
from tools.tables.agents import agent_seeds


def test_complete_runs_are_used_again_and_others_continued(tmp_path, monkeypatch):
    recipe = load_recipe("apg_mix", "reach")
    run = shutil.copytree(shipped_agent_folder("apg_mix-seed0", "reach"), tmp_path / "apg_mix-seed7")
    resumed = []
    monkeypatch.setattr("benchmarks.agent_seeds.train", lambda *_, resume, **__: resumed.append(resume))
    assert trained((recipe, 7, run)) == run
    assert not resumed
    card = json.loads((run / "card.json").read_text())
    (run / "card.json").write_text(json.dumps({**card, "curve": card["curve"][:-1]}))
    trained((recipe, 7, run))
    trained((replace(recipe, steps=recipe.steps - 1), 7, run))  # other settings: `train` refuses the folder
    trained((recipe, 8, tmp_path / "elsewhere"))
    assert resumed == [True, False, False]


def test_agents_of_other_seeds_are_found_if_their_training_is_complete(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.agent_seeds.TRAINED", tmp_path)
    shipped = shipped_agent_folder("apg_mix-seed0", "reach")
    assert agent_folder("apg_mix-seed0", "reach").samefile(shipped)
    run = shutil.copytree(shipped, tmp_path / "reach" / "apg_mix-seed7")
    assert agent_folder("apg_mix-seed7", "reach") == run
    card = json.loads((run / "card.json").read_text())
    (run / "card.json").write_text(json.dumps({**card, "curve": card["curve"][:-1]}))
    with pytest.raises(InputError, match=f"hframe train apg_mix --task reach --seed 7 --out {run}"):
        agent_folder("apg_mix-seed7", "reach")


def _agent(seed, precise):
    curve = [
        {"steps": n, "cpu_s": n / 1e4, "settling_s_0.2mm": 0.5 - n / 1e7, "success_0.05mm": precise}
        for n in (0, 10**6)
    ]
    return {
        "seed": seed,
        "steps": 10**6,
        "cpu_s": 100.0 + seed,
        "success": {"0.05mm": precise},
        "curve": curve,
    }


def test_table_shows_the_worst_seed_of_each_score(tmp_path, monkeypatch):
    by_seed = [{"mean": mean, "ci95": [mean - 0.01, mean + 0.01]} for mean in (1.12, 1.16, 1.13)]
    over_bound = {
        "mean": float(np.mean([r["mean"] for r in by_seed])),
        "ci95": [1.1, 1.2],
        "by_seed": by_seed,
    }
    agents = [_agent(seed, precise) for seed, precise in enumerate((0.99, 1.0, 0.98))]
    recipes = {"ppo_mix": {"over_bound": over_bound, "agents": agents}}
    row = agent_seeds({"recipes": recipes}).splitlines()[-1]
    assert row == "| `ppo_mix` | 3 | 1000000 | 101 | 1.137 (1.100 to 1.200) | 1.160 | 99.0 % | 98.0 % |"
    monkeypatch.setattr("benchmarks.agent_seeds.FIGURES", tmp_path)
    draw(json.loads(json.dumps(recipes)))
    assert (tmp_path / "agent_seeds.png").stat().st_size > 10_000
