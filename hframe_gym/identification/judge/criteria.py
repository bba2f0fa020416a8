"""The thresholds of identification that users can change: effort of the search, and decisions.

Chi-squared per sample is the mean of the squared residuals in units of the sensors' noise; 1 means that only noise is
left. The gain of an effect is the reduction of chi-squared per sample that it causes. What a model leaves of the error
is correlated in time, so tests that assume white noise accept effects that do not exist; the minimum gains below were
calibrated on synthetic rigs without any effect (``benchmarks/identification.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

from ...preparation.criteria import SaturationCriteria


@dataclass(frozen=True)
class SearchEffort(SaturationCriteria):
    """How much the search tries. A smaller effort may miss an effect; the same tests judge what it tries.

    The linearized gain of a candidate is predicted from the derivatives of the residual before any fit. A structural
    candidate replaces a part of the model: it adds coordinates or replaces dry friction.

    Attributes:
        min_trial_gain: Fraction of the required gain that a trial fit (first few iterations) must reach for the fit to
            be continued.
        max_effects: Largest number of effects that the forward selection adds.
        max_full_fits: Number of screened candidates that are fitted together with all parameters of the machine, per
            step.
        min_promise: Smallest linearized gain, relative to the best candidate's, for which a candidate is fitted.
        rival_promise: Once a fitted candidate explains the data, smallest linearized gain, relative to that of this
            candidate, for which another candidate is fitted as its possible rival.
        min_structural_promise: Smallest linearized gain of a structural candidate relative to the best fitted gain of
            the others.
        min_promised_force_ratio: As `min_force_ratio`, for the linearized size of a candidate that is not fitted yet.
        linear_gain_ratio: Smallest linearized gain, relative to the required gain, for which a candidate is fitted. It
            is below 1 because the fitted gain may exceed the linearized one.
        rival_remainder: Largest fraction of the excess that a candidate may leave to explain the data. The excess is
            chi-squared per sample minus its value for a correct model (1, or `one_step_floor`). Once a candidate
            explains the data, only its possible rivals are fitted as well.
        structural_remainder: Structural candidates are tried only if every other candidate leaves more than this
            fraction of the excess, because their simulations must first be compiled.
        min_structural_excess: Smallest excess for which structural candidates are tried.
        structural_retry: If no effect was selected when structural candidates were last tried, they are tried again
            only after chi-squared per sample - 1 has fallen below this fraction of its value then.
        max_screened_tables: Number of screened tables that are cross-validated.
        max_tables_per_coordinate: Number of tables per coordinate that are screened, in addition to one over time and
            one over the coordinate's position.
        cross_validation_blocks: Smallest number of pieces into which all runs together are divided to cross-validate a
            table. Each run is divided into at least two.
        max_drift: Largest ratio of simulation error to standard deviation of the measurements at which formulas for a
            table are compared in simulation. Above it, they are compared in one-step prediction.
    """

    min_trial_gain: float = 0.5
    max_effects: int = 5
    max_full_fits: int = 5
    min_promise: float = 0.4
    rival_promise: float = 0.8
    min_structural_promise: float = 0.1
    min_promised_force_ratio: float = 0.5
    linear_gain_ratio: float = 0.6
    rival_remainder: float = 0.2
    structural_remainder: float = 0.5
    min_structural_excess: float = 0.05
    structural_retry: float = 0.67
    max_screened_tables: int = 6
    max_tables_per_coordinate: int = 3
    cross_validation_blocks: int = 8
    max_drift: float = 0.3


@dataclass(frozen=True)
class SelectionCriteria(SearchEffort):
    """Thresholds by which `identify` selects effects and reaches its verdict.

    Chi-squared per sample is the mean squared residual in units of the sensors' noise (1: only noise is left). The gain
    of an effect is the reduction of chi-squared per sample that it causes. The cost is chi-squared summed over all
    samples. A table is a force or friction level that is interpolated over one variable. In simulation, measurements
    only give the initial state; in one-step prediction, an observer corrects the state by the measurements at every
    sample.

    Pass a changed copy to `identify(..., criteria=SelectionCriteria(max_effects=3))`. `print` shows all values.

    Attributes:
        min_gain_simulation: Smallest gain of an effect in simulation, chi-squared per sample. Rigs without effects stay
            below it.
        min_gain_one_step: Smallest gain in one-step prediction, chi-squared per sample. It is larger than in simulation
            because the residual of the observer is correlated.
        min_total_gain: Smallest gain summed over all samples, chi-squared. It protects short recordings, where chance
            explains a larger fraction of the residual.
        min_chance_gain: Smallest gain summed over all samples, divided by the long-run variance of the remaining
            residual (`significance.long_run_variance`). The best of some hundred candidates with a few parameters
            reaches this value by chance.
        min_gain_fraction: Smallest gain relative to chi-squared per sample - 1, the error beyond the noise. An effect
            that removes less is a substitute for the true one.
        rival_gain_fraction: Fraction of the best candidate's gain above which another candidate counts as its rival.
        rival_gain_margin: Difference of chi-squared per sample below which two candidates are rivals.
        noise_level: Chi-squared per sample at which the search stops, because nothing but noise is left.
        min_confirmed_fraction: Smallest fraction of an effect's gain that remains if the parameters are fitted to the
            other runs (leave-one-run-out).
        min_force_ratio: Smallest force of an effect relative to the force that remains unexplained beside it.
        min_drive_force_ratio: Smallest force of an effect relative to that of the drives. Amplifiers and numerical
            integration have larger errors.
        max_form_error: Ratio of the forces of two effects that depend on the same variable of the same component, but
            are of different families. If the ratio is smaller, the smaller effect is rejected: it may only correct an
            error in the formula of the larger one.
        one_step_floor: Chi-squared per sample that a correct model reaches in one-step prediction; quantization keeps
            it above 1.
        min_table_gain: Smallest gain of a table, chi-squared per sample. A table has two dozen values and fits chance
            well.
        min_table_gain_fraction: Smallest gain of a table relative to the excess over `one_step_floor`.
        max_table_cross_validation: Largest cost of data to which a table was not fitted, relative to the cost without
            the table: a geometric mean over pieces of the runs.
        explained_chi2: Chi-squared per sample below which the model explains the data.
        explained_fraction: Fraction of the initial chi-squared per sample below which the model explains the data,
            where the initial value is large.
        max_partial_excess: Selected effects that leave more than noise are reported if they reduce the error beyond the
            noise to less than this fraction of the refitted machine's. It suffices that one of two errors falls so far:
            chi-squared per sample - `one_step_floor` in one-step prediction, or the root mean square error in
            simulation. The held-out runs hold the same limit against the names of effects that are the causes of the
            missing force; those of a real axis (EMPS) leave 0.11.
        max_noise_ratio_explained: Largest simulation error on the held-out runs, in multiples of the sensors' noise at
            rest, that noise explains: the verdict "no_effect" is not given above it. A correct machine reaches 1; its
            uncertain initial states and a clock that jitters by some microseconds leave up to 2.
        max_motion_error: Largest simulation error on the held-out runs, relative to the motion, for the verdict
            "no_effect". If the noise is larger, the recordings cannot show whether an effect is missing.
        max_remaining: Largest fraction of the squared prediction error beyond the noise, on the held-out runs and with
            an observer of 15 rad/s, that effects may leave to be named if they do not explain the fitted runs. Three
            wrong names for a torque constant that falls with the current left 0.10, two for friction that rises with
            the time at rest 0.07; Stribeck friction beside a log that misses the voltages between its rows leaves 0.01.
    """

    min_gain_simulation: float = 0.003
    min_gain_one_step: float = 0.01
    min_total_gain: float = 200.0
    min_chance_gain: float = 30.0
    min_gain_fraction: float = 0.1
    rival_gain_fraction: float = 0.97
    rival_gain_margin: float = 0.002
    noise_level: float = 1.01
    min_confirmed_fraction: float = 0.3
    min_force_ratio: float = 1.0
    min_drive_force_ratio: float = 2e-5
    max_form_error: float = 0.2
    one_step_floor: float = 1.1
    min_table_gain: float = 0.02
    min_table_gain_fraction: float = 0.2
    max_table_cross_validation: float = 0.4
    explained_chi2: float = 1.5
    explained_fraction: float = 1e-4
    max_partial_excess: float = 0.25
    max_noise_ratio_explained: float = 2.0
    max_motion_error: float = 0.1
    max_remaining: float = 0.03
