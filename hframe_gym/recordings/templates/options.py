"""Options of a new machine: the values in which it differs from its template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class MachineOptions:
    """Values in which a new machine differs from its template; None keeps the template's value.

    Attributes:
        travel: Length of the workspace along x and y (an axis: along x only), m.
        mass: Moving masses along x and y (an axis: along x only), kg; of a rotary axis the moment of inertia,
            kg m^2.
        pulley_radius: Pitch radius of the motors' pulleys, m. With the template "axis", the gear ratio of the
            drive (rad of the motor per m) becomes gear_ratio / pulley_radius, where a `gear_ratio` of None
            counts as 1.
        travel_per_turn: In place of `pulley_radius` where the motor moves a carriage directly: travel per
            turn, m; the lead of a screw, 2 pi times the radius of a pulley.
        gear_ratio: Turns of the motor per turn of the pulley or screw. With the template "axis" and without
            either of both: angle of the motor per travel of the carriage, rad/m.
        rotor_inertia: Moment of inertia of a motor's rotor, kg m^2. gear_ratio^2 * rotor_inertia replaces the
            moment of inertia of the driven pulleys; it is added to the mass of a carriage or shaft that the
            motor moves directly.
        Kt: Torque constant of the motors, Nm/A; Ke becomes the same, in Vs/rad.
        resistance: Resistance of the motors, ohm.
        rated_voltage: Rated voltage of the motors, V.
        encoder_lines: Lines of the encoders on the motor shafts, read in quadrature; 0 for no encoders.
        linear_sensor: Whether sensors measure x and y (an axis: x).
        drive: What is commanded, for templates with DC motors: "voltage", "duty-cycle", "current", "torque",
            "position", "speed" or "stepper"; for a printer "position" or "stepper". The largest current,
            torque or holding torque is that of the motor at rest at its rated voltage, the largest speed the
            one without load; the gains of a loop and the damping of a stepper are typical ones.
        sensor: Further sensors, "KIND@PART" each: a kind of sensor, and the coordinate that it measures; for
            a current the drive, for a belt force the belt. Their noise and resolution are 0 unless `values`
            has them.
        values: Further values by full name, SI, for example {"x.coulomb": 2.0, "x_m.noise": 1e-5}.
    """

    travel: tuple[float, ...] | None = None
    mass: tuple[float, ...] | None = None
    pulley_radius: float | None = None
    travel_per_turn: float | None = None
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    Kt: float | None = None
    resistance: float | None = None
    rated_voltage: float | None = None
    encoder_lines: int | None = None
    linear_sensor: bool = True
    drive: str | None = None
    sensor: Sequence[str] = ()
    values: Mapping[str, float] = field(default_factory=dict)
