"""Formulas for an unexplained force or friction: closed forms, sparse regression, and a new effect's file."""

from .effect_file import FormulaEffect, write_effect_file
from .regression import Curve, Formula, fit_formulas
from .table_curve import curve_of_table, terms_of_table
from .terms import Term, terms_of

__all__ = [
    "Curve",
    "Formula",
    "FormulaEffect",
    "Term",
    "curve_of_table",
    "fit_formulas",
    "terms_of",
    "terms_of_table",
    "write_effect_file",
]
