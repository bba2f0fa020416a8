"""What else the data say: doubtful and inseparable parameters, unequal belts, the next experiment."""
