"""Models of a machine for several exporters: linear models and modes, input shapers, bodies of MuJoCo."""
