"""The extra `agents`: importing the package needs none of it, and a missing package names its extra."""

import subprocess
import sys

import pytest

from hframe_gym.agents import train
from hframe_gym.agents.optional_dependencies import (
    EXTRA_MODULES,
    import_optional,
    require_training_packages,
    single_threaded_torch,
)


def test_importing_the_package_loads_neither_torch_nor_stable_baselines3():
    code = (
        "import sys\n"
        "import hframe_gym.agents\n"
        "loaded = {'torch', 'stable_baselines3', 'safetensors', 'tensorboard'} & set(sys.modules)\n"
        "assert not loaded, loaded\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("module", EXTRA_MODULES)
def test_training_names_the_extra_of_a_missing_package(module, monkeypatch, tmp_path):
    package = module.partition(".")[0]
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf"need {package}: pip install 'hframe_gym\[agents\]'"):
        train("ppo", steps=1, out=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("algorithm", ["tqc", "crossq"])
def test_only_the_algorithms_of_sb3_contrib_need_it_and_name_the_extra(algorithm, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(ImportError, match=r"need sb3_contrib: pip install 'hframe_gym\[agents\]'"):
        train(algorithm, steps=1, out=tmp_path)
    assert not list(tmp_path.iterdir())
    require_training_packages("sac")


def test_torch_runs_on_one_thread_inside_the_block_only():
    torch = import_optional("torch")
    before = torch.get_num_threads()
    with single_threaded_torch():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
