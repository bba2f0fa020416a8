"""What a person reads: equations of motion, belts, friction, signals, integration step, linearization."""
