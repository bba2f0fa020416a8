"""Compare the simulator's belts and additional bodies with energies, closed forms and the paper's modes."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.reference_simulator import Frame, Payload, Rig, Stage, Yaw, simulate
from tests.reference_simulator.equations import derivative
from tests.reference_simulator.parameter_arrays import parameter_arrays

pytestmark = pytest.mark.oracle

R = 0.0194
EA, LENGTHS = 13906.5, (1.3954, 1.3954, 1.2827)
SMOOTH = {"coulomb": (0.0,) * 4}  # without dry friction there are no events, and SciPy can integrate
PER_VOLT, BACK = 5.9 * 0.023 / 0.71, (5.9 * 0.023) ** 2 / 0.71


def _stretch(q, eccentricity=0.0, phase=0.0, half_width=0.0):
    """Return the extensions of the left, right and bottom belt from x, y, phi1, phi2 and the bridge's yaw."""
    x, y, phi1, phi2, yaw = q
    a = R * phi1
    b = R * phi2 + eccentricity * np.sin(phi2 + phase)
    return a + x + half_width * yaw + y, -b + x - half_width * yaw - y, b - a - 2 * x


def _lengths(q):
    x, y = q[:2]
    return LENGTHS[0] + x + y, LENGTHS[1] + x - y, LENGTHS[2] - 2 * x


def _slack(s, k, tension):
    """Return the energy of a belt whose tension change cannot fall below -tension."""
    edge = tension / k
    return np.where(s.real > -edge, 0.5 * k * s * s, -tension * s - 0.5 * tension * edge)


ENERGIES = {
    "plain": ({}, lambda s, k: 0.5 * k * s * s, {}),
    "play": (
        {"belt_play_m": 1e-4},
        lambda s, k: 0.5 * k * np.where(abs(s.real) > 1e-4, s - 1e-4 * np.sign(s.real), 0.0) ** 2,
        {},
    ),
    "slack": ({"belt_pretension_N": 12.0}, lambda s, k: _slack(s, k, 12.0), {}),
    "hardening": ({"belt_hardening": 5e4}, lambda s, k: 0.5 * k * s * s + 0.25 * k * 5e4 * s**4, {}),
    "eccentric": (
        {"eccentricity_m": (0.0, 5e-4), "eccentricity_phase": (0.0, 0.7)},
        lambda s, k: 0.5 * k * s * s,
        {"eccentricity": 5e-4, "phase": 0.7},
    ),
    "yaw": ({"yaw": Yaw()}, lambda s, k: 0.5 * k * s * s, {"half_width": 0.3}),
}


@pytest.mark.parametrize("name", ENERGIES)
def test_belts_follow_from_their_energy(name):
    fields, energy, geometry = ENERGIES[name]
    rig = Rig(**SMOOTH, **fields)
    time_s = np.arange(161) * 1e-3
    inputs = np.repeat(np.random.default_rng(8).uniform(-6.0, 6.0, (9, 2)), 20, axis=0)[:161]
    stage = Stage(rig, (0.05, -0.03))
    start = np.append(stage._z[:4], 0.0)
    simulated, _ = simulate(rig, time_s, inputs, (0.05, -0.03))
    yaw = Yaw()
    mass = np.array([*rig.mass, yaw.inertia])
    viscous = np.array([*rig.viscous, yaw.viscous])
    viscous[2:4] += BACK

    def potential(q):
        total = 0.5 * yaw.stiffness * q[4] ** 2
        for s, length in zip(_stretch(q, **geometry), _lengths(q), strict=True):
            total = total + energy(s, EA / length)
        return total

    def rhs(t, z, volts):
        q, v = z[:5], z[5:]
        force = -potential(q[:, None] + 1e-30j * np.eye(5)).imag / 1e-30 - viscous * v
        force[2:4] += PER_VOLT * volts
        return np.concatenate([v, force / mass])

    z, rows = np.concatenate([start, np.zeros(5)]), [np.append(start[:4], 0.0)]
    for a, volts in zip(time_s[:-1], inputs[:-1], strict=True):
        z = solve_ivp(rhs, (a, a + 1e-3), z, "DOP853", args=(volts,), rtol=1e-9, atol=1e-12).y[:, -1]
        rows.append(z[:5])
    expected = np.array(rows)
    tool = expected[:, :4].copy()
    tool[:, 0] += expected[:, 1] * expected[:, 4]
    assert np.ptp(tool, axis=0).min() > 1e-3
    error = np.abs(simulated - tool) * [1.0, 1.0, R, R]
    assert error.max() < (2e-9 if name in ("play", "slack") else 1e-10)  # SciPy steps over the kinks
    if name != "plain":
        other, _ = simulate(Rig(**SMOOTH), time_s, inputs, (0.05, -0.03))
        assert (np.abs(simulated - other) * [1.0, 1.0, R, R]).max() > 5e-6  # the effect is visible


