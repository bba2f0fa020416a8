"""Effects that are no causes may describe what is left, and no machine is delivered that predicts worse."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.budget import Budget
from hframe_gym.identification.evidence.tried_effects import ConsideredEffect, SelectedEffect
from hframe_gym.identification.fit.channel_errors import ChannelError
from hframe_gym.identification.fit.estimation import Fit
from hframe_gym.identification.fit.plain_fit import PlainFit
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.identification.search.outcome import SearchOutcome, without_names
from hframe_gym.identification.validate.evaluation import Evaluated, Judged
from hframe_gym.identification.validate.machine_errors import ModelEvaluation, PredictionErrors
from hframe_gym.identification.validate.simpler_machines import (
    best_description,
    effects_of_search,
    fit_to_describe,
    no_worse,
)
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine
from tests.identification.single_axis import AXIS, axis_runs

STAGE = BUILTIN_MACHINES["hframe"]()
FORCE, SPRING = EFFECTS["constant_force"].at("x", size=1.0), EFFECTS["cable_spring"].at("x", k=10.0, q0=0.0)
DATA = axis_runs(AXIS, rows=300, volts=6.0)


def fit_of(machine: Machine) -> Fit:
    return Fit(machine, (), np.zeros(0), 1.0, 1, SIMULATION, np.zeros((0, 0)))


@dataclasses.dataclass
class HeldOutRuns:
    """Held-out runs with given errors of machines, in units of the noise, by the labels of their effects."""

    machine: Machine
    errors_of: dict[tuple[str, ...], float]
    criteria: SelectionCriteria = dataclasses.field(default_factory=SelectionCriteria)
    explaining: AppliedEffect | None = None
    predicted: dict[tuple[str, ...], float] = dataclasses.field(default_factory=dict)
    complete_runs: Any = None
    part: dict[tuple[str, ...], float] = dataclasses.field(default_factory=dict)

    def with_runs(self, names: Sequence[str]) -> HeldOutRuns:
        return dataclasses.replace(
            self, errors_of=self.part, complete_runs=self.complete_runs.with_runs(names)
        )

    def rounded_stamps_explain(self, model: ModelEvaluation) -> bool:
        return False

    def explains_unstable_motion(self, model: ModelEvaluation, fitted: object) -> bool:
        return self.explaining in model.machine.effects

    def unstable_motion(self, model: ModelEvaluation, fitted: object) -> Any:
        return self.predicted or None

    def predictions(self, model: ModelEvaluation, fitted: object) -> Any:
        return np.array([[self.predicted[tuple(e.label for e in model.machine.effects)]]])

    @property
    def session(self) -> Any:
        return SimpleNamespace(machine=self.machine)

    def seconds(self) -> float:
        return 0.0

    def refined_runs(self, model: ModelEvaluation, fitted: object) -> Any:
        return self.complete_runs

    @property
    def held_out(self) -> Any:
        return SimpleNamespace(runs=(1,))

    def errors(self, machine: Machine, data: object = None, name: str = "") -> ModelEvaluation:
        error = self.errors_of[tuple(e.label for e in machine.effects)]
        channels = {"x_m": ChannelError(1e-5 * error, error)}
        return ModelEvaluation(machine, PredictionErrors(channels, None))

    def evaluate(self, outcome: SearchOutcome) -> Evaluated:
        errors = [self.errors(m) for m in (self.machine, outcome.before.machine, outcome.after.machine)]
        return Evaluated(outcome, outcome.selected, *errors, cast("Any", self))


def withdrawn_names(machine: Machine, errors_of: dict[tuple[str, ...], float], verdict: Any) -> Judged:
    """Return an outcome whose only name, a spring, was withdrawn."""
    machine = machine.replace(effects=())
    runs = HeldOutRuns(machine, errors_of)
    spring = SelectedEffect(SPRING, 1.0, machine)
    before, after = fit_of(machine), fit_of(machine.with_effects(SPRING))
    found = SearchOutcome(before, False, False, "effect_found", after, (spring,), (), DATA)
    without = without_names(found, "too much remains")._replace(verdict=verdict)
    return Judged(runs.evaluate(without)._replace(reason="too much remains"), runs.evaluate(found))


def test_effects_of_a_search_are_those_that_it_fitted_beside_each_other() -> None:
    """What the declared machine has, and what adds coordinates, is none of them."""
    declared = AXIS.replace(effects=(FORCE,))
    payload = EFFECTS["payload_swing"]
    swinging = payload.at("x", **{p.name: 1.0 for p in payload.parameters})
    drag, stiffer = EFFECTS["quadratic_drag"].at("x", c=1.0), EFFECTS["cable_spring"].at("x", k=20.0, q0=0.0)
    both, three = declared.with_effects(SPRING, drag), declared.with_effects(stiffer, drag, swinging)
    considered = (
        ConsideredEffect(drag, both, declared.with_effects(SPRING), "may be chance"),
        ConsideredEffect(swinging, three, both, "explains too little"),
    )
    before = fit_of(declared)
    outcome = SearchOutcome(before, False, False, "unexplained", before, (), considered, DATA)
    assert effects_of_search(outcome) == (SPRING, drag)


@pytest.mark.parametrize("machine", [STAGE, AXIS])
def test_effects_whose_names_were_withdrawn_describe_what_is_left(machine: Machine) -> None:
    judgment = withdrawn_names(machine, {(): 165.0, ("cable_spring@x",): 15.0}, "unexplained")
    lines: list[str] = []
    delivered = no_worse(judgment, None, lines.append, Budget())
    evaluated = delivered.evaluated
    assert evaluated.after.machine.effects == (SPRING,)
    assert evaluated.before.machine.effects == ()
    assert (evaluated.outcome.verdict, evaluated.selected) == ("unexplained", ())
    assert evaluated.reason == "too much remains"
    assert [c.effect.label for c in evaluated.outcome.considered] == ["cable_spring@x"]
    [remark] = delivered.remarks
    assert "describes the remaining error by cable_spring@x. They are no causes" in remark
    assert "0.0909 times" in remark
    assert lines == ["described by cable_spring@x: 0.0909 times the error on the held-out runs"]


@pytest.mark.parametrize(
    ("without", "with_spring", "verdict"),
    [
        (165.0, 155.0, "unexplained"),  # hardly better
        (1.9, 1.0, "unexplained"),  # only noise is left
        (165.0, 15.0, "no_effect"),
    ],
)
def test_the_refitted_machine_is_delivered_where_no_description_is_of_use(
    without: float, with_spring: float, verdict: str
) -> None:
    judgment = withdrawn_names(STAGE, {(): without, ("cable_spring@x",): with_spring}, verdict)
    delivered = no_worse(judgment, None, lambda line: None, Budget())
    assert delivered.evaluated.after.machine.effects == ()
    assert delivered.evaluated.outcome.verdict == verdict
    assert delivered.remarks == ()


@pytest.mark.parametrize(("with_spring", "described"), [(440.0, False), (0.8, True)])
def test_along_an_unstable_motion_a_description_must_predict_better_too(
    with_spring: float, described: bool
) -> None:
    judgment = withdrawn_names(STAGE, {(): 165.0, ("cable_spring@x",): 15.0}, "unexplained")
    runs: Any = judgment.evaluated.test
    runs.predicted = {(): 1.0, ("cable_spring@x",): with_spring}
    delivered = no_worse(judgment, None, lambda line: None, Budget())
    assert bool(delivered.evaluated.after.machine.effects) == described


FORCE_LABEL, SPRING_LABEL, DRAG_LABEL = "constant_force@x", "cable_spring@x", "quadratic_drag@x"


def plain_with_uncertain_force() -> PlainFit:
    """Return a plain fit whose runs show no term, beside one of a constant force that others may confirm."""
    machine = AXIS.replace(effects=())
    return PlainFit(machine, (fit_of(machine),), (fit_of(machine.with_effects(FORCE)),))


@pytest.mark.parametrize(
    ("truth", "force", "expected"),
    [
        (AXIS.with_effects(FORCE), 1000.0, (FORCE,)),
        (AXIS.with_effects(FORCE), 2900.0, ()),  # it hardly helps, and might be in the way
        (AXIS, 1000.0, ()),  # the refitted machine is better in the fitted runs
    ],
)
def test_a_description_begins_with_the_terms_that_the_held_out_runs_clearly_confirm(
    truth: Machine, force: float, expected: tuple[AppliedEffect, ...]
) -> None:
    judgment = withdrawn_names(
        AXIS, {(): 3000.0, (SPRING_LABEL,): 600.0, (FORCE_LABEL,): force}, "unexplained"
    )
    outcome = judgment.evaluated.outcome._replace(data=axis_runs(truth, rows=100, volts=3.0))
    evaluated = judgment.evaluated._replace(outcome=outcome)
    assert fit_to_describe(plain_with_uncertain_force(), evaluated, Budget()).machine.effects == expected


@pytest.mark.parametrize(
    ("with_drag", "with_spring", "searched", "described"),
    [
        (400.0, 600.0, True, DRAG_LABEL),
        (580.0, 600.0, True, SPRING_LABEL),  # the effect whose name was withdrawn is as good
        (0.9, 1.5, False, SPRING_LABEL),  # and leaves only noise
    ],
)
def test_effects_are_searched_for_where_those_whose_names_were_withdrawn_leave_more_than_noise(
    with_drag: float, with_spring: float, searched: bool, described: str
) -> None:
    drag = EFFECTS["quadratic_drag"].at("x", c=1.0)
    errors_of = {(): 3000.0, (SPRING_LABEL,): with_spring, (DRAG_LABEL,): with_drag}
    judgment, begun = withdrawn_names(AXIS, errors_of, "unexplained"), []

    def further(helps: Callable[[Machine], bool]) -> Iterator[tuple[Fit, tuple[str, ...]]]:
        begun.append(drag)
        machine = AXIS.replace(effects=(drag,))
        assert helps(machine) == (described == DRAG_LABEL)
        yield fit_of(machine), (drag.label,)
        assert not helps(machine)  # no better than itself

    description = best_description(judgment, judgment.evaluated.before, further, lambda line: None)
    assert description is not None
    assert [e.label for e in description.evaluated.after.machine.effects] == [described]
    assert description.evaluated.selected == ()
    assert begun == [drag] * searched


def test_a_description_that_leaves_only_noise_is_delivered_beside_a_plain_fit() -> None:
    errors_of = {(): 3000.0, (SPRING_LABEL,): 1.5, (FORCE_LABEL,): 1000.0}
    judgment = withdrawn_names(AXIS, errors_of, "unexplained")
    delivered = no_worse(judgment, plain_with_uncertain_force(), lambda line: None, Budget())
    assert delivered.evaluated.after.machine.effects == (SPRING,)
    assert delivered.plain is not None
    assert (delivered.plain.terms, delivered.plain.delivered) == ((FORCE_LABEL,), False)


def delivered_beside(simpler: str, *, explains: bool) -> Any:
    """Deliver a machine with a spring whose simulation errs more than that of a simpler machine.

    Args:
        simpler: "plain" or "declared".
        explains: Whether the machine with the spring explains an unstable motion.
    """
    declared = AXIS.replace(effects=())
    plain_machine = declared.with_effects(FORCE)
    best = 1000.0
    errors_of = {
        (): best,
        (SPRING_LABEL,): 1.1 * best,
        (FORCE_LABEL,): best if simpler == "plain" else 5.0 * best,
    }
    runs = HeldOutRuns(declared, errors_of, explaining=SPRING if explains else None)
    after = fit_of(declared.with_effects(SPRING))
    selected = (SelectedEffect(SPRING, 1.0, declared),)
    found = SearchOutcome(fit_of(declared), False, False, "effect_found", after, selected, (), DATA)
    return no_worse(
        Judged(runs.evaluate(found)),
        PlainFit(plain_machine, (fit_of(plain_machine),)),
        lambda line: None,
        Budget(),
    )


@pytest.mark.parametrize("simpler", ["plain", "declared"])
def test_a_machine_that_explains_an_unstable_motion_is_delivered_although_its_simulation_errs_more(
    simpler: str,
) -> None:
    delivered = delivered_beside(simpler, explains=True)
    assert [s.effect for s in delivered.evaluated.selected] == [SPRING]
    assert (delivered.evaluated.reason, delivered.remarks) == ("", ())


@pytest.mark.parametrize("simpler", ["plain", "declared"])
def test_simulations_decide_along_other_motions(simpler: str) -> None:
    delivered = delivered_beside(simpler, explains=False)
    assert delivered.evaluated.selected == ()
    assert "the machine that is delivered is the" in delivered.evaluated.reason.lower()
    assert not delivered.evaluated.reason.endswith(".")


@pytest.mark.parametrize("explained", [True, False])
@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_held_out_runs_that_contradict_all_machines_choose_none(explained: bool, gain: float) -> None:
    """A run with a smaller gain contradicts two others: of errors of hundreds of noises, none is right."""
    declared, fitted = AXIS.replace(effects=()), AXIS.replace(effects=()).with_effects(FORCE)
    held_out = DATA.with_runs(["run_2"])
    held_out = held_out.with_inputs({run.name: gain * run.inputs for run in held_out.runs})
    runs = HeldOutRuns(declared, {(): 430.0, (FORCE_LABEL,): 559.0}, complete_runs=held_out)
    found = SearchOutcome(fit_of(fitted), explained, explained, "unexplained", fit_of(fitted), (), (), DATA)
    judgment = Judged(runs.evaluate(found)._replace(reason="it contradicts"))
    delivered = no_worse(judgment, None, lambda line: None, Budget(), differing=("run_2",))
    stays = explained and gain != 1.0
    assert delivered.evaluated.after.machine.effects == ((FORCE,) if stays else ())
    assert delivered.evaluated.reason == "it contradicts"


@pytest.mark.parametrize(("others", "stays"), [(1.0, True), (600.0, False)])
def test_of_the_held_out_runs_only_those_choose_that_do_not_contradict_all_machines(
    others: float, stays: bool
) -> None:
    """A run with a smaller gain leaves hundreds of noises with each machine; the other one tells."""
    declared, fitted = AXIS.replace(effects=()), AXIS.replace(effects=()).with_effects(FORCE)
    held_out = DATA.with_runs(["run_1", "run_2"])
    held_out = held_out.with_inputs(
        {run.name: (0.5 if run.name == "run_2" else 1.0) * run.inputs for run in held_out.runs}
    )
    both, alone = {(): 430.0, (FORCE_LABEL,): 559.0}, {(): 300.0, (FORCE_LABEL,): others}
    runs = HeldOutRuns(declared, both, complete_runs=held_out, part=alone)
    found = SearchOutcome(fit_of(fitted), True, True, "unexplained", fit_of(fitted), (), (), DATA)
    judgment = Judged(runs.evaluate(found)._replace(reason="it contradicts"))
    delivered = no_worse(judgment, None, lambda line: None, Budget(), differing=("run_2",))
    assert delivered.evaluated.after.machine.effects == ((FORCE,) if stays else ())
    assert delivered.evaluated.after.held_out.noise_ratio == both[(FORCE_LABEL,) if stays else ()]
