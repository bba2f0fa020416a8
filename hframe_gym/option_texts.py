"""Descriptions of options that commands and exporters share; names in braces stand for registered names."""

MACHINE = "A machine.json or a built-in name (see `hframe machines`)."
TASK = "Task: {tasks}, or module:name, also of my_module.py in this folder."
RANDOMIZE = "Randomization of each episode's machine: {randomizations}."
SENSORS = "What controllers observe: {sensors}; state is exact, the others are measurements."
PERIOD = "Control period in seconds, 1e-5 to 10."
EPISODES = "Number of episodes of each controller."
MAX_EPISODES = 10**6
MAX_SEED = 2**31 - 1
