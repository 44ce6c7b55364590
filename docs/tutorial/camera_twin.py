"""An arm that is not quite as drawn, and a camera that takes pictures of a board on its flange. Nothing here is Kilter's.

    python camera_twin.py draw board.json     arm.urdf (as drawn), pictures/*.png, joints.csv and path.csv
    python camera_twin.py judge path.csv corrected.csv     how far the real tool leaves the path, before and after

MuJoCo moves the arm, OpenCV draws the board, and rays through a lens with distortion make pictures, with blur and noise.
"""

import csv
import json
import sys
from pathlib import Path

import cv2
import mujoco
import numpy as np

# name, place in m, rotation in rad (roll, pitch, yaw), mass in kg, its centre: about an arm with 0.9 m of reach
LINKS = [
    ("j1", (0, 0, 0.15), (0, 0, 0), 4.0, (0, 0, 0)),
    ("j2", (0, 0, 0), (np.pi / 2, 0, 0), 8.0, (-0.2, 0, 0.12)),
    ("j3", (-0.42, 0, 0), (0, 0, 0), 3.0, (-0.2, 0, 0.02)),
    ("j4", (-0.39, 0, 0.13), (0, 0, 0), 1.2, (0, 0, 0)),
    ("j5", (0, -0.1, 0), (np.pi / 2, 0, 0), 1.2, (0, 0, 0)),
    ("j6", (0, 0.1, 0), (-np.pi / 2, 0, 0), 0.4, (0, 0, 0)),
]
HOME = np.array([0.3, -1.4, 1.6, -0.3, 0.9, 0.2])
SOFT = np.array([0.0, 3e-5, 4e-5, 0.0, 0.0, 0.0])  # rad/(N m), by which gears 2 and 3 yield
WIDTH, HEIGHT, FOCAL = 1280, 960, 1300.0
K = np.array([[FOCAL, 0, 648.0], [0, FOCAL + 2.0, 471.0], [0, 0, 1]])
LENS = np.array([-0.09, 0.05, 4e-4, -3e-4, 0.0])
VIEWS, FINE, PER_MM = 40, 2, 6  # pictures, rays across a pixel, texture pixels in a mm


def urdf(rng=None):
    """The arm as drawn, or as it was built."""
    parts, before = ['<link name="base"/>'], "base"
    for name, place, turn, kg, centre in LINKS:
        off = np.zeros(6) if rng is None else np.append(rng.normal(0, 4e-4, 3), rng.normal(0, 2e-3, 3))
        xyz, rpy = (" ".join(map(repr, map(float, a))) for a in (place + off[:3], turn + off[3:]))
        com = " ".join(map(str, centre))
        parts.append(
            f'<link name="l{name}"><inertial><origin xyz="{com}"/><mass value="{kg}"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{before}"/><child link="l{name}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="3"/></joint>'
        )
        before = f"l{name}"
    return f'<robot name="twin">{"".join(parts)}</robot>'


class Arm:
    """An arm in MuJoCo; one that was built yields under its own weight, and its zeros are off."""

    def __init__(self, built):
        rng = np.random.default_rng(7)
        self.model = mujoco.MjModel.from_xml_string(urdf(rng if built else None))
        self.data = mujoco.MjData(self.model)
        self.zeros = rng.normal(0, 3e-3, 6) if built else np.zeros(6)
        self.soft = SOFT if built else np.zeros(6)

    def at(self, q):
        """Place (3,) and rotation (3, 3) of the flange."""
        self.data.qpos[:] = q + self.zeros
        mujoco.mj_forward(self.model, self.data)
        self.data.qpos[:] -= self.soft * self.data.qfrc_bias
        mujoco.mj_forward(self.model, self.data)
        return self.data.xpos[-1].copy(), self.data.xmat[-1].reshape(3, 3).copy()


def board_on_flange(board):
    """The board (4, 4) on the flange: its middle before it, its print away from the arm."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([np.pi, 0.0, 0.0]))[0] @ cv2.Rodrigues(np.array([0.03, -0.02, 0.2]))[0]
    middle = 5e-4 * board["square_mm"] * np.array([board["columns"], board["rows"], 0])
    T[:3, 3] = np.array([0.01, -0.02, 0.05]) - T[:3, :3] @ middle
    return T


def camera():
    """Where the camera stands (4, 4): 0.8 m from the board, looking at it."""
    p, R = Arm(built=False).at(HOME)
    z = -(R @ np.array([0.1, 0.15, 1.0]))
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), p - 0.85 * z
    return T


def texture(board):
    """The board as OpenCV draws it, with a white margin of one square."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, "DICT_" + board["dictionary"].upper()))
    size, square = (board["columns"], board["rows"]), board["square_mm"]
    ids = np.arange(board["columns"] * board["rows"] // 2) + board.get("first_id", 0)
    drawn = cv2.aruco.CharucoBoard(size, square, board["marker_mm"], known, ids)
    grey = drawn.generateImage(tuple(round(n * square * PER_MM) for n in size), marginSize=0)
    return cv2.copyMakeBorder(grey, *(round(square * PER_MM),) * 4, cv2.BORDER_CONSTANT, value=255)


def rays():
    """Directions (H, W, FINE², 2) of rays through every pixel, the lens undone."""
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    dv, du = np.meshgrid(fine, fine, indexing="ij")
    points = np.stack([u[..., None] + du.ravel(), v[..., None] + dv.ravel()], -1).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 1e-9)
    return cv2.undistortPoints(points, K, LENS, criteria=stop).reshape(HEIGHT, WIDTH, FINE**2, 2)


