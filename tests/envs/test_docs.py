"""The examples in docs/environment.md run."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "environment.md"


def test_examples_run():
    space = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(examples) == 3
    for example in examples:
        exec(example.replace("4096", "4"), space)
    assert space["critic_sees"].shape == (len(space["env"].unwrapped.privileged_entries),)
