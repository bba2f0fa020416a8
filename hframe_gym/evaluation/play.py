"""Drive a stage by mouse or keys in a window, with a controller on its task beside it (extra `render`)."""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Array
from ..controllers import Controller, MotionModel
from ..envs import HFrameEnv
from ..envs.rendering import HEIGHT, TRAIL_LENGTH, WIDTH, Renderer, Scene, tool_point
from ..errors import InputError
from ..files import atomic_file
from ..machine import position_of_point
from .controller_creation import make_controller
from .scenario import Scenario

FRAMES_PER_S = 50
STRIP_HEIGHT = 74  # pixels below a stage, for its name, its result and its voltages
HELP_HEIGHT = 30  # pixels below the stages, for the keys
SCALE_OF_TWO = 0.72  # size of each of two stages relative to a single one
GENTLE = 0.4  # fraction of the rated voltage that an arrow key applies; all of it with the shift key
FULL_VOLTAGE_DISTANCE = 0.05  # m, distance of the pointer from the tool that applies the rated voltage
HELP = (
    "arrow keys: push (with Shift: full voltage)    left button: pull to the pointer    right button: "
    "target    N: new    R: repeat    Space: pause    Q: quit"
)
BACKGROUND = (250, 250, 248)
INK = (44, 50, 60)
MUTED = (110, 118, 128)
BAR = (43, 108, 196)
GOOD = (22, 140, 92)


