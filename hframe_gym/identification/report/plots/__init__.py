"""Curves and plots of a result, for the page and for picture files."""
