"""Commands on controllers: train, evaluate, play."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..errors import InputError
from ..files import locked_folder, output_batch, output_folder
from ..operating_system import quoted
from ..option_texts import MAX_SEED
from ..parallel import map_tasks
from .application import CommandWithChoices, app, register_agents
from .messages import collect_warnings, value_errors_as_input_errors
from .options import (
    CONTROL_PERIOD,
    ControllersArgument,
    EpisodesOption,
    MachineOption,
    OutOption,
    PathOption,
    PeriodOption,
    RandomizeOption,
    RayOption,
    SensorsOption,
    TaskOption,
)
from .output import console, log
from .progress import progress_bar

if TYPE_CHECKING:
    from ..evaluation import Episodes
    from ..machine import AxisUnit, Machine


@app.command(cls=CommandWithChoices)
def train(
    algorithm: Annotated[str, Argument(help="Recipe: {algorithms}; or a recipe of your own, FILE.toml.")],
    out: OutOption,
    machine: MachineOption = "hframe",
    task: TaskOption = "reach",
    randomize: Annotated[
        str | None, Option(help="Randomization: {randomizations} (default: the recipe's).")
    ] = None,
    steps: Annotated[
        int | None,
        Option(
            min=1,
            max=10**12,
            help="Environment steps in total; the last rollout is completed (default: the recipe's).",
        ),
    ] = None,
    seed: Annotated[
        list[int] | None,
        Option(
            min=0,
            max=MAX_SEED,
            help="Seed of network, episodes and algorithm (default: 0); repeat for more agents.",
        ),
    ] = None,
    resume: Annotated[bool, Option("--resume", help="Continue from the checkpoint in the folder.")] = False,
    trust: Annotated[
        bool, Option("--trust", help="Resume from a checkpoint of another installation; it can execute code.")
    ] = False,
    force: Annotated[bool, Option("--force", help="Replace the agent and checkpoint in the folder.")] = False,
    jobs: Annotated[int, Option(min=1, max=1024, help="Number of seeds to train at a time.")] = 1,
    ray: RayOption = None,
) -> None:
    """Train an agent by a recipe: the settings of an algorithm for a task.

    The folder receives the best agent so far, its description (card.json) with the learning curve,
    TensorBoard logs and a checkpoint. A run may be killed at any time and continued with --resume; the run in
    a folder is replaced only with --force. Several seeds become the folders seed_0, seed_1, ..., each
    complete when its training ends; to resume such a run, train its seed alone with --out FOLDER/seed_N. A
    task without recipes has those of reach or track.

    Example:  hframe train ppo --out out/ppo
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from ..agents import train as run_training
    from ..controllers import suited_controllers
    from ..recordings import load_machine

    declared, seeds = load_machine(machine), seed or [0]
    if ray is not None or len(seeds) > 1:
        if resume:
            raise InputError(
                "--resume: continues one seed in this process; leave out --ray and all but one --seed"
            )
        recipe: dict[str, Any] = {"algorithm": algorithm, "machine": declared, "task": task, "steps": steps}
        _train_seeds(out, seeds=seeds, randomize=randomize, jobs=jobs, ray=ray, force=force, **recipe)
        return
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    with locked_folder(output_folder(out)), bar, value_errors_as_input_errors():
        bar_task = bar.add_task("", total=None)

        def progress(done: int, total: int) -> None:
            bar.update(bar_task, completed=done, total=total)

        run_training(
            algorithm,
            declared,
            task,
            steps=steps,
            seed=seeds[0],
            randomize=randomize,
            out=out,
            resume=resume,
            trust=trust,
            force=force,
            log=log,
            progress=progress,
        )
    options = option_words(machine=machine, task=task, randomize=randomize, out=str(out / "scores"))
    controller = suited_controllers(declared)[0]
    log(f"wrote {out}. Next: hframe evaluate {quoted(str(out))} {controller}{options} --html")


def _train_seeds(out: Path, **options: Any) -> None:
    """Train several seeds in worker processes; on a terminal a bar shows how many are complete."""
    from ..agents import train_seeds

    options["show_curves"] = not console.is_terminal  # the workers' lines would interrupt the bar
    with (
        locked_folder(output_folder(out)),
        value_errors_as_input_errors(),
        progress_bar("training") as progress,
    ):
        train_seeds(out=out, log=log, progress=progress, **options)


