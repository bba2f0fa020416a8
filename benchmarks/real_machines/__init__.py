"""Recordings of real machines through the same loop as any rig: fit, residual, trace, before and after.

    python -m benchmarks.real_machines all | emps | ced | xl330 | printers

One module a machine; each has `run(console)`, writes benchmarks/results/real_machines_NAME.json and a picture, and
says what it skipped.  docs/real_machines.md tells where the data come from and what came out.
"""
