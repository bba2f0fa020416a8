"""Sparse regression of a tabulated curve on a dictionary of closed forms.

Every term of `terms` with every starting value of its shape parameters is one column of the dictionary.
Orthogonal matching pursuit (scikit-learn) chooses few columns; nonlinear least squares (SciPy) then fits the
shape parameters, with the amplitudes eliminated in every step (variable projection). The error by which
formulas are compared is that of knots to which they were not fitted.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...arrays import Array
from ...errors import naming_extra
from .terms import Term

# Points between two knots where a formula is compared with the straight pieces of the table.
_FINE_POINTS = 16
# Standard deviation of every ordinate relative to the curve's, for what straight pieces hide.
_ERROR_FLOOR = 0.02
_ABSORBED = 30.0  # Standard deviation, relative to the curve's, of what other parameters can represent.
_FOLDS = 4  # Every fourth knot is left out in turn.
_MAX_TERMS = 3
_MAX_SINGLES = 6  # First terms that are extended by further ones.
_POOR = 8.0  # A fit to all knots with this times the smallest error is not validated.
_HOPELESS = 4.0  # A formula with this times the smallest error of the left-out knots is not proposed.
# Error, in standard deviations, at which nothing is left that further parameters could explain.
_EXPLAINED = 0.5
# Pairs of terms of which one with an offset or another center can be written by the other.
_REDUNDANT = ({"square", "parabola"}, {"step", "slow step"}, {"decay", "slow decay"}, {"bump", "resonance"})
# A formula with more parameters must reduce the error of the left-out knots to this fraction.
_CLEAR_GAIN = 0.85


@dataclass(frozen=True)
class Curve:
    """Ordinates of a table at k knots of one variable, with their uncertainty.

    Attributes:
        knots: Increasing values of the variable, in its unit (SI), shape (k,).
        values: Ordinates, N or Nm, shape (k,).
        covariance: Covariance of the ordinates, shape (k, k).
        absorbed: Curves at the knots that other parameters of the machine can represent, for example a
            constant friction level; no formula needs to explain them, shape (k, m).
    """

    knots: Array
    values: Array
    covariance: Array
    absorbed: Array

    @cached_property
    def error_covariance(self) -> Array:
        """Covariance of the ordinates with which formulas are fitted, (N or Nm)^2, shape (k, k).

        It is the sum of `covariance`, a small variance of every ordinate, and a large variance along each
        curve in `absorbed`, so that a deviation in the direction of these curves does not count as an error.
        """
        deviation = float(np.std(self.values)) or 1.0
        floor = (_ERROR_FLOOR * deviation) ** 2 * np.eye(len(self.values))
        free = self.absorbed / np.maximum(np.abs(self.absorbed).max(axis=0, initial=0.0), 1e-300)
        return self.covariance + floor + (_ABSORBED * deviation) ** 2 * (free @ free.T)

    @cached_property
    def fine(self) -> Array:
        """Closely spaced values of the variable from the first knot to the last, shape (points,)."""
        pieces = np.linspace(self.knots[:-1], self.knots[1:], _FINE_POINTS, endpoint=False, axis=1)
        return np.append(pieces.ravel(), self.knots[-1])

    @cached_property
    def projection(self) -> Array:
        """Matrix that converts values of a function at `fine` to ordinates at the knots, shape (k, points).

        Among all curves that are linear between the knots, the one with these ordinates has the smallest
        squared distance from the function.
        """
        # Basis functions of linear interpolation: 1 at one knot and 0 at the others.
        hats = np.stack([np.interp(self.fine, self.knots, row) for row in np.eye(len(self.knots))], axis=1)
        spacing = np.gradient(self.fine)[:, None]
        return np.asarray(np.linalg.solve(hats.T @ (spacing * hats), (spacing * hats).T))

    def projected(self, function: Callable[[Array], Array]) -> Array:
        """Return the ordinates with which a table of these k knots is closest to a function (least squares).

        Args:
            function: Function that maps m values of the variable, shape (m,), to shape (m,) or (m, columns).

        Returns:
            Ordinates, in the unit of the function, shape (k,) or (k, columns).
        """
        return np.asarray(self.projection @ function(self.fine))

    def whitening(self, rows: NDArray[np.bool_]) -> Array:
        """Return a matrix that makes the errors of some ordinates independent with variance 1, shape (r, r).

        It is the inverse of the lower Cholesky factor of their covariance.

        Args:
            rows: Mask of the r ordinates among all k, shape (k,).
        """
        factor = np.linalg.cholesky(self.error_covariance[np.ix_(rows, rows)])
        return np.asarray(np.linalg.inv(factor))


@dataclass(frozen=True)
class Formula:
    """Sum of terms with fitted parameters.

    Attributes:
        terms: The terms.
        amplitudes: Amplitudes of all columns, term after term, N or Nm divided by a power of the variable's
            unit.
        shapes: Shape parameters by term, in the unit of the variable.
        error: Root-mean-square error at knots that the formula was not fitted to (cross-validation), in
            standard deviations of the table's ordinates.
    """

    terms: tuple[Term, ...]
    amplitudes: tuple[float, ...]
    shapes: tuple[tuple[float, ...], ...]
    error: float

    @property
    def name(self) -> str:
        """Names of the terms in plain words, joined by plus signs."""
        return " + ".join(term.name for term in self.terms)

    @property
    def complexity(self) -> int:
        """Number of fitted parameters: amplitudes and shape parameters (centers, widths, periods)."""
        return sum(term.complexity for term in self.terms)

    def with_values(self, values: Iterable[float]) -> Formula:
        """Return a copy with other parameters and the same error.

        Args:
            values: Parameters, SI, term by term: for each term in `terms`, first its amplitudes, then its
                shape parameters (centers, widths, periods).
        """
        remaining = iter(values)
        amplitudes: list[float] = []
        shapes: list[tuple[float, ...]] = []
        for term in self.terms:
            amplitudes += [next(remaining) for _ in term.expressions]
            shapes.append(tuple(next(remaining) for _ in term.shapes))
        return dataclasses.replace(self, amplitudes=tuple(amplitudes), shapes=tuple(shapes))

    def __call__(self, u: Array) -> Array:
        """Return the force or friction level, N or Nm, at values `u` of the variable, SI, shape (n,) each."""
        columns = [
            term.values(u, np.array(shape)) for term, shape in zip(self.terms, self.shapes, strict=True)
        ]
        return np.asarray(np.concatenate(columns, axis=1) @ np.array(self.amplitudes))


def fit_formulas(curve: Curve, terms: Sequence[Term], count: int = 3) -> tuple[Formula, ...]:
    """Propose formulas for a tabulated curve: sums of terms that have a small error for their complexity.

    Returns:
        Formulas by increasing complexity (number of parameters). Each has a clearly smaller error at left-out
        knots (cross-validation) than all simpler ones (Pareto front). If there are fewer than `count`, other
        formulas of at most the same complexity are added.

    Raises:
        ImportError: If scikit-learn is not installed; the message names the extra `formulas`.
    """
    formulas = sorted(_Search(curve, terms).run(), key=lambda f: (f.complexity, f.error))
    smallest = min(f.error for f in formulas)
    front: list[Formula] = []
    rivals: list[Formula] = []
    for formula in (f for f in formulas if f.error < _HOPELESS * smallest):
        least = min((f.error for f in front), default=math.inf)
        # A formula joins the front if the simpler ones leave more than the uncertainty and it is clearly
        # better.
        if least > _EXPLAINED and formula.error < _CLEAR_GAIN * least:
            front.append(formula)
        else:
            rivals.append(formula)
    rivals = sorted((f for f in rivals if f.complexity <= front[-1].complexity), key=lambda f: f.error)
    chosen = front[-count:] + rivals[: max(0, count - len(front))]
    return tuple(sorted(chosen, key=lambda f: (f.complexity, f.error)))


class _Search:
    """Search for the formulas of a curve."""

    def __init__(self, curve: Curve, terms: Sequence[Term]) -> None:
        self._curve = curve
        low, high = float(curve.knots[0]), float(curve.knots[-1])
        self._span = high - low
        self._bounds = {
            "center": (low - 0.5 * self._span, high + 0.5 * self._span),
            "width": (0.005 * self._span, 20.0 * self._span),
            "period": (0.05 * self._span, 4.0 * self._span),
        }
        self._all = np.ones(len(curve.knots), bool)
        self._whitening = curve.whitening(self._all)
        self._target = self._whitening @ curve.values
        # term, shapes, whitened columns (k, c)
        self._dictionary: list[tuple[Term, tuple[float, ...], Array]] = []
        for term in terms:
            for shape in term.grid(low, high):
                columns = self._columns([term], [shape])
                if np.all(np.isfinite(columns)):
                    self._dictionary.append((term, shape, self._whitening @ columns))

    def run(self) -> list[Formula]:
        """Return validated formulas of one to three terms, at most one of every combination of terms."""
        fits = sorted((self._fitted([start]) for start in self._starts()), key=lambda fit: fit[0])
        supports: dict[tuple[str, ...], list[tuple[Term, tuple[float, ...]]]] = {}
        for _, single in fits[:_MAX_SINGLES]:
            for support in self._extended((single.terms[0], single.shapes[0])):
                if len(support) > 1 and not any(pair <= {t.name for t, _ in support} for pair in _REDUNDANT):
                    supports.setdefault(tuple(sorted(term.name for term, _ in support)), support)
        fits += [self._fitted(support) for support in supports.values()]
        smallest = min(size for size, _ in fits)
        return [self._validated(formula) for size, formula in fits if size <= _POOR * smallest]

    def _starts(self) -> list[tuple[Term, tuple[float, ...]]]:
        """Return the best starting values of each term alone."""
        best: dict[str, tuple[float, tuple[Term, tuple[float, ...]]]] = {}
        for term, shape, columns in self._dictionary:
            left = self._left(columns)
            if term.name not in best or left < best[term.name][0]:
                best[term.name] = (left, (term, shape))
        return [start for _, start in best.values()]

    def _fitted(self, support: Sequence[tuple[Term, tuple[float, ...]]]) -> tuple[float, Formula]:
        """Return the error that a formula leaves at all knots, and the formula, from its terms' start."""
        terms = tuple(term for term, _ in support)
        amplitudes, shapes = self._solve(terms, [shape for _, shape in support], self._all, self._whitening)
        missing = self._whitening @ self._columns(terms, shapes) @ amplitudes - self._target
        return float(np.linalg.norm(missing)), Formula(
            terms, tuple(amplitudes.tolist()), tuple(shapes), math.inf
        )

    def _left(self, columns: Array) -> float:
        """Return the squared error after the best fit of whitened columns."""
        basis, _ = np.linalg.qr(columns)
        return float(self._target @ self._target - np.sum((basis.T @ self._target) ** 2))

    def _extended(
        self, atom: tuple[Term, tuple[float, ...]]
    ) -> Iterable[list[tuple[Term, tuple[float, ...]]]]:
        """Yield the supports that orthogonal matching pursuit finds beside a first term."""
        orthogonal_mp = _import_orthogonal_mp()
        term, shape = atom
        basis, _ = np.linalg.qr(self._whitening @ self._columns([term], [shape]))
        owners = [(t, s) for t, s, columns in self._dictionary for _ in range(columns.shape[1])]
        atoms = np.concatenate([columns for _, _, columns in self._dictionary], axis=1)
        atoms = atoms - basis @ (basis.T @ atoms)  # what the first term leaves of them
        size = np.linalg.norm(atoms, axis=0)
        usable = size > 1e-6 * np.median(size)
        atoms, owners = atoms[:, usable] / size[usable], [o for o, u in zip(owners, usable, strict=True) if u]
        target = self._target - basis @ (basis.T @ self._target)
        for further in range(1, _MAX_TERMS):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # no column is left that improves the fit
                weights = np.atleast_1d(orthogonal_mp(atoms, target, n_nonzero_coefs=further))
            support = {term.name: (term, shape)}
            for index in np.flatnonzero(weights):
                support.setdefault(owners[index][0].name, owners[index])
            yield list(support.values())

    def _columns(self, terms: Sequence[Term], shapes: Sequence[Sequence[float]]) -> Array:
        """Return the ordinates of the tables closest to the columns of some terms, shape (k, columns)."""
        pairs = list(zip(terms, shapes, strict=True))
        return self._curve.projected(
            lambda u: np.concatenate([t.values(u, np.array(s)) for t, s in pairs], axis=1)
        )

    def _validated(self, formula: Formula) -> Formula:
        """Return a formula with its error: that of each fold of knots, fitted to the other folds.

        The errors of a table's ordinates are correlated, so the missing part of the fitted knots predicts
        that of the left-out ones (conditional mean of a Gaussian); what is left is in units of its
        conditional deviation.
        """
        squares, covariance = 0.0, self._curve.error_covariance
        for fold in range(_FOLDS):
            kept = np.arange(len(self._all)) % _FOLDS != fold
            amplitudes, shapes = self._solve(formula.terms, formula.shapes, kept, self._curve.whitening(kept))
            missing = self._curve.values - self._columns(formula.terms, shapes) @ amplitudes
            gain = np.linalg.solve(covariance[np.ix_(kept, kept)], covariance[np.ix_(kept, ~kept)]).T
            surprise = missing[~kept] - gain @ missing[kept]
            conditional = covariance[np.ix_(~kept, ~kept)] - gain @ covariance[np.ix_(kept, ~kept)]
            squares += float(surprise @ np.linalg.solve(conditional, surprise))
        return dataclasses.replace(formula, error=float(np.sqrt(squares / len(self._all))))

    def _solve(
        self,
        terms: Sequence[Term],
        start: Sequence[tuple[float, ...]],
        rows: NDArray[np.bool_],
        whitening: Array,
    ) -> tuple[Array, list[tuple[float, ...]]]:
        """Return amplitudes and shapes of the weighted least-squares fit to some knots."""
        target = whitening @ self._curve.values[rows]
        roles = [role for term in terms for role in term.shapes]
        log = np.array([role != "center" for role in roles], bool)

        edges = list(pairwise(accumulate((len(term.shapes) for term in terms), initial=0)))

        def shapes_of(x: Array) -> list[tuple[float, ...]]:
            plain = np.where(log, np.exp(np.where(log, x, 0.0)), x * self._span).tolist()
            return [tuple(plain[first:end]) for first, end in edges]

        def amplitudes_of(shapes: Sequence[tuple[float, ...]]) -> tuple[Array, Array]:
            columns = whitening @ self._columns(terms, shapes)[rows]
            amplitudes = np.linalg.lstsq(columns, target, rcond=1e-9)[0]
            return np.asarray(amplitudes, float), columns @ amplitudes - target

        flat = np.array([value for shape in start for value in shape], float)
        if not roles:
            return amplitudes_of(start)[0], list(start)
        x0 = np.where(log, np.log(np.where(log, flat, 1.0)), flat / self._span)
        limits = np.array([self._bounds[role] for role in roles])
        lower, upper = np.where(
            log[:, None], np.log(np.where(log[:, None], limits, 1.0)), limits / self._span
        ).T
        x0 = np.clip(x0, lower + 1e-9, upper - 1e-9)
        best = least_squares(lambda x: amplitudes_of(shapes_of(x))[1], x0, bounds=(lower, upper), max_nfev=40)
        shapes = shapes_of(best.x)
        return amplitudes_of(shapes)[0], shapes


def _import_orthogonal_mp() -> Any:
    """Return scikit-learn's orthogonal matching pursuit."""
    with naming_extra("formulas", "formulas need scikit-learn"):
        from sklearn.linear_model import orthogonal_mp
    return orthogonal_mp
