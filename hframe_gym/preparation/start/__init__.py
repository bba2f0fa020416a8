"""Where a run begins: rest, zeros of the sensors, positions, velocities and the stretch of the belts."""
