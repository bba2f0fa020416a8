"""The content of report.json, declared once for writing and reading.

Fields with a default are missing in results of older versions. Text is for the user; labels are name@site.
"""

from __future__ import annotations

import math
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ...judge.verdict import Verdict

SCHEMA: Final = 1
STAGES = ("declared", "before", "after")  # keys of the three machines in report.json


class ReportPart(BaseModel):
    """Part of report.json; unknown fields, of later versions, are ignored."""

    model_config = ConfigDict(extra="ignore", strict=True)

    def as_json(self) -> dict[str, Any]:
        """Return the fields that have been set as plain data for JSON, in the order of their declaration."""
        return self.model_dump(by_alias=True, exclude_unset=True)


class Runs(ReportPart):
    """Names of the runs."""

    fitted: list[str]
    held_out: list[str] = Field(min_length=1)


class UnfinishedSearch(ReportPart):
    """What a search did when it ended before it was complete, and why it ended."""

    stage: str
    reason: str


class UnknownVoltages(ReportPart):
    """Voltages between the rows of a log that is slower than its controller, and their effect in simulation.

    Attributes:
        commands: Name of the inputs, such as "voltages" (`Machine.commands_in_words`).
        changes_per_row: How many times the controller changes them from one row to the next.
        period_s: Time from one change to the next, s.
        errors: Root mean square error of a simulation of the held-out runs that this alone causes, by
            channel, in the channel's unit.
        fitted_by: Method that fitted the delivered machine: instrumental variables (`fit.slow_logs`), or
            least squares with a residual that the statistics of the voltages make white.
        late_currents: Channels of measured currents that respond to the voltage of their own row. Read after
            that voltage had been applied, they make a log look slower than its controller.
    """

    commands: str = "voltages"
    changes_per_row: int
    period_s: FiniteFloat
    errors: dict[str, FiniteFloat]
    fitted_by: Literal["instruments", "white residual"]
    late_currents: list[str] = []


class ChannelErrors(ReportPart):
    """Simulation error of one channel, in its unit, relative to the noise, and in percent of the motion."""

    rmse: FiniteFloat | None
    noise_ratio: FiniteFloat | None
    percent_of_motion: FiniteFloat | None = None


class Force(ReportPart):
    """A force in N, or a torque in Nm on a rotary axis."""

    value: FiniteFloat
    unit: str


class Evaluation(ReportPart):
    """Errors of a machine on the held-out runs: by channel, and `force_error` where the machine has one.

    Attributes:
        missing_force_percent: Missing force in percent of the drives' force, rms; None if unknown, or if the
            commands do not determine the force, as set points.
        missing_force: The missing force in N or Nm.
    """

    held_out: dict[str, ChannelErrors | FiniteFloat]
    missing_force_percent: FiniteFloat | None = None
    missing_force: Force | None = None

    @property
    def channels(self) -> dict[str, ChannelErrors]:
        """Simulation errors by name of the output channel, without `force_error`."""
        return {name: error for name, error in self.held_out.items() if isinstance(error, ChannelErrors)}

    @property
    def force_error(self) -> float | None:
        """Error of the drives' force by inverse dynamics / this force, rms, dimensionless, or None."""
        error = self.held_out.get("force_error")
        return None if isinstance(error, ChannelErrors) else error

    @property
    def noise_ratio(self) -> float | None:
        """Ratio of simulation error to noise, rms over the channels; None if no channel has an error."""
        ratios = [error.noise_ratio for error in self.channels.values() if error.noise_ratio is not None]
        return math.sqrt(sum(ratio**2 for ratio in ratios) / len(ratios)) if ratios else None

    @property
    def percents_of_motion(self) -> list[float]:
        """Simulation errors in percent of the motion, one of each channel that moves."""
        percents = (error.percent_of_motion for error in self.channels.values())
        return [percent for percent in percents if percent is not None]


class Plain(Evaluation):
    """Errors of the plain fit, its terms beside inertia and friction, and whether it is delivered."""

    terms: list[str] = []
    delivered: bool = False


class ParameterValue(ReportPart):
    """Value and standard deviation of an effect's parameter, in its unit.

    Attributes:
        at_least: Lower end of the 95 % interval of a time constant, where the runs are too short to show the
            upper one.
    """

    value: FiniteFloat
    std: FiniteFloat | None
    unit: str
    at_least: FiniteFloat | None = None


class Effect(ReportPart):
    """A selected effect.

    Attributes:
        size: Force of the effect relative to that of the drives; None if no force describes it.
        held_out_gain: Fraction of the squared error of the held-out runs that it removes.
        rivals: Labels of effects that explain the runs equally well.
    """

    name: str
    family: str = ""
    site: str
    parameters: dict[str, ParameterValue]
    size: FiniteFloat | None = None
    held_out_gain: FiniteFloat
    rivals: list[str]


class Dependence(ReportPart):
    """A variable on which the residual force of a component depends, and the fraction that it explains."""

    variable: str
    coordinate: str
    component: str = ""
    share: FiniteFloat


class Residual(ReportPart):
    """What the residual depends on, strongest first, whether it is noise, and sensors deviating alone."""

    depends_on: list[Dependence]
    white: bool
    sensors: list[str] = []


class Hint(ReportPart):
    """What the force that a machine lacks depends on, where no effect of the library is named.

    Attributes:
        component: Coordinate on which the force acts, or the channel of the sensor that deviates alone.
        variable: Variable on which it depends most, for example "current of motor1".
        share: Fraction of its variance that a curve over this variable explains, beyond noise.
        nearest: Labels of effects that describe a part of it: neighbors in kind, no causes.
    """

    component: str
    variable: str
    share: FiniteFloat
    nearest: list[str]


