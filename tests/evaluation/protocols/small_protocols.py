"""Short versions of the protocols, for tests."""

from __future__ import annotations

import dataclasses

from hframe_gym.evaluation import PROTOCOLS, Protocol


def small(name: str, draws: int = 4, duration_s: float = 0.3) -> Protocol:
    """Return a short version of a protocol with the digest of its draws."""
    protocol = dataclasses.replace(PROTOCOLS[name], draws=draws, duration_s=duration_s)
    return dataclasses.replace(protocol, digest=protocol.compute_digest())
