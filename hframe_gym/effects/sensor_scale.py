"""Scale error of a sensor: it measures (1 + g) times the true value r, with a constant relative error g.

The scale error of an encoder on a pulley or screw has the same effect on the measurements as a wrong travel
per turn.
"""

from ..machine import Effect, EffectParameter, Machine, rigid_motions


def measurement(r, g):  # type: ignore[no-untyped-def]
    """Return the measurement (1 + g) r, m or rad; r: true value; g: relative scale error, dimensionless."""
    return r + g * r


def fits(machine: Machine) -> bool:
    """Return whether a scale error can be identified: there must be more motion sensors than rigid motions.

    If a single sensor measures an axis, a scale error cannot be distinguished from masses and forces that are
    wrong by the same factor. The current of the motor does not distinguish them either, because the back-EMF
    constant may be wrong as well.
    """
    of_motion = [sensor for sensor in machine.sensors if sensor.sensed.component == "coordinate"]
    return len(of_motion) > max(1, len(rigid_motions(machine)))


def equivalent_site(machine: Machine, site: str, other: str) -> bool:
    """Return whether no recording can distinguish a scale error of one sensor from that of another.

    This is so if only these two measure the position of a linear axis: masses and forces that are wrong by
    the same factor compensate the difference. Belts to other coordinates, a third sensor, or a drive that
    follows set points reveal which scale is right.
    """
    measuring = {
        sensor.channel: sensor for sensor in machine.sensors if sensor.sensed.component == "coordinate"
    }
    coordinate = measuring[site].coordinate
    pair = {channel for channel, sensor in measuring.items() if coordinate in sensor.row}
    alone = pair == {site, other} and all(
        measuring[channel].of_position and len(measuring[channel].row) == 1 for channel in pair
    )
    free = not machine.belts and not machine.drive_laws
    return alone and free and machine.coordinate(coordinate).kind == "linear"


EFFECT = Effect(
    name="sensor_scale",
    site="sensor",
    formula="measurement = (1 + g) r",
    source="sensor calibration error",
    measurement=measurement,
    equivalent=("a wrong travel per turn (radius of a pulley, lead of a screw)",),
    equivalent_site=equivalent_site,
    fits=fits,
    fits_site=Machine.measures_position,
    # From a tenth to ten times the declared scale; the search starts from errors of about 1 %.
    parameters=(EffectParameter("g", "1", -0.9, 9.0, scale=0.01, role="amplitude"),),
)