class Considered(ReportPart):
    """An effect that was tried and rejected, with the reason, a clause that follows "it "."""

    name: str
    site: str
    parameters: dict[str, FiniteFloat] = {}
    size: FiniteFloat | None
    held_out_gain: FiniteFloat | None
    reason: str


class DeterminedSum(ReportPart):
    """Weighted sum of parameters that the data determine, in the unit of its first, whose weight is 1."""

    weights: dict[str, FiniteFloat]
    value: FiniteFloat
    std: FiniteFloat


class NotSeparable(ReportPart):
    """Parameters that the data do not separate, and the sums that they determine."""

    parameters: list[str]
    determined: list[DeterminedSum]


class UndeclaredFriction(ReportPart):
    """Friction that the machine file does not declare; its share of drive force if it is dry friction."""

    parameter: str
    value: FiniteFloat
    std: FiniteFloat | None
    unit: str
    percent_of_drives: FiniteFloat | None


class Experiment(ReportPart):
    """The proposed run: the effects that it separates, the file with its commands, and its purpose."""

    separates: list[str] = []
    file: str
    why: str


class Formula(ReportPart):
    """A formula that may replace a table.

    Attributes:
        table: Label of the table.
        terms: Names of the terms.
        formula: The equation as text.
        parameters: Values by name, SI.
        complexity: Number of parameters.
        curve_error: rms error at values of the table that were left out of the fit, in their standard
            deviations.
        fitted: rms error of the machine with it on the fitted runs, in units of the sensors' noise.
        held_out: The same on the held-out runs, by channel.
        recommended: Whether it is the recommended one.
    """

    table: str = ""
    terms: list[str]
    formula: str
    parameters: dict[str, FiniteFloat]
    complexity: int
    curve_error: FiniteFloat
    fitted: FiniteFloat | None
    held_out: dict[str, FiniteFloat]
    recommended: bool


class TableOfFormulas(ReportPart):
    """A table, its errors as those of a formula, and the formulas proposed for it."""

    table: str
    complexity: int
    fitted: FiniteFloat
    held_out: dict[str, FiniteFloat]
    formulas: list[Formula]


class File(ReportPart):
    """A file of recordings."""

    name: str
    bytes: int
    sha256: str


class Made(ReportPart):
    """Where a result comes from: package and version, time in UTC by ISO 8601, and the recordings."""

    software: str
    time: str
    by: str = ""
    files: list[File] = []


class Report(ReportPart):
    """Content of report.json.

    Attributes:
        explained: Fraction of the squared error of the held-out runs beyond noise that the effects remove.
        left: Simulation error / noise that remains on the held-out runs.
        left_in_others: The same on those that do not contradict the fitted runs (`contradicting`).
        unstable: Whether an unstable motion is the cause of `left`: predictions are those of an exact
            machine.
        rounded_stamps: Whether the rounding of the time stamps may be the cause of `left`.
        seconds: Duration of the identification, s.
        warnings: What limits the result, and findings about the recordings, one sentence each.
    """

    version: Literal[1] = Field(alias="schema")
    verdict: Verdict
    runs: Runs
    reason: str = ""
    unfinished: UnfinishedSearch | None = None
    unknown_voltages: UnknownVoltages | None = None
    contradicting: list[str] = []
    declared: Evaluation
    before: Evaluation
    after: Evaluation
    plain: Plain | None = None
    effects: list[Effect]
    residual: Residual
    explained: FiniteFloat | None = None
    left: FiniteFloat | None = None
    left_in_others: FiniteFloat | None = None
    unstable: bool = False
    rounded_stamps: bool = False
    hint: Hint | None = None
    considered: list[Considered] = []
    not_separable: list[NotSeparable] = []
    undeclared_friction: list[UndeclaredFriction] = []
    next_experiment: Experiment | None
    seconds: FiniteFloat
    criteria: dict[str, int | FiniteFloat] = {}
    warnings: list[str] = []
    proposed_formulas: list[TableOfFormulas] = []
    made: Made | None = None

    @property
    def machines(self) -> dict[str, Evaluation]:
        """All machines with their errors, by key: those of `STAGES`, and "plain" for a plain fit.

        `STAGES` are "declared", "before" (refitted) and "after" (delivered).
        """
        machines = {stage: getattr(self, stage) for stage in STAGES}
        return machines | ({"plain": self.plain} if self.plain else {})

    @property
    def channels(self) -> list[str]:
        """Names of the output channels, in the order of the machine."""
        return list(self.declared.channels)

    def noise_of(self, channel: str) -> float | None:
        """Return the standard deviation of a sensor's noise, in the channel's unit.

        It follows from an error in this unit and in multiples of the noise. It is therefore None for a
        channel without measurements, or if every machine diverges.

        Args:
            channel: Name of an output channel of the report.
        """
        for stage in reversed(STAGES):
            error = self.machines[stage].channels[channel]
            if error.rmse and error.noise_ratio:
                return error.rmse / error.noise_ratio
        return None


def compared_machines(report: Report) -> dict[str, str]:
    """Return the machines that the report compares, with their labels, in the order of display.

    Returns:
        Labels by key of the machine: "declared"; "plain", if there is a plain fit; "before", the refitted
        machine; and "after", the machine that is delivered, if it is not the refitted one.
    """
    labels = {"declared": "as declared", "plain": "plain fit", "before": "refitted"}
    if not report.plain:
        del labels["plain"]
    if report.effects or report.after.held_out != report.before.held_out:
        labels["after"] = "with effects" if report.effects else "delivered"
    return labels
