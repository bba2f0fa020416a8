"""The search for what a machine lacks: effects of the library, tables over one variable, delays of the drives."""
