"""Fit a machine to recordings: its parameters, the starts of the runs, covariances, and the error left.

Unless a docstring says otherwise, `data` are the runs that a machine was, or is to be, fitted to.
"""
