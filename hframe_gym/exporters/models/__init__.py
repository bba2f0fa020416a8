"""Models of a machine that several exporters write: linear models and modes, input shapers, bodies of MuJoCo."""
