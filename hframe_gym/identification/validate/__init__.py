"""Validation: the held-out runs judge what a search found, and none worse than a plain fit is delivered."""