class _StageView(Renderer):
    """Picture of a stage that is a part of a window: a pygame surface of `WIDTH` x `HEIGHT` pixels."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario.declared_machine, "rgb_array", FRAMES_PER_S)
        self.surface = self._surface

    @override
    def _output(self) -> NDArray[np.uint8] | None:
        """Keep the picture in the surface instead of copying it to an array."""
        return None

    def point(self, pixel: tuple[float, float]) -> tuple[float, float]:
        """Return the position (x, y), m, at a column and row of the picture."""
        (left, bottom), (right, top) = self._pixel((0.0, 0.0)), self._pixel((1.0, 1.0))
        return (pixel[0] - left) / (right - left), (pixel[1] - bottom) / (top - bottom)


class PlayedStage:
    """One simulated machine (stage) in the window of the game, driven by a controller or by the user.

    Args:
        scenario: As for `Game`.
        name: Name of the controller. Default: the user.

    Attributes:
        view: Picture of the stage, which converts pixels to positions.
        volts: Voltages of the drives in the last control period, V, shape (drives,).
        settled_s: Time from which on the tool has been within the task's band, s; None while it is outside.
        distance: Distance of the tool to the goal, m or rad.
    """

    def __init__(self, scenario: Scenario, name: str | None) -> None:
        self.name = name or "you"
        self.controller: Controller | None = make_controller(name, scenario) if name else None
        self.env = HFrameEnv(
            machine=scenario.declared_machine,
            task=scenario.controller_task,
            randomize=scenario.randomize,
            sensors=scenario.sensors if self.controller else "state",
            drives=scenario.drives,
            period=scenario.period,
        )
        self.view = _StageView(scenario)
        self.rated = np.array([d.rated_voltage for d in self.env.batch.machine.drives])
        self._trail: deque[tuple[float, float]] = deque(maxlen=TRAIL_LENGTH)

    @property
    def position(self) -> tuple[float, ...]:
        """True position of the tool of this stage along its axes, m or rad."""
        position = self.env.batch.simulator.positions(0)
        return tuple(position[axis] for axis in self.env.batch.machine.tool_axes)

    @property
    def elapsed_s(self) -> float:
        """Time since the start of the episode, s."""
        return float(self.env.batch.elapsed[0] * self.env.batch.config.period)

    def reset(self, seed: int, target: tuple[float, ...] | None = None) -> None:
        """Begin a new episode on this stage.

        Args:
            seed: Seed of start, goal and machine parameters.
            target: Target along the axes, m or rad, approached from the present position. Default: start and
                goal of the task.

        Raises:
            InputError: If a target is given for a task without one, or it is outside the workspace.
        """
        options = None if target is None else {"start": self.position, "target": target}
        self.observation, info = self.env.reset(seed=seed, options=options)
        if self.controller:
            self.controller.reset()
        self.volts = np.zeros(len(self.rated))
        self.settled_s: float | None = None
        self._trail.clear()
        self._note(info)

    def step(self, action: Array) -> None:
        """Simulate one control period with the stage's controller or, if it has none, with the user's action.

        Args:
            action: The user's voltages as fractions of the rated ones, shape (drives,), limited to [-1, 1]
                here.
        """
        if self.controller:
            batch = {key: value[None] for key, value in self.observation.items()}
            action = np.asarray(self.controller.act(batch), np.float64)[0]
        action = np.clip(action, -1.0, 1.0)
        self.observation, _, _, _, info = self.env.step(action)
        self.volts = action * self.rated
        self._note(info)

    def _note(self, info: dict[str, Any]) -> None:
        """Update distance, settling time and trail."""
        self.distance = float(info[self.env.batch.distance_key])
        if not info["is_success"]:
            self.settled_s = None
        elif self.settled_s is None:
            self.settled_s = self.elapsed_s
        self._trail.append(tool_point(self.env.batch, 0))

    def draw(self) -> Any:
        """Draw this stage from above on a Pygame surface of 880 x 660 pixels, which each call overwrites."""
        self.view.draw(Scene.of(self.env.batch, 0, self._trail))
        return self.view.surface


class Game:
    """Window in which the user drives a simulated machine (stage), and a controller the same one beside it.

    Args:
        scenario: Machine, task, randomization, sensors, drives and control period.
        controller: Name of a controller that drives the first stage in place of the user. Default: the user.
        beside: Name of a controller that drives a second stage, same start, goal and parameters. Default:
            none.
        speed: Speed of the simulation relative to real time, positive.

    Attributes:
        done: Whether the user has closed the window.
        paused: Whether the simulation is stopped.
        seed: Seed of the present episode.

    Raises:
        ImportError: If pygame is missing; the message names the extra.
        InputError: If the machine has no axes with as many drives, a controller is unknown, the speed is not
            positive, or there is no display.
    """

    def __init__(
        self, scenario: Scenario, controller: str | None = None, beside: str | None = None, speed: float = 0.3
    ) -> None:
        if not (math.isfinite(speed) and speed > 0.0):
            raise InputError(f"speed is {speed!r}, it must be a positive number")
        self._model = MotionModel(scenario.declared_machine)
        self.stages = [PlayedStage(scenario, controller)] + (
            [PlayedStage(scenario, beside)] if beside else []
        )
        import pygame  # the stages' views have found it

        self._pygame = pygame
        self._periods_per_frame = speed / (FRAMES_PER_S * scenario.period)
        self._due = 0.0  # control periods that are to be simulated
        self._scale = SCALE_OF_TWO if beside else 1.0
        self._size = round(self._scale * WIDTH), round(self._scale * HEIGHT)
        width, height = self._size[0] * len(self.stages), self._size[1] + STRIP_HEIGHT + HELP_HEIGHT
        try:
            pygame.display.init()
            self.window = pygame.display.set_mode((width, height))
        except pygame.error as error:
            raise InputError(f"no window can be opened ({error}); hframe play needs a display") from None
        pygame.display.set_caption(f"hframe play: {scenario.declared_machine.name}, {scenario.task_name}")
        self._font, self._small = pygame.font.Font(None, 26), pygame.font.Font(None, 19)
        self._keys: set[int] = set()
        self._pointer: tuple[float, ...] | None = None  # tool position, while the left button is held
        self.done, self.paused, self.seed = False, False, scenario.seed
        self.reset()

    def reset(self, target: tuple[float, ...] | None = None) -> None:
        """Begin a new episode on all stages, with the same goal and machine parameters.

        Args:
            target: Target along the axes, m or rad, which every stage approaches from its present position.
                Default: goal and common start of the task.

        Raises:
            InputError: If a target is given for a task without one, or it is outside the workspace.
        """
        for stage in self.stages:
            stage.reset(self.seed, target)
        self._due = 0.0

    def handle(self, event: Any) -> None:
        """React to a pygame event of a key, of the mouse or of the window.

        Arrow keys, Shift and the left button change `action`. The right button begins an episode with the
        pointer as the target. N begins a new episode, R repeats it, Space pauses. Q, Escape and closing the
        window end the game.
        """
        pygame = self._pygame
        if event.type == pygame.QUIT:
            self.done = True
        elif event.type == pygame.KEYDOWN:
            self._press(event.key)
        elif event.type == pygame.KEYUP:
            self._keys.discard(event.key)
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
            self._pointer = self._point(event.pos)
        elif event.type == pygame.MOUSEBUTTONUP and event.button == 1:
            self._pointer = None
        elif event.type == pygame.MOUSEMOTION and self._pointer is not None:
            self._pointer = self._point(event.pos)
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 3:
            self._set_target(self._point(event.pos))

    def _press(self, key: int) -> None:
        """React to a key: commands act at once, arrow keys as long as they are held."""
        pygame = self._pygame
        if key in (pygame.K_q, pygame.K_ESCAPE):
            self.done = True
        elif key == pygame.K_SPACE:
            self.paused = not self.paused
        elif key in (pygame.K_n, pygame.K_r):
            self.seed += key == pygame.K_n
            self.reset()
        else:
            self._keys.add(key)

    def _point(self, pixel: tuple[int, int]) -> tuple[float, ...]:
        """Return the tool position at a pixel of the window, in the stage that it belongs to."""
        column = pixel[0] % self._size[0]
        point = self.stages[0].view.point((column / self._scale, pixel[1] / self._scale))
        return position_of_point(self._model.machine.axis_unit, point, self.stages[0].position)

    def _set_target(self, point: tuple[float, ...]) -> None:
        """Begin an episode with a target, ignored for a task without a target and outside the workspace."""
        with suppress(InputError):
            self.reset(point)

    @property
    def action(self) -> Array:
        """Voltages that the user gives by keys and mouse, as fractions of the rated ones, shape (drives,).

        They push the tool in the direction of the arrow keys, harder with Shift, or, while the left button is
        held, toward the pointer; zeros without either.
        """
        pygame, keys = self._pygame, self._keys
        if self._pointer is not None:
            reach = FULL_VOLTAGE_DISTANCE * self._model.machine.axis_unit.per_meter
            push = (np.array(self._pointer) - self.stages[0].position) / reach
        else:
            x = (pygame.K_RIGHT in keys) - (pygame.K_LEFT in keys)
            y = (pygame.K_UP in keys) - (pygame.K_DOWN in keys)
            full = pygame.K_LSHIFT in keys or pygame.K_RSHIFT in keys
            push = (1.0 if full else GENTLE) * np.array([x, y][: len(self._model.axes)], np.float64)
        size = float(np.linalg.norm(push))
        if size == 0.0:
            return np.zeros(len(self._model.rated))
        fractions = self._model.voltage(push[None])[0] / self._model.rated
        return np.asarray(min(size, 1.0) * fractions / np.abs(fractions).max())

    def advance(self) -> None:
        """Simulate all stages for 20 ms * `speed`, one frame of the window; do nothing during a pause."""
        if self.paused:
            return
        self._due += self._periods_per_frame
        while self._due >= 1.0:
            self._due -= 1.0
            action = self.action
            for stage in self.stages:
                stage.step(action)

    def draw(self) -> None:
        """Draw the window: all stages with names, results and voltages, and the list of keys."""
        pygame, (width, height) = self._pygame, self._size
        self.window.fill(BACKGROUND)
        for k, stage in enumerate(self.stages):
            self.window.blit(pygame.transform.smoothscale(stage.draw(), self._size), (k * width, 0))
            self._draw_strip(stage, k * width + 16, height)
        text = self._small.render("paused; Space: continue" if self.paused else HELP, True, MUTED)
        self.window.blit(text, (16, height + STRIP_HEIGHT + 4))
        pygame.display.flip()

    def _draw_strip(self, stage: PlayedStage, left: int, top: int) -> None:
        """Draw name, time, distance and voltages of a stage below it."""
        draw, middle, small = self._pygame.draw, 300, self._model.machine.axis_unit.small
        self.window.blit(self._font.render(stage.name, True, INK), (left, top + 4))
        result, tone = f"{stage.elapsed_s:.2f} s, {1e3 * stage.distance:.2f} {small} from the target", INK
        if stage.settled_s is not None:
            band = 1e3 * stage.env.batch.task.band
            result, tone = f"within {band:g} {small} since {stage.settled_s:.2f} s", GOOD
        self.window.blit(self._small.render(result, True, tone), (left, top + 32))
        for j, (volts, rated) in enumerate(zip(stage.volts, stage.rated, strict=True)):
            row, half = top + 8 + 24 * j, 70  # pixels
            center = left + middle + half
            draw.rect(self.window, (226, 229, 233), (center - half, row, 2 * half, 14))
            length = round(half * float(volts) / float(rated))
            draw.rect(self.window, BAR, (center + min(length, 0), row, abs(length), 14))
            draw.line(self.window, INK, (center, row - 2), (center, row + 15))
            text = f"drive {j + 1} {float(volts):+.1f} V"
            self.window.blit(self._small.render(text, True, INK), (center + half + 10, row + 1))

    def run(self, frames: int | None = None) -> None:
        """Handle events, simulate and draw, 50 times per second, until the user ends the game.

        Args:
            frames: Number of frames after which the game ends at the latest. Default: any number.
        """
        clock, count = self._pygame.time.Clock(), 0
        while not self.done and (frames is None or count < frames):
            for event in self._pygame.event.get():
                self.handle(event)
            self.advance()
            self.draw()
            clock.tick(FRAMES_PER_S)
            count += 1

    def save_picture(self, path: Path) -> None:
        """Save the window as a .png picture; an existing file is replaced, or unchanged if writing fails.

        Raises:
            InputError: If the file does not end in .png.
            OSError: If the file cannot be written.
        """
        if path.suffix != ".png":
            raise InputError(f"{path}: the picture must end in .png")
        with atomic_file(path) as file:
            self._pygame.image.save(self.window, file, "picture.png")

    def close(self) -> None:
        """Close the window."""
        self._pygame.display.quit()
