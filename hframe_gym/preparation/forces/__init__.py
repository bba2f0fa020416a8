"""The drives' forces against the measured motion, without a simulation: which way a drive turns."""
