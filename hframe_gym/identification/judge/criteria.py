"""The thresholds of identification that users can change: effort of the search, and decisions.

Chi-squared per sample is the mean of the squared residuals in units of the sensors' noise; 1 means that only
noise is left. The gain of an effect is the reduction of chi-squared per sample that it causes. What a model
leaves of the error is correlated in time, so tests that assume white noise accept effects that do not exist;
the minimum gains below were calibrated on synthetic rigs without any effect
(``benchmarks/identification.py``).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass


@dataclass(frozen=True)
class SearchEffort:
    """How much the search tries. A smaller effort may miss an effect; the same tests judge what it tries.

    The linearized gain of a candidate is predicted from the derivatives of the residual before any fit. A
    structural candidate replaces a part of the model: it adds coordinates or replaces dry friction.

    Attributes:
        min_trial_gain: Fraction of the required gain that a trial fit (first few iterations) must reach for
            the fit to be continued.
        max_effects: Largest number of effects that the forward selection adds.
        max_full_fits: Number of effects at their sites that are fitted together with all parameters of the
            machine, per step; each from up to two sets of starting values.
        min_promise: Smallest linearized gain, relative to the best candidate's, for which a candidate is
            fitted.
        rival_promise: Once a fitted candidate explains the data, smallest linearized gain, relative to that
            of this candidate, for which another candidate is fitted as its possible rival.
        min_structural_promise: Smallest linearized gain of a structural candidate relative to the best fitted
            gain of the others.
        min_promised_force_ratio: As `min_force_ratio`, for the linearized size of a candidate that is not
            fitted yet.
        linear_gain_ratio: Smallest linearized gain, relative to the required gain, for which a candidate is
            fitted. It is below 1 because the fitted gain may exceed the linearized one.
        rival_remainder: Largest fraction of the excess that a candidate may leave to explain the data. The
            excess is chi-squared per sample minus its value for an exact machine. Once a candidate explains
            the data, only its possible rivals are fitted as well.
        structural_remainder: Structural candidates are tried only if every other candidate leaves more than
            this fraction of the excess, because their simulations must first be compiled.
        structural_retry: If no effect was selected when structural candidates were last tried, they are tried
            again only after chi-squared per sample - 1 has fallen below this fraction of its value then.
        max_screened_tables: Number of screened tables that are cross-validated.
        max_tables_per_coordinate: Number of tables per coordinate that are screened, in addition to one over
            time and one over the coordinate's position.
        cross_validation_blocks: Smallest number of pieces into which all runs together are divided to
            cross-validate a table. Each run is divided into at least two.
        max_drift: Largest ratio of simulation error to standard deviation of the measurements at which
            formulas for a table are compared in simulation. Above it, they are compared in one-step
            prediction.
    """

    min_trial_gain: float = 0.5
    max_effects: int = 5
    max_full_fits: int = 6
    min_promise: float = 0.4
    rival_promise: float = 0.8
    min_structural_promise: float = 0.1
    min_promised_force_ratio: float = 0.5
    linear_gain_ratio: float = 0.6
    rival_remainder: float = 0.2
    structural_remainder: float = 0.5
    structural_retry: float = 0.67
    max_screened_tables: int = 6
    max_tables_per_coordinate: int = 3
    cross_validation_blocks: int = 8
    max_drift: float = 0.3

    def __post_init__(self) -> None:
        """Check the thresholds.

        Raises:
            ValueError: If a threshold is negative or not finite.
        """
        for name, value in self.as_json().items():
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"criterion {name} is {value}; it must be finite and not negative")

    def __str__(self) -> str:
        """Return all thresholds as text, one "name = value" per line."""
        return "\n".join(f"{name} = {value:g}" for name, value in self.as_json().items())

    def as_json(self) -> dict[str, float]:
        """Convert the thresholds to a dictionary, which report.json contains as `criteria`.

        Returns:
            Value of each threshold by its attribute name, for example "min_gain"; all are dimensionless.
        """
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class SelectionCriteria(SearchEffort):
    """Thresholds by which `identify` selects effects and reaches its verdict.

    Chi-squared per sample is the mean squared residual in units of the sensors' noise (1: only noise is
    left). The gain of an effect is the reduction of chi-squared per sample that it causes. The cost is
    chi-squared summed over all samples. A table is a force or friction level that is interpolated over one
    variable. In simulation, measurements only give the initial state; in one-step prediction, an observer
    corrects the state by the measurements at every sample.

    Pass a changed copy to `identify(..., criteria=SelectionCriteria(max_effects=3))`. `print` shows all
    values.

    Attributes:
        min_gain: Smallest gain of an effect, chi-squared per sample: 0.5 % of the root mean square error at
            the noise. Rigs without effects stay below it with every observer. The search ends where less is
            left.
        chance: Probability with which an effect that does not exist seems to exist. Some hundred candidates
            in up to ten steps are compared, so that one of a thousand searches finds one by chance.
        min_gain_fraction: Smallest gain relative to chi-squared per sample - 1, the error beyond the noise.
            An effect that removes less is a substitute for the true one.
        rival_gain_fraction: Fraction of the best candidate's gain above which another candidate counts as its
            rival.
        min_confirmed_fraction: Smallest fraction of an effect's gain that remains if its parameters are
            fitted to the other runs (leave-one-run-out), and those of the machine to all runs beside them.
        min_force_ratio: Smallest force of an effect relative to the force that remains unexplained beside it.
        max_form_error: Ratio of the forces of two effects that depend on the same variable of the same
            component, but are of different families. If the ratio is smaller, the smaller effect is rejected:
            it may only correct an error in the formula of the larger one.
        max_table_cross_validation: Largest cost of data to which a table was not fitted, relative to the cost
            without the table: a geometric mean over pieces of the runs.
        explained_chi2: Chi-squared per sample below which the model explains the data.
        max_partial_excess: Selected effects that leave more than noise are reported if they reduce the error
            beyond the noise to less than this fraction of the refitted machine's. It suffices that one of two
            errors falls so far: chi-squared per sample - that of an exact machine in one-step prediction, or
            the root mean square error in simulation. The held-out runs hold the same limit against the names
            of effects that are the causes of the missing force; those of a real axis (EMPS) leave 0.11.
        max_noise_ratio_explained: Largest simulation error on the held-out runs, in multiples of the sensors'
            noise at rest, that noise explains: the verdict "no_effect" is not given above it. A correct
            machine reaches 1; its uncertain initial states and a clock that jitters by some microseconds
            leave up to 2.
        max_motion_error: Largest simulation error beyond the noise on the held-out runs, relative to the
            motion, for the verdict "no_effect". If the noise may hide more, the recordings cannot show what
            is missing.
        max_remaining: Largest fraction of the squared prediction error beyond the noise, on the held-out runs
            and with an observer of 15 rad/s, that effects may leave to be named if they do not explain the
            fitted runs. Three wrong names for a torque constant that falls with the current left 0.10, two
            for friction that rises with the time at rest 0.07; Stribeck friction beside a log that misses the
            voltages between its rows leaves 0.01.
    """

    min_gain: float = 0.01
    chance: float = 1e-6
    min_gain_fraction: float = 0.1
    rival_gain_fraction: float = 0.97
    min_confirmed_fraction: float = 0.3
    min_force_ratio: float = 1.0
    max_form_error: float = 0.2
    max_table_cross_validation: float = 0.4
    explained_chi2: float = 1.5
    max_partial_excess: float = 0.25
    max_noise_ratio_explained: float = 2.0
    max_motion_error: float = 0.1
    max_remaining: float = 0.03
