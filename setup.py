"""Lists the packages for setuptools; everything else is in pyproject.toml.

The folders agents/ and examples/ are installed as hframe_gym.agents and hframe_gym.examples, which no option
of pyproject.toml can find by itself. A checkout may have agents/ as the link hframe_gym/agents besides; the
link must not change what is built.
"""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages(
            include=["hframe_gym", "hframe_gym.*"], exclude=["hframe_gym.agents", "hframe_gym.agents.*"]
        ),
        "hframe_gym.examples",  # no code; the wheel has the recordings and notebooks for `hframe examples`
        "hframe_gym.agents",
        *(f"hframe_gym.agents.{name}" for name in find_packages("agents")),
    ]
)
