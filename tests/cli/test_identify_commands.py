"""The command `identify`: what it adds to a result from the check of the recordings."""

from __future__ import annotations

import dataclasses

from hframe_gym.cli.identify_commands import _with_late_currents
from hframe_gym.identification.report.content.document import UnknownVoltages
from tests.data_validation.test_current_timing import axis, recording
from tests.identification.report.axis_results import STRIBECK, result_of
from tests.identification.single_axis import axis_runs


def test_a_result_names_the_currents_that_make_a_log_look_slow() -> None:
    """A current that is read one row too early looks like a controller that is faster than the log."""
    unknown = UnknownVoltages(changes_per_row=2, period_s=5e-4, errors={}, fitted_by="white residual")
    of_slow_log = result_of(axis_runs(STRIBECK, rows=500, volts=2.0), "no_effect", STRIBECK)
    of_slow_log = dataclasses.replace(of_slow_log, unknown_voltages=unknown)
    for rows_early, named in ((1, ["motor_A"]), (0, [])):
        result = _with_late_currents(of_slow_log, [recording(axis(), rows_early=rows_early)], axis())
        assert result.unknown_voltages is not None
        assert result.unknown_voltages.late_currents == named
