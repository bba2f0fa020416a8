"""Planned motions: transfers of least energy or time, and plans within the voltages of an episode."""