def picture(T, sheet, board, through, rng):
    """What the camera sees of a board that stands at T (4, 4) before it."""
    square, corners = board["square_mm"], outline(T, board)
    left, top = np.maximum(corners.min(0) - 60, 0).astype(int)
    right, bottom = corners.max(0).astype(int) + 60  # the rest of the picture is a grey wall
    through = through[top:bottom, left:right]
    H = np.linalg.inv(np.column_stack([T[:3, 0], T[:3, 1], T[:3, 3]]))  # from directions to the board's plane
    local = np.einsum("ij,hwkj->hwki", H[:, :2], through) + H[:, 2]
    mm = 1e3 * local[..., :2] / local[..., 2:]
    at = ((mm + square) * PER_MM - 0.5).astype(np.float32)
    grey = np.mean(
        [cv2.remap(sheet, at[:, :, k, 0], at[:, :, k, 1], cv2.INTER_LINEAR, borderValue=90) for k in range(FINE**2)],
        axis=0,
    )
    whole = np.full((HEIGHT, WIDTH), 90.0)
    whole[top:bottom, left:right] = grey
    light = 0.75 + 0.2 * np.linspace(0, 1, WIDTH)
    seen = cv2.GaussianBlur(20.0 + 0.8 * whole * light, (0, 0), 0.6)
    return np.clip(seen + rng.normal(0, 2.0, seen.shape), 0, 255).round().astype(np.uint8)


def outline(T, board):
    """Pixels (4, 2) of the board's outer corners."""
    w, h = (1e-3 * board["square_mm"] * n for n in (board["columns"], board["rows"]))
    corners = np.array([[0, 0, 0], [w, 0, 0], [w, h, 0], [0, h, 0]])
    return cv2.projectPoints(corners, T[:3, :3], T[:3, 3], K, LENS)[0].reshape(-1, 2)


def in_sight(T, board):
    """Whether the whole board is in the picture and faces the camera."""
    seen = outline(T, board)
    view = T[:3, 3] / np.linalg.norm(T[:3, 3])
    return bool((seen > 4).all() and (seen < [WIDTH - 4, HEIGHT - 4]).all() and view @ T[:3, 2] > 0.6)


def draw(board):
    """Write the arm as drawn, pictures of what was built, their joints, and a path."""
    rng, arm, looks = np.random.default_rng(1), Arm(built=True), np.linalg.inv(camera())
    sheet, through, mount = texture(board), rays(), board_on_flange(board)
    Path("arm.urdf").write_text(urdf())
    Path("pictures").mkdir(exist_ok=True)
    rows = []
    while len(rows) < VIEWS:
        q = np.radians(np.degrees(HOME + rng.uniform(-0.9, 0.9, 6)).round(3))
        T = np.eye(4)
        T[:3, 3], T[:3, :3] = arm.at(q)
        T = looks @ T @ mount
        if in_sight(T, board):
            name = f"pose{len(rows) + 1:02}.png"
            cv2.imwrite(f"pictures/{name}", picture(T, sheet, board, through, rng))
            rows.append([name, *np.degrees(q).round(3)])
    head = [f"q{j}_deg" for j in range(1, 7)]
    write("joints.csv", ["picture", *head], rows)
    t = np.linspace(0, 2 * np.pi, 60)[:, None]
    swing = 0.35 * np.sin(t * np.array([1, 1, 2, 1, 2, 3]) + np.arange(6))
    write("path.csv", head, np.degrees(HOME + swing).round(4).tolist())


def write(name, head, rows):
    """Write a table."""
    with open(name, "w", newline="") as file:
        csv.writer(file).writerows([head, *rows])


def judge(path, corrected):
    """Print how far the real tool leaves a path, before and after it was corrected."""

    def joints(name):
        with open(name) as file:
            return np.radians([[float(row[f"q{j}_deg"]) for j in range(1, 7)] for row in csv.DictReader(file)])

    def tool(arm, q):
        return np.array([arm.at(row)[0] for row in q])

    wanted, arm = tool(Arm(built=False), joints(path)), Arm(built=True)
    before, after = (1e3 * off(tool(arm, joints(name)), wanted) for name in (path, corrected))
    print(f"before: {before:.3f} mm\nafter: {after:.3f} mm")
    if after > 0.2 * before:
        sys.exit("The path has hardly become better.")


def off(real, wanted):
    """Mean distance m, the path placed where it fits best: a camera does not tell where the base stands."""
    a, b = real - real.mean(0), wanted - wanted.mean(0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return float(np.linalg.norm(b - a @ R.T, axis=1).mean())


if __name__ == "__main__":
    if sys.argv[1] == "draw":
        draw(json.loads(Path(sys.argv[2]).read_text()))
    else:
        judge(*sys.argv[2:])