@app.command(cls=CommandWithChoices)
def evaluate(
    context: typer.Context,
    controllers: ControllersArgument,
    out: OutOption,
    machine: MachineOption = "hframe",
    task: TaskOption = "reach",
    path: PathOption = None,
    randomize: RandomizeOption = "default",
    sensors: SensorsOption = "state",
    period: PeriodOption = CONTROL_PERIOD,
    episodes: EpisodesOption = 512,
    seed: Annotated[int, Option(min=0, max=MAX_SEED, help="Seed of starts, goals and parameters.")] = 0,
    html: Annotated[
        bool, Option("--html", help="Also write scorecard.html, one self-contained page.")
    ] = False,
    motions: Annotated[
        int, Option(min=0, max=1000, help="Also write the motion in the first N episodes to CONTROLLER.csv.")
    ] = 0,
    protocol: Annotated[
        str | None,
        Option(
            help="Fixed benchmark for the leaderboard: {protocols}; it sets all options but --out and --ray."
        ),
    ] = None,
    ray: RayOption = None,
) -> None:
    """Score controllers on identical episodes; write scores.json and a plot of the first episode of each.

    With --protocol, write one result file per controller for the leaderboard (docs/leaderboard.md) instead.
    The controller `pid` is a model-based state feedback; `textbook-pid` is a PID.

    Examples:  hframe evaluate pid textbook-pid --episodes 64 --html --out out/scores

               hframe evaluate pid --protocol reach-v1 --out out/leaderboard
    """
    if protocol is not None:
        _evaluate_by_protocol(context, list(dict.fromkeys(controllers)), protocol, out, ray)
        return
    from ..controllers import CONTROLLERS
    from ..evaluation import unknown_bound_reasons
    from ..recordings import load_machine
    from .tables.scores import score_table

    declared = load_machine(machine)
    options: dict[str, Any] = {"randomize": randomize, "sensors": sensors, "episodes": episodes, "seed": seed}
    options |= {"machine": declared, "period": period}
    with locked_folder(output_folder(out)):
        with value_errors_as_input_errors():
            options["task"] = task_with_path(task, path, declared.axis_unit)
            scores, recorded, warned = _evaluate_all(options, list(dict.fromkeys(controllers)), ray)
        console.print(score_table(scores))
        for reason in unknown_bound_reasons(scores):
            log(reason)
        if note := _design_note(declared):
            log(note)
        for file in _write_evaluation(
            out, scores, recorded, warned if html else None, declared, machine, motions
        ):
            log(f"wrote {file}")
    with_agents = any(name not in CONTROLLERS for name in scores["controllers"])
    if not with_agents and (proposal := training_proposal(machine, task, randomize, period)):
        log(proposal)


def _design_note(machine: Machine) -> str:
    """Return what designs of the package's controllers leave out of a machine, or an empty text."""
    from ..machine import effects_left_out

    labels = " and ".join(effect.label for effect in effects_left_out(machine))
    if not labels:
        return ""
    return (
        f"controllers are designed without {labels}: no sensor measures what moves there; simulations have it"
    )


def _evaluate_all(
    options: dict[str, Any], controllers: list[str], ray: str | None
) -> tuple[dict[str, Any], dict[str, Episodes], list[str]]:
    """Evaluate controllers, on Ray one per task; return scores, recorded episodes and warnings' texts."""
    groups = [controllers] if ray is None else [[name] for name in controllers]
    (scores, recorded, warned), *others = map_tasks(partial(_evaluate_group, options), groups, ray=ray)
    for more_scores, more_recorded, more_warned in others:
        scores["controllers"] |= more_scores["controllers"]
        recorded |= more_recorded
        warned += [text for text in more_warned if text not in warned]
    return scores, recorded, warned


def _evaluate_group(
    options: dict[str, Any], controllers: list[str]
) -> tuple[dict[str, Any], dict[str, Episodes], list[str]]:
    """Evaluate controllers; return scores, recorded episodes and the texts of warnings."""
    from ..evaluation import evaluate as run_evaluation

    register_agents()
    with collect_warnings() as warned:
        scores, recorded = run_evaluation(controllers, **options)
    return scores, recorded, warned


def _write_evaluation(
    out: Path,
    scores: dict[str, Any],
    recorded: dict[str, Episodes],
    warned: list[str] | None,
    machine: Machine,
    machine_name: str,
    motions: int,
) -> list[Path]:
    """Write scores, plots and, unless `warned` is None, the scorecard, all together; return the files."""
    from ..evaluation import file_labels, save_plot, write_motions, write_scorecard, write_scores

    episodes_by_label = dict(zip(file_labels(recorded), recorded.values(), strict=True))
    with output_batch(out):
        written = [write_scores(out, scores)]
        if motions:
            for label, episodes in episodes_by_label.items():
                write_motions(out / f"{label}.csv", episodes, machine, motions)
                written.append(out / f"{label}.csv")
        try:
            for label, episodes in episodes_by_label.items():
                save_plot(out / f"{label}.png", episodes, title=f"{label} on {machine.name}")
                written.append(out / f"{label}.png")
            if warned is not None:
                written.append(write_scorecard(out, scores, recorded, warned, machine_name))
        except ImportError as error:
            log(f"no plots: {error}")
    return written


def _evaluate_by_protocol(
    context: typer.Context, controllers: list[str], name: str, out: Path, ray: str | None
) -> None:
    """Write the result file of each controller in a fixed benchmark, and print their scores."""
    from ..evaluation import FIXED_OPTIONS, write_result
    from .tables.scores import protocol_tables

    for option in (*FIXED_OPTIONS, "html", "motions"):
        source = context.get_parameter_source(option)
        if source is not None and source.name != "DEFAULT":
            raise InputError(f"--{option}: --protocol {name} fixes everything; leave --{option} out")
    with locked_folder(output_folder(out)):
        with value_errors_as_input_errors():
            contents = list(map_tasks(partial(_protocol_result, name), controllers, ray=ray))
        with output_batch(out):
            written = [write_result(out, content) for content in contents]
    for table in protocol_tables(contents):
        console.print(table)
    for path in written:
        log(f"wrote {path}")


