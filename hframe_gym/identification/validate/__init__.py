"""Validation: the held-out runs judge what a search found, and nothing worse than a plain fit is delivered."""
