"""What the drives received: voltages between the rows of a slow log, and measured inputs without their noise."""
