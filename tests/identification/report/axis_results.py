"""Results of a single axis that are put together by hand, and their pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hframe_gym.effects import EFFECTS, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.identification import Dataset, IdentificationResult, write_result
from hframe_gym.identification.propose.dependences import Dependence
from hframe_gym.identification.report.content.document import Report
from hframe_gym.identification.report.content.result import Verdict
from hframe_gym.identification.report.diagnostics.experiment_design import ExperimentDesign
from hframe_gym.identification.report.page import build_report
from hframe_gym.machine import Machine, Uncertainty
from tests.identification.single_axis import AXIS, PRESLIDING, axis_result

STRIBECK = AXIS.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02))
CURVE = {f"k{i:02d}": 0.01 * i - 0.12 for i in range(KNOTS)} | {
    f"f{i:02d}": 0.1 * np.sin(i) for i in range(KNOTS)
}
TABLE = AXIS.with_effects(get_effect("smooth_force[position of x]").at("x", **CURVE))
PLAN = ExperimentDesign(
    ("stribeck_friction@x", "presliding@x"),
    np.arange(5) * 1e-3,
    np.zeros((5, 1)),
    sigma=40.0,
    rms=0.5,
    channel="x_m",
)


def result_of(
    data: Dataset, verdict: Verdict, after: Machine, plan: ExperimentDesign | None = None, gain: float = 0.97
) -> IdentificationResult:
    """Return a result with a corrected machine, evaluated on the last run."""
    names = ("x.mass", "x.viscous", *(f"{e.label}.{key}" for e in after.effects for key in e.parameters))
    after = after.replace(uncertainty=Uncertainty(names, 1e-6 * np.eye(len(names))))
    return axis_result(
        data,
        after,
        gain=gain,
        rivals=(PRESLIDING,) if plan else (),
        verdict=verdict,
        dependence=(Dependence("velocity of x", "x", 0.8),),
        experiment=plan,
    )


def effect_entry(name: str, site: str, **fields: Any) -> dict[str, Any]:
    """Return an effect as in report.json, with some of its fields."""
    return {"name": name, "site": site, "parameters": {}, "held_out_gain": 0.9, "rivals": []} | fields


def report_with(errors: dict[str, Any] | None = None, **fields: Any) -> Report:
    """Return a report with some fields, whose machines have equal errors by channel unless stated."""
    of_machine = {"held_out": errors or {}}
    content = {
        "schema": 1,
        "verdict": "unexplained",
        "runs": {"fitted": ["run_1"], "held_out": ["run_2"]},
        **dict.fromkeys(("declared", "before", "after"), of_machine),
        "effects": [],
        "residual": {"depends_on": [], "white": False},
        "next_experiment": None,
        "seconds": 1.0,
    }
    return Report.model_validate(content | fields)


def page_of(result: IdentificationResult, folder: Path, warnings: tuple[str, ...] = ()) -> str:
    """Write a result and return its page."""
    write_result(result, folder, warnings)
    return build_report(folder).read_text()
