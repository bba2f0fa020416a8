"""Evidence for and against an effect: significance, rivals, held-out runs, behavior outside recordings."""