def test_belt_damping_gives_a_damped_oscillation():
    """With bridge and cart held, the motors on the bottom belt are an oscillator of known damping."""
    heavy = Rig(
        mass=(1e9, 1e9, 1.12e-4, 1.12e-4),
        viscous=(0.0,) * 4,
        belt_EA_N=(1e-9, 1e-9, EA),
        belt_damping_s=5e-4,
        torque_constant=(0.0, 0.0),
        **SMOOTH,
    )
    stage = Stage(heavy)
    stage._z[2], stage._z[3] = 0.01, -0.01
    stage.step((0.0, 0.0), 0.02)
    w = math.sqrt(2.0 * EA / LENGTHS[2] * R**2 / 1.12e-4)
    zeta = 0.5 * 5e-4 * w
    wd = w * math.sqrt(1.0 - zeta**2)
    expected = 0.01 * math.exp(-zeta * w * 0.02) * (math.cos(wd * 0.02) + zeta * w / wd * math.sin(wd * 0.02))
    assert stage.position[2] == pytest.approx(expected, rel=1e-6)


def test_idlers_have_the_modes_of_the_20th_order_model():
    rig = Rig(idlers=True, length_follows=True)
    arrays, _ = parameter_arrays(rig)
    n = len(arrays.coordinates)
    assert n == 10
    assert arrays.coordinates["mass"][1] == pytest.approx(0.4460, abs=2e-4)
    stage = Stage(rig, (-0.2227, -0.1163))  # where the paper's Table 1 holds
    stiffness = np.empty((n, n))
    for i in range(n):
        z = stage._z.copy()
        z[i] += 1e-7
        force, level, dz = np.empty(n), np.empty(n), np.empty_like(z)
        derivative(0.0, z, np.zeros(2), np.ones(n), arrays, dz, force, level)
        stiffness[:, i] = -force / 1e-7
    scale = 1.0 / np.sqrt(arrays.coordinates["mass"])
    hertz = np.sqrt(np.abs(np.linalg.eigvalsh(0.5 * scale * (stiffness + stiffness.T) * scale[:, None]))) / (
        2 * np.pi
    )
    assert hertz[2:] == pytest.approx([41.29, 57.53, 80.74, 98.64, 114.55, 121.92, 219.71, 232.07], abs=0.02)
    assert hertz[:2].max() < 1.0


def test_slow_motion_with_idlers_equals_that_of_the_8th_order_stage():
    time_s, inputs = np.arange(301) * 1e-3, np.full((301, 2), -4.0)
    many, _ = simulate(Rig(idlers=True), time_s, inputs)
    few, _ = simulate(Rig(), time_s, inputs)
    assert few[-1, 1] > 0.1
    assert 1e-6 < np.abs(many - few)[:, :2].max() < 1e-3


def test_payload_swings_at_its_natural_frequency():
    """With the cart held, a displaced payload is a damped oscillator."""
    rig = Rig(mass=(4.07, 1e9, 1.12e-4, 1.12e-4), payload=Payload(0.25, 160.0, 0.6))
    stage = Stage(rig)
    payload = stage._n - 1
    stage._z[payload] = 0.01
    stage.step((0.0, 0.0), 0.3)
    w, zeta = math.sqrt(160.0 / 0.25), 0.6 / (2.0 * math.sqrt(160.0 * 0.25))
    wd = w * math.sqrt(1.0 - zeta**2)
    expected = 0.01 * math.exp(-zeta * w * 0.3) * (math.cos(wd * 0.3) + zeta * w / wd * math.sin(wd * 0.3))
    assert stage._z[payload] == pytest.approx(expected, rel=1e-5)


def test_frame_responds_to_the_acceleration_of_the_bridge():
    """A constant force on a bridge without friction and belts gives the step response of the frame."""
    frame = Frame(11.0, 0.05, 0.05)
    push = 4.07  # 1 m/s^2
    rig = Rig(
        constant_force=(push, 0.0, 0.0, 0.0), viscous=(0.0,) * 4, belt_EA_N=(1e-9,) * 3, frame=frame, **SMOOTH
    )
    q, _ = simulate(rig, np.array([0.0, 0.2]), np.zeros((2, 2)))
    w, zeta, t = 2.0 * math.pi * 11.0, 0.05, 0.2
    wd = w * math.sqrt(1.0 - zeta**2)
    still = math.exp(-zeta * w * t) * (math.cos(wd * t) + zeta * w / wd * math.sin(wd * t))
    assert q[-1, 0] == pytest.approx(0.5 * t * t - 0.05 / w**2 * (1.0 - still), abs=1e-10)


def test_motor_crosses_the_backlash_before_the_pulley_moves():
    rig = Rig(backlash_rad=(0.02, 0.0))
    stage = Stage(rig)
    angles = []
    for until in np.arange(1, 200) * 1e-4:
        stage.step((3.0, 0.0), until)
        motor, pulley = stage.position[2], stage._z[2]
        angles.append((motor, pulley))
        assert motor - pulley < 0.02 + 0.01  # the teeth are elastic
    motor, pulley = np.array(angles).T
    free = motor < 0.02
    assert free.sum() > 5
    assert np.all(pulley[free] == 0.0)
    assert pulley[-1] > 0.02


@pytest.mark.parametrize(
    "fields", [{"idlers": True, "yaw": Yaw()}, {"belt_pretension_N": 10.0, "belt_play_m": 1e-4}]
)
def test_unsupported_combinations_raise(fields):
    with pytest.raises(ValueError, match=r"yaw|slack"):
        parameter_arrays(Rig(**fields))
