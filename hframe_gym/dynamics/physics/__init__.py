"""What a person reads: equations of motion, belts, friction, signals, the specified integration step, linearization."""
