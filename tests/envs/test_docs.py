"""The examples in docs/environment.md run."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "environment.md"


def test_examples_run():
    namespace = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(examples) == 5
    for example in examples:
        exec(example.replace("4096", "4"), namespace)
    assert namespace["critic_input"].shape == (len(namespace["env"].unwrapped.privileged_entries),)
    assert 2.5e-6 <= namespace["noise"] <= 1e-5
    _, info = namespace["hop"].reset(seed=0)
    assert info["parameters"]["task.distance"] in (0.025, 0.1)
