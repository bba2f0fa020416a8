"""What the drives received: voltages between the rows of a slow log, measured inputs without noise."""
