"""What is lost if a command is killed, the disk is full, two runs collide, or the data are very large?

    python -m benchmarks.faults                    # everything that takes minutes
    python -m benchmarks.faults kills disk         # only these groups
    python -m benchmarks.faults large              # long recordings, many runs: up to an hour, 2 GB of disk

Each group replaces its rows in results/faults.json. Groups that need a full or read-only disk mount one in a
mount namespace of their own (`unshare --map-root-user --mount`, Linux); where that is not allowed, their rows
say so.
"""