def _protocol_result(protocol_name: str, controller: str) -> dict[str, Any]:
    """Run a controller through a fixed benchmark and return the content of its result file."""
    from ..evaluation import get_protocol, result_content, run_protocol

    register_agents()
    protocol = get_protocol(protocol_name)
    return result_content(protocol, *run_protocol(controller, protocol))


@app.command(cls=CommandWithChoices)
def play(
    controller: Annotated[
        str | None, Argument(help="What drives the stage: {controllers}, {agents}, ... (default: you).")
    ] = None,
    beside: Annotated[
        str | None,
        Option(help="Controller of a second stage: {controllers}, {agents}, the folder of an agent."),
    ] = None,
    machine: MachineOption = "hframe",
    task: TaskOption = "reach",
    path: PathOption = None,
    randomize: RandomizeOption = "none",
    sensors: SensorsOption = "state",
    period: PeriodOption = CONTROL_PERIOD,
    speed: Annotated[
        float,
        Option(min=0.001, max=100.0, help="Speed relative to real time; a hand is slower than a motor."),
    ] = 0.3,
    seed: Annotated[int, Option(min=0, max=MAX_SEED, help="Seed of the first start and goal.")] = 0,
    frames: Annotated[
        int | None, Option(min=1, help="Stop after this number of frames (50 per second).")
    ] = None,
    picture: Annotated[Path | None, Option(help="PNG file for the last frame.")] = None,
) -> None:
    """Drive a simulated stage by mouse or keys; with --beside, a controller has the same task beside it.

    Arrow keys push the tool (with Shift: full voltage); the left mouse button pulls it to the pointer, the
    right one sets a target. N begins a new episode, R repeats it, Space pauses, Q quits.

    Example:  hframe play --beside pid
    """
    from ..evaluation import Scenario
    from ..evaluation.play import Game
    from ..recordings import load_machine

    register_agents()
    declared = load_machine(machine)
    options: dict[str, Any] = {"randomize": randomize, "sensors": sensors, "seed": seed, "period": period}
    with value_errors_as_input_errors():
        scenario = Scenario(declared, task_with_path(task, path, declared.axis_unit), **options)
        game = Game(scenario, controller, beside, speed)
    game.run(frames)
    small = declared.axis_unit.small
    for stage in game.stages:
        state = (
            "outside the band" if stage.settled_s is None else f"in the band since {stage.settled_s:.2f} s"
        )
        log(
            f"{stage.name}: {1e3 * stage.distance:.3f} {small} from the goal "
            f"after {stage.elapsed_s:.2f} s, {state}"
        )
    if picture is not None:
        game.save_picture(picture)
        log(f"wrote {picture}")
    game.close()


def task_with_path(name: str, path: str | None, unit: AxisUnit) -> Any:
    """Return the task that the options --task and --path select: its name, or a task object with the path.

    Args:
        name: Registered name of the task.
        path: Shape or file that the goal follows; None: that of the task.
        unit: Unit of the machine's axes.

    Raises:
        InputError: If the task is unknown, or if a path is given for a task that does not follow one.
    """
    from ..envs import TASKS, as_task

    task_class: Any = TASKS.get(name)
    follows_path = is_dataclass(task_class) and "path" in {field.name for field in fields(task_class)}
    if path is not None and not follows_path:
        raise InputError(f"--path {path}: the task {name} follows no path")
    return name if path is None else as_task(name, unit, path=path)


def option_words(**values: str | None) -> str:
    """Format options for a command that a message proposes: " --machine axis --task reach".

    Values are quoted for the shell where they need it; options with the value None are left out.
    """
    return "".join(f" --{name} {quoted(value)}" for name, value in values.items() if value is not None)


def training_proposal(machine: str, task: str, randomize: str, period: float) -> str:
    """Write a line that proposes a command to train an agent with the settings of an evaluation.

    Args:
        machine: Name or file of the machine, as the user stated it.
        task: Name of the task, as the user stated it.
        randomize: Randomization of the evaluation; named if the recipe has another one.
        period: Control period of the evaluation, s. If the recipe has another one, the line names that.

    Returns:
        The line; "" if the package has no recipe "ppo" for the task.
    """
    from ..agents import load_recipe

    try:
        recipe = load_recipe("ppo", task)
    except InputError:
        return ""
    words = option_words(
        machine=machine, task=task, randomize=None if randomize == recipe.randomize else randomize
    )
    note = (
        ""
        if period == recipe.period
        else f" with --period {recipe.period:g}, the control period of the recipe"
    )
    return f"Next: hframe train ppo{words} --out FOLDER, then evaluate FOLDER too{note}"
