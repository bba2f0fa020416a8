"""The search for what a machine lacks: library effects, tables over one variable, drive delays."""
