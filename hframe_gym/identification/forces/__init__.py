"""Forces along the recorded motion: what a model lacks of them, how large they are, what they depend on."""
