"""Observation: sensors and their measurements, and the arrays that an agent gets, with their bounds."""
