"""Actuation: what the drives of an environment make of the actions, and the voltages that act after delays."""
