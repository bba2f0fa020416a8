"""Which runs, and which of their rows, are fitted, held out or left out."""
