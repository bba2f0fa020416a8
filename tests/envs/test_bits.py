"""The short form of benchmarks/env_bits.py: the same bits in every way to run the environment, through resets."""

import pytest

from benchmarks import env_bits


@pytest.mark.parametrize("name", env_bits.OPTIONS)
def test_single_vector_and_adapter_are_equal_to_the_bit(name):
    options = env_bits.OPTIONS[name]
    found = {way: run(330, options) for way, run in env_bits.WAYS.items()}
    assert len(set(found["single"])) == env_bits.COMPARED
    assert found["vector"] == found["single"]
    assert found["stable-baselines3"] == found["single"]


def test_a_new_process_and_more_threads_change_nothing():
    assert env_bits.elsewhere("rig", 160, 3) == env_bits.vector(160, env_bits.OPTIONS["rig"])
