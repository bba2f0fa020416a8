"""How far does a controller close the gap to a plant that its model does not describe? The protocol `gap-v1`.

    python -m benchmarks.gap run ENTRY... --out DIR     # score entries; continues where an earlier call ended
    python -m benchmarks.gap list                       # entries that come with the repository
    python -m benchmarks.gap plants                     # what the plants hide

`plants` draws the plants of the independent simulator, `recorder` records them within a budget,
`control_loop` runs controllers on them, `machines` identifies them, `entries` holds the interface of an entry
and those of the repository, `protocol` fixes the settings, `results` writes and reads result files, `bounds`
computes the shortest possible times.
"""
