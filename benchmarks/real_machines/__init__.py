"""Does identification work on real machines' recordings? The same procedure as for any rig, before and after.

    python -m benchmarks.real_machines all | emps | ced | xl330 | printers

There is one module per machine. Its function `run(console)` writes benchmarks/results/real_machines_NAME.json
and a picture, or reports that the data are missing. docs/real_machines.md describes the origin of the data
and the results.
"""
