"""What a compiler reads: kernels generated from the equations and compiled to SIMD machine code."""
