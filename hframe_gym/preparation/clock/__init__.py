"""When the rows were measured: the jitter of the clock, and equal steps in place of jittering stamps."""
