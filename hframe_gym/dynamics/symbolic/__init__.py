"""Formulas for numbers, arrays and symbols: elementary functions, traced expressions, generated source."""
