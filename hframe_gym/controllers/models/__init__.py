"""What a controller knows of a machine: its motion, linearized or symbolic, and how its drives act."""
