"""Where everything stands in the memory of the correction: rows and columns of the program, the scratch and the state.

``program`` (rows, COLUMNS) is what :func:`kilter_core.correct.program.compile_program` makes of a calibration: one row
per move (a joint element with the constant transform before it), one for the constant transform up to the tool, one per
joint, one per curve of a joint, two per bending row, M + 1 with the constants of the chain that loads are taken on where
it is not the nominal one, one for a base mount that deflects, one of scalars. Every move is rotated so that it is about
or along z; frame k is the joint frame after move k. ``memory`` holds the program, scratch (M + 1 + n + 6 rows), the
memory of one stream (n + 1 rows), and one row each for joints out and info: one array, because every array that crosses
from Python costs a tenth of a microsecond.
Angles rad, lengths m, masses kg, times s. Base frame throughout: the pose of the base cancels out of the task.

In the kernels ``P`` is the program, ``W`` the scratch, ``S`` the row of scalars, ``m`` the number of moves, ``n`` that
of joints, ``oj`` the first joint row and ``og`` the first task row of the scratch.
"""

from __future__ import annotations

COLUMNS = 48
# info: flags, limit mask, residual m, residual of all rows, error removed x y z m, iterations; then of the joints that are
# answered the remaining error of the tool, actual minus wanted: x y z m in the axes of the wanted base, the angle rad
INFO, REMOVED, LEFT, LEFT_TURN = 12, 4, 8, 11

# move rows
NOMINAL, IDENTIFIED, KIND, JOINT, RATIO, PRIMARY, MASS, COM, INERTIA = 0, 12, 24, 25, 26, 27, 28, 29, 32
CARRIED = 38  # of the load on an axis that follows a joint by a linkage: what of it the joint's gear carries
# joint rows
LOWER, UPPER, DQ, XI, TILT, TILT_SOFT, TILT_SHARE, PLAY, PLAY_SOFT = 0, 1, 2, 3, 9, 10, 11, 12, 13
REVERSAL, COMPLIANCE, RATE, LARGEST, SPEED, RADIAL, TWISTED, HARDENING, SIDED = 14, 15, 16, 17, 18, 19, 20, 21, 22
CHANGE, SPURT = 23, 24  # most rate and acceleration of the correction
FREE = 27  # 1, and 0 of a joint that the correction leaves as it is
TILT_OWN, PLAY_OWN = 25, 26  # half-widths of the signs as the version has them, before the correction softens them
# curve rows: a shape of the joint ``DRIVER`` added to the joint ``CURVED``: to its command where ``MOVED`` is 0, else to
# that component of the twist behind it, from 1
CURVED, SHAPE, DRIVER, AMPLITUDE_A, AMPLITUDE_B, FACTOR, EXTRA, POWERS, HIGHEST = 0, 1, 2, 3, 4, 5, 6, 8, 20
MOVED = 21
# where FADE is above 0 it holds from here to there, and fades to MEAN within FADE beyond
FROM, TO, FADE, MEAN = 22, 23, 24, 25
WAVE, LINEAR, SPRING, SINES, LAG, POLYNOMIAL = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
# bending rows: twist per wrench on the joint (6, 6), then the same per wrench on the end of the link; link vector; the
# twist is times a ``POWER`` of the length that stands out, ``WAY`` times (command less ``ROOTED``)
BENDING, BENDING_JOINT, BENDING_LINK, POWER, ROOTED, WAY = 0, 36, 37, 40, 41, 42
OF_AXIS = 43  # row of the twist, from 1, that is a motion of the joint itself; 0: none
# row of the base mount: constant transform of the base, then the one up to the first move; compliances, constant moment
BASE_FRAME, FIRST_MOVE, MOUNT_X, MOUNT_Y, FIXED_MOMENT_X, FIXED_MOMENT_Y = 0, 12, 24, 25, 26, 27
# scalars; FIRST: how many of the task rows come first
GRAVITY, ROWS, WEIGHT, ITERATIONS, STEP, SINGULAR, FARTHEST, RAMP, FILTER = 0, 3, 10, 16, 17, 18, 19, 20, 21
HYSTERESIS, LOADED, REACHED, N, M, WEAK, CURVES, BENDINGS, MOUNT, LOAD_CHAIN = 22, 23, 24, 25, 26, 27, 28, 29, 30, 31
FIRST, LEVERAGE, TURNED, SATURATES, ROUNDS = 32, 33, 34, 35, 36
# Rounds of loads where the arm hangs, after those at the command: with backlash and clearance in their middle, and then on
# their sides. 0: at the command alone.
HANGING, HANGING_SIDED = 37, 38
# Rows of doubts, the first and how many: boxes of joint values, their lowest and highest from these columns on, in which the
# version is less sure than it says. Joints beyond the columns bound no box.
DOUBT_AT, DOUBTS = 39, 40
LOWEST_OF_BOX, HIGHEST_OF_BOX = 0, 24
# scratch of a move: frame of the load chain, identified joint line, sine, cosine wanted, load of its body (M: payload)
LINE, SINE, COSINE, LOAD, ON_BASE = 12, 18, 19, 20, 26
BEHIND_TWIST = 28  # of a move: the frame that its body rides on where the arm hangs, behind the twist of its joint
# scratch of a joint
WANTED, COMMAND, SHIFT, TILT_A, TILT_B, SIDE, MOMENT, SPEED_NOW, ACCEL_NOW, SIGN = 0, 1, 2, 3, 4, 5, 6, 9, 10, 11
COLUMN, REVERSED_AT_NEW, SMOOTH_NEW, SMOOTH_SPEED_NEW, GUESSED, TWIST, ROOT, END = 12, 18, 19, 20, 21, 22, 28, 34
# last step of the search; offset of the ramp; correction with it, and as it is answered; a rate on the way
STEPPED, RAMPED, TOTAL, NEXT, WISH = 40, 41, 42, 43, 45
KEPT = 45  # three columns: signs as they are held, while what is left is told by those of the version
# scratch of a task row: factor row, residual, multiplier, right-hand side, then a row of J J', and what the present
# correction adds to the residual
ERROR, MULTIPLIER, RIGHT, MATRIX, ADDED = 6, 7, 8, 9, 15
# state of a joint, and of the stream (row n)
LAST_A, LAST_B, LAST_SIDE, LAST_Q, REVERSED_AT, LAST_SIGN = 0, 1, 2, 3, 4, 5
OFFSET, LAST_DELTA, SMOOTH, SMOOTH_SPEED, GUESS, SLOPE = 6, 7, 8, 9, 10, 11
# rate of the answers; what they follow, before and after the point is held (the latter in the scratch of a joint too)
VELOCITY, TARGET, AIMED = 12, 13, 44
STARTED, REBASE, REMAINING, LENGTH, BEHIND = 0, 1, 2, 3, 4

OK, NOT_FINITE, JOINT_LIMIT, TOO_LARGE, RATE_LIMIT = 0, 5, 6, 7, 8
# REVERSING: clearance or backlash changes sides, softly or at its rate; SATURATED: the correction is held at its limit;
# SLOWED: it is held back by the bound on its own rate or acceleration. UNSURE: the version is less sure there than it says.
# NEAR_REVERSAL: a sign is softened; it is not answered.
DYNAMIC, RAMPING, REVERSING, DAMPED, RESIDUAL = 0x0100, 0x0200, 0x0400, 0x0800, 0x1000
SATURATED, SLOWED, UNSURE, NEAR_REVERSAL = 0x2000, 0x4000, 0x8000, 0x10000
