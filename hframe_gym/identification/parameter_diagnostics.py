"""Former place of the reasons to doubt a parameter, until all packages use `covariance`."""

from .covariance import parameter_doubts

__all__ = ["parameter_doubts"]
