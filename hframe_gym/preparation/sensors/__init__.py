"""What the sensors can tell: noise, quantization, ranges, and positions that none of them measures."""
