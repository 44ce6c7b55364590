"""One joint of an arm between its command and its reading, in time: servo, motor, gear, friction and sensor, compiled.

The bodies behind the joint are given along the motion that was measured: what they weigh on the joint (its load) and their
inertia. Steps are those of MuJoCo: the new speed moves the joint, damping is implicit. Friction holds a joint still, or lets
it creep as MuJoCo's does: by how much it resists (its impedance) and how fast.
"""

from __future__ import annotations

import math

import numpy as np

from kilter_core.arm.kernels.compiled import compile_kernel
from kilter_core.types import Floats

ALONE = {"error_model": "numpy", "nogil": True}  # joints are fitted side by side
# places of the numbers of a joint
ARMATURE, FRICTION, DAMPING, GAIN, COMMAND_DELAY, EFFORT_DELAY, TORQUE_LIMIT = range(7)
BACKLASH, LOAD_FRICTION, STICK, COMPLIANCE, READING_OFFSET, ZERO_OFFSET, SENSOR_LAG, BEHIND, SERVO_SHARE = range(7, 16)
SLIP_SPEED, IMPEDANCE, RATE, READS_BEHIND, MOVING_LOAD, GEAR_DAMPING = range(16, 22)
COUNT = 22
LEAST_ARMATURE_SHARE = 0.02  # of the inertia of the bodies, that a motor before backlash or a soft gear has at least
STEADY = (
    1.0  # square of a step in radians of the swing of a gear, beyond which its spring is taken at the end of a step
)


PARTS, LEAST_PART = 4, 1e-9  # of a step in which backlash opens and closes, at most, and the least that is simulated


@compile_kernel(**ALONE)
def _command_sum(times: Floats, sums: Floats, commands: Floats, place: int, t: float) -> tuple[float, int]:
    """Integral of the held command up to ``t``, and the row that holds there."""
    last = len(times) - 1
    while place < last and times[place + 1] <= t:
        place += 1
    while place > 0 and times[place] > t:
        place -= 1
    return sums[place] + commands[place] * (t - times[place]), place


@compile_kernel(**ALONE)
def _speed_after_friction(
    momentum: float, mass: float, speed: float, f: float, step: float, impedance: float, rate: float
) -> float:
    """Speed after a step of a joint that would have ``momentum`` without friction ``f`` (MuJoCo: Computation, friction)."""
    free = momentum / mass
    wanted = impedance * (-rate * speed - (free - speed) / step) if rate > 0.0 else -free / step
    return free + step * min(max(mass * wanted, -f), f) / mass


@compile_kernel(**ALONE)
def _friction(p: Floats, carried: float, speed: float) -> float:
    """Dry friction of the gear under what it ``carried``."""
    f = p[FRICTION] + p[LOAD_FRICTION] * abs(carried)
    if p[STICK] > 0.0:
        f += p[STICK] * math.exp(-((speed / p[SLIP_SPEED]) ** 2))
    return f


@compile_kernel(**ALONE)
def _late_torque(past: Floats, k: int, late: float, torque: float) -> float:
    """Torque that acts ``late`` steps after it is asked for, from the ring ``past``; before the first, the first."""
    length = len(past)
    past[k % length] = torque
    n = int(late)
    share = late - n
    return (1.0 - share) * past[(k - min(n, k)) % length] + share * past[(k - min(n + 1, k)) % length]


@compile_kernel(**ALONE)
def _step_rigid(p: Floats, step: float, v: float, M: float, push: float, damping: float, f: float) -> float:
    """New speed of a joint whose gear is rigid."""
    J = p[ARMATURE] + M
    return _speed_after_friction(J * v + step * push, J + step * damping, v, f, step, p[IMPEDANCE], p[RATE])


@compile_kernel(**ALONE)
def _step_compliant(
    p: Floats, step: float, state: Floats, M: float, tau: float, weight: float, damping: float, f: float
) -> None:
    """Move motor and bodies that a spring holds together; friction acts on the motor.

    As in MuJoCo the spring pulls as it is at the beginning, its damping as it is at the end of a step; a spring too stiff for
    that is taken at the end too.
    """
    q, v, motor, w = state[0], state[1], state[2], state[3]
    A = max(p[ARMATURE], LEAST_ARMATURE_SHARE * M)
    stiff = 1.0 / p[COMPLIANCE]
    both = A * M / (A + M)
    s = step * p[GEAR_DAMPING] * stiff
    if step * step * stiff > STEADY * both:
        s += step * step * stiff
    pull = step * stiff * (q - motor)
    bodies = M * v - step * weight - pull
    momentum = A * w + step * tau + pull + s * bodies / (M + s)
    w = _speed_after_friction(momentum, A + s + step * damping - s * s / (M + s), w, f, step, p[IMPEDANCE], p[RATE])
    v = (bodies + s * w) / (M + s)
    state[0], state[1], state[2], state[3] = q + step * v, v, motor + step * w, w


@compile_kernel(**ALONE)
def _move_apart(
    p: Floats, step: float, state: Floats, A: float, M: float, tau: float, weight: float, damping: float, f: float
) -> tuple[float, int]:
    """Move motor and bodies that do not touch, until they do; return the time that is left then, and the side (0: none)."""
    w = _speed_after_friction(A * state[3] + step * tau, A + step * damping, state[3], f, step, p[IMPEDANCE], p[RATE])
    v = state[1] - step * weight / M
    half, before, closing = 0.5 * p[BACKLASH], state[2] - state[0], step * (w - v)
    side = 0
    if abs(before + closing) >= half:
        side = 1 if before + closing > 0.0 else -1
    flown = 1.0
    if side != 0:
        flown = min(max((half * side - before) / closing, 0.0), 1.0) if closing * side > 0.0 else 0.0
    state[2] += flown * step * w
    state[3] += flown * (w - state[3])
    state[1] += flown * (v - state[1])
    state[0] = state[2] - half * side if side != 0 else state[0] + step * v
    if side != 0:
        state[1] = state[3] = (A * state[3] + M * state[1]) / (A + M)
    return (1.0 - flown) * step, side


