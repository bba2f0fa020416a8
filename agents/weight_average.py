"""Exponential moving average of the weights of a policy. Importing this needs the extra `agents`."""

from __future__ import annotations

from typing import Any

import torch

HALF_KEPT_AFTER = 9.0  # updates after which the average keeps half of its value; the first weights are random


def update_average(average: Any, trained: Any, averaging: float, updates: int) -> None:
    """Update a moving average of the weights of a trained module, in place, after update number `updates`.

    Args:
        average: Module of torch whose weights are the average; modified.
        trained: Module with the same weights by name, as the last update left them.
        averaging: Fraction of the average that remains, 0 to below 1. It is at most `updates` / (`updates` +
            9), so that the average forgets the first weights.
        updates: Number of the update, from 1.
    """
    kept = min(averaging, updates / (updates + HALF_KEPT_AFTER))
    with torch.no_grad():
        for mean, weights in zip(average.parameters(), trained.parameters(), strict=True):
            mean.lerp_(weights, 1.0 - kept)
