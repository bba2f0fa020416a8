"""What the sensors can tell: noise and quantization, ranges at whose ends they saturate, positions that none measures."""
