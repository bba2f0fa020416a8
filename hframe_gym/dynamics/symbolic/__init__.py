"""Formulas for numbers, arrays and symbols alike: elementary functions, traced expressions, generated source."""
