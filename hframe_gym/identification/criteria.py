"""The decision thresholds of identification, in one place.

Chi-squared per sample is the mean of the squared residuals in units of the sensors' noise; 1 means that only noise is
left. The gain of an effect is the reduction of chi-squared per sample that it causes. What a model leaves of the error
is correlated in time, so tests that assume white noise accept effects that do not exist; the minimum gains below were
calibrated on synthetic rigs without any effect (``benchmarks/identification.py``).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass


@dataclass(frozen=True)
class SelectionCriteria:
    """Thresholds by which `identify` selects effects and reaches its verdict.

    Chi-squared per sample is the mean squared residual in units of the sensors' noise (1: only noise is left). The gain
    of an effect is the reduction of chi-squared per sample that it causes. The cost is chi-squared summed over all
    samples. A linearized gain is predicted from the derivatives of the residual before any fit. A structural candidate
    is an effect that replaces a part of the model: it adds coordinates or replaces dry friction. A table is a force or
    friction level that is interpolated over one variable. In simulation, measurements only give the initial state; in
    one-step prediction, an observer corrects the state by the measurements at every sample.

    Pass a changed copy to `identify(..., criteria=SelectionCriteria(max_effects=3))`. `print` shows all values.

    Attributes:
        min_gain_simulation: Smallest gain of an effect in simulation, chi-squared per sample. Rigs without effects stay
            below it.
        min_gain_one_step: Smallest gain in one-step prediction, chi-squared per sample. It is larger than in simulation
            because the residual of the observer is correlated.
        min_total_gain: Smallest gain summed over all samples, chi-squared. It protects short recordings, where chance
            explains a larger fraction of the residual.
        min_chance_gain: Smallest gain summed over all samples in units of the long-run variance of the remaining
            residual along the effect's influence: what the best of some hundred candidates with a few parameters
            reaches by chance.
        min_gain_fraction: Smallest gain relative to the excess of chi-squared per sample over 1: an effect that removes
            less is a substitute for the true one.
        rival_gain_fraction: Fraction of the best candidate's gain above which another candidate counts as its rival.
        rival_gain_margin: Difference of chi-squared per sample below which two candidates are rivals.
        noise_level: Chi-squared per sample at which the search stops, because nothing but noise is left.
        min_trial_gain: Fraction of the smallest gain that the first few iterations of a fit must reach.
        min_confirmed_fraction: Smallest fraction of an effect's gain that remains if the parameters are fitted to the
            other runs (leave-one-run-out).
        min_force_ratio: Smallest force of an effect relative to the force that remains unexplained beside it.
        min_drive_force_ratio: Smallest force of an effect relative to that of the drives. Amplifiers and numerical
            integration have larger errors.
        max_form_error: Force that an effect adds, relative to that of an effect of another family which depends on the
            same variable of the same component, below which it counts as an error in the form of the other.
        max_effects: Largest number of effects that the forward selection adds.
        max_full_fits: Number of screened candidates that are fitted together with all parameters of the machine, per
            step.
        min_promise: Smallest linearized gain relative to the best candidate's for which a full fit is tried.
        rival_promise: Smallest linearized gain, relative to that of a candidate which explains the data, for which
            another candidate is fitted as its possible rival.
        min_structural_promise: Smallest linearized gain of a structural candidate relative to the best fitted gain of
            the others.
        min_promised_force_ratio: As `min_force_ratio`, for the linearized size of a candidate that is not fitted yet.
        linear_gain_ratio: Ratio of linearized to fitted gain that is still expected; screened gains below this times
            the minimum gain are not fitted.
        one_step_floor: Chi-squared per sample that a correct model reaches in one-step prediction; quantization keeps
            it above 1.
        rival_remainder: Fraction of the excess over `one_step_floor` below which a candidate explains the data, so that
            only its possible rivals are fitted as well.
        structural_remainder: Fraction of that excess that every candidate must leave before structural candidates are
            tried, whose simulations must be compiled.
        min_structural_excess: Smallest excess of chi-squared per sample for which structural candidates are tried.
        structural_retry: Excess of chi-squared per sample, relative to that at the last trial of structural candidates,
            below which they are tried again.
        min_table_gain: Smallest gain of a table, chi-squared per sample. A table has two dozen values and fits chance
            well.
        min_table_gain_fraction: Smallest gain of a table relative to the excess over `one_step_floor`.
        max_screened_tables: Number of screened tables that are cross-validated.
        max_tables_per_coordinate: Number of tables per coordinate that are screened, in addition to one over time and
            one over the coordinate's position.
        max_table_cross_validation: Largest cost of data to which a table was not fitted, relative to the cost without
            the table.
        cross_validation_blocks: Smallest number of parts of all runs, left out of the fit of a table in turn. Each run
            has at least two.
        max_drift: Simulation error relative to the standard deviation of the signal above which formulas for a table
            are compared in one-step prediction instead of simulation.
        explained_chi2: Chi-squared per sample below which the model explains the data.
        max_residue_bandwidth: Largest bandwidth, rad/s, of the most likely observer at which a machine without effects
            explains the data. Where the widest observer of 60 rad/s is needed, forces of unknown size are missing.
        explained_fraction: Fraction of the initial chi-squared per sample below which the model explains the data,
            where the initial value is large.
        max_table_cost_fraction: Cost relative to the best model of known effects below which a table is accepted
            although the residual is not yet noise.
        max_table_cost_of_several_effects: Cost relative to that of two or more known effects below which a single table
            replaces them; `max_table_cost_fraction` then applies to the cost of the refitted machine alone.
        max_partial_excess: Error beyond the noise, relative to that of the refitted model, below which known effects
            are reported although they leave more than noise: excess of chi-squared per sample over `one_step_floor`, or
            root mean square error in simulation.
        min_saturated_fraction: Smallest fraction of all rows at the outermost measurement that indicates the end of a
            sensor's range.
        second_end_factor: Factor on the two saturation thresholds for the other end of a sensor that saturates at one
            end.
        saturation_band: Width of the outermost measurements that count as constant, in standard deviations of the
            noise.
        min_saturated_travel: Distance that the encoders measure while a saturated sensor is constant, in standard
            deviations of its noise; more than belts can stretch.
    """

    min_gain_simulation: float = 0.003
    min_gain_one_step: float = 0.01
    min_total_gain: float = 200.0
    min_chance_gain: float = 30.0
    min_gain_fraction: float = 0.1
    rival_gain_fraction: float = 0.97
    rival_gain_margin: float = 0.002
    noise_level: float = 1.01
    min_trial_gain: float = 0.5
    min_confirmed_fraction: float = 0.3
    min_force_ratio: float = 1.0
    min_drive_force_ratio: float = 2e-5
    max_form_error: float = 0.2
    max_effects: int = 5
    max_full_fits: int = 5
    min_promise: float = 0.4
    rival_promise: float = 0.8
    min_structural_promise: float = 0.1
    min_promised_force_ratio: float = 0.5
    linear_gain_ratio: float = 0.6
    one_step_floor: float = 1.1
    rival_remainder: float = 0.2
    structural_remainder: float = 0.5
    min_structural_excess: float = 0.05
    structural_retry: float = 0.67
    min_table_gain: float = 0.02
    min_table_gain_fraction: float = 0.2
    max_screened_tables: int = 6
    max_tables_per_coordinate: int = 3
    max_table_cross_validation: float = 0.4
    cross_validation_blocks: int = 8
    max_drift: float = 0.3
    explained_chi2: float = 1.5
    max_residue_bandwidth: float = 30.0
    explained_fraction: float = 1e-4
    max_table_cost_fraction: float = 0.1
    max_table_cost_of_several_effects: float = 0.5
    max_partial_excess: float = 0.25
    min_saturated_fraction: float = 0.01
    second_end_factor: float = 0.2
    saturation_band: float = 8.0
    min_saturated_travel: float = 300.0

    def __post_init__(self) -> None:
        """Check the thresholds.

        Raises:
            ValueError: If a threshold is negative or not finite.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"criterion {field.name} is {value}; it must be finite and not negative")

    def __str__(self) -> str:
        """Return all thresholds as text, one "name = value" per line."""
        return "\n".join(f"{name} = {value:g}" for name, value in self.as_json().items())

    def as_json(self) -> dict[str, float]:
        """Convert the thresholds to a dictionary, which report.json contains as `criteria`.

        Returns:
            Value of each threshold by its attribute name, for example "min_gain_simulation"; all are dimensionless.
        """
        return dataclasses.asdict(self)
