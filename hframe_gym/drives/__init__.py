"""Kinds of drives whose torque follows a law of their own, such as servos, found by their folder.

set_point    drives with an inner loop that follow a commanded position or speed
stepper      stepper motors, which hold a commanded position by the torque of a magnet in a field

A law is written like an effect on a drive (`Effect`): its formula `current` returns the torque of the motor
shaft, Nm, and the memory of a controller is a state with the formula `next_state`. Simulation, derivatives,
identification and environments take it from the equations of motion.
"""

from ..registry import import_modules

import_modules(__name__, __path__)
