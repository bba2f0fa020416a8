"""Recordings prepared for a fit: `session.py` tells the story, `usable.py` that of one run."""
