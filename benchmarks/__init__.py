"""Benchmarks: one script per question; `python -m benchmarks` lists and runs them."""
