"""When the rows were measured: the jitter of the clock, and equal steps for stamps that jitter."""
