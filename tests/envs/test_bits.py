"""Short form of benchmarks/env_bits.py: the single, vector and adapted environments return the same bits."""

import pytest

from benchmarks import env_bits


@pytest.mark.parametrize("name", env_bits.OPTIONS)
def test_single_vector_and_adapted_environments_are_bit_equal(name):
    options = env_bits.OPTIONS[name]
    digests = {way: run(330, options) for way, run in env_bits.WAYS.items()}
    assert len(set(digests["single"])) == env_bits.COMPARED
    assert digests["vector"] == digests["single"]
    assert digests["stable-baselines3"] == digests["single"]


@pytest.mark.integration
def test_a_new_process_with_more_threads_is_bit_equal():
    assert env_bits.in_new_process("rig", 160, 3) == env_bits.vector(160, env_bits.OPTIONS["rig"])
