"""Actuation: what the drives of an environment make of the actions, and the voltages after delays."""