@compile_kernel(**ALONE)
def _step_with_backlash(
    p: Floats, step: float, state: Floats, side: int, M: float, tau: float, weight: float, damping: float, f: float
) -> int:
    """Move motor and bodies with backlash between them; return the side on which they touch, 0 for none.

    A step is parted where they meet: what is read has no jump then as the width or the servo changes.
    """
    A = max(p[ARMATURE], LEAST_ARMATURE_SHARE * M)
    mass, left = A + M, step
    for k in range(PARTS):
        if side != 0 and left > 0.0:
            v = state[1]
            new = _speed_after_friction(
                mass * v + left * (tau - weight), mass + left * damping, v, f, left, p[IMPEDANCE], p[RATE]
            )
            if k == PARTS - 1 or (M * (new - v) / left + weight) * side >= 0.0:  # the motor pushes the bodies still
                state[0] += left * new
                state[1] = state[3] = new
                state[2] = state[0] + 0.5 * p[BACKLASH] * side
                return side
        if left <= LEAST_PART * step:
            return side
        left, side = _move_apart(p, left, state, A, M, tau, weight, damping, f)
    return side


@compile_kernel(**ALONE)
def _begin(p: Floats, reading: float, speed: float, load: float, state: Floats) -> int:
    """Set angle and speed of bodies and motor by a first reading; return the side on which backlash touches."""
    angle, side, apart = reading - p[READING_OFFSET], 0, 0.0
    if p[COMPLIANCE] > 0.0:
        apart = p[COMPLIANCE] * load
    elif p[BACKLASH] > 0.0:
        side = 1 if load >= 0.0 else -1
        apart = 0.5 * p[BACKLASH] * side
    reads_behind = p[READS_BEHIND] > 0.5
    state[0] = angle if reads_behind else angle - apart
    state[1] = state[3] = speed
    state[2] = angle + apart if reads_behind else angle
    return side


@compile_kernel(**ALONE)
def simulate_joint(
    p: Floats,
    times: Floats,
    commands: Floats,
    sums: Floats,
    step: float,
    bodies: Floats,
    start_speed: float,
    out: Floats,
) -> None:
    """Fill ``out (N,)`` with the reading at ``times (N,)`` of a joint that follows ``commands (N,)``, each held to the next.

    ``out[0]`` is the first reading. ``bodies (4, K)`` stand at steps of ``step``: load N m, its slope N m/rad, inertia kg m2,
    and the angle rad about which the load is taken. ``sums (N,)`` are integrals of the held command.
    """
    state = np.zeros(4)
    side = _begin(p, out[0], start_speed, bodies[0, 0], state)
    two = p[BACKLASH] > 0.0 or p[COMPLIANCE] > 0.0
    past = np.zeros(math.ceil(p[EFFORT_DELAY] / step) + 2)
    servo = p[DAMPING] * p[SERVO_SHARE]
    damping = p[DAMPING] - servo
    implicit = servo if not two and p[EFFORT_DELAY] == 0.0 else 0.0
    lagged = before = out[0] - p[READING_OFFSET]
    row, accelerated = 1, 0.0
    a, place = _command_sum(times, sums, commands, 0, times[0] - p[COMMAND_DELAY])
    for k in range(bodies.shape[1]):
        t = times[0] + k * step
        b, place = _command_sum(times, sums, commands, place, t + step - p[COMMAND_DELAY])
        command, a = (b - a) / step, b
        weight = bodies[0, k] + bodies[1, k] * (state[0] - p[ZERO_OFFSET] - bodies[3, k])
        M = bodies[2, k]
        sensed = 0 if p[BEHIND] > 0.5 or not two else 2
        tau = p[GAIN] * (command - state[sensed]) - servo * state[sensed + 1]
        if p[EFFORT_DELAY] > 0.0:
            tau = _late_torque(past, k, p[EFFORT_DELAY] / step, tau)
        held = implicit
        if p[TORQUE_LIMIT] > 0.0 and abs(tau) > p[TORQUE_LIMIT]:
            tau, held = math.copysign(p[TORQUE_LIMIT], tau), 0.0
        f = _friction(p, weight + p[MOVING_LOAD] * M * accelerated, state[3] if two else state[1])
        speed = state[1]
        if p[COMPLIANCE] > 0.0:
            _step_compliant(p, step, state, M, tau, weight, damping, f)
        elif two:
            side = _step_with_backlash(p, step, state, side, M, tau, weight, damping, f)
        else:
            state[1] = _step_rigid(p, step, speed, M, tau + held * speed - weight, damping + held, f)
            state[0] += step * state[1]
        accelerated = (state[1] - speed) / step
        reading = state[0] if p[READS_BEHIND] > 0.5 or not two else state[2]
        if p[SENSOR_LAG] > 0.0:
            lagged += (reading - lagged) * (1.0 - math.exp(-step / p[SENSOR_LAG]))
            reading = lagged
        while row < len(times) and times[row] <= t + step + 1e-12:
            out[row] = before + (times[row] - t) / step * (reading - before) + p[READING_OFFSET]
            row += 1
        before = reading
    out[row:] = before + p[READING_OFFSET]
