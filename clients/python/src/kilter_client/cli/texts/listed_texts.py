"""What the command lists without a server, made by `make contract`: change it where it stands."""

from __future__ import annotations

METHODS: list[dict[str, str]] = [
    {"id": "least_squares", "summary": "all poses together, weighted, with the exact Jacobian; take it first"},
    {"id": "pose_pseudo_inverse", "summary": "pose by pose, and the mean of the answers (thesis 3.6)"},
    {"id": "influence", "summary": "pose by pose, each weighted by its influence (thesis 3.7, 3.8)"},
    {"id": "kalman", "summary": "continue a version with the rows of a new campaign alone"},
    {"id": "global_search", "summary": "search a box first: zeros off by a turn, another description"},
    {"id": "linear_least_squares", "summary": "the problem linearised at the start, solved once"},
]
PRESETS: list[dict[str, str]] = [
    {
        "id": "iiwa14",
        "joints": "7",
        "convention": "dh",
        "masses": "no masses",
        "source": "KUKA LBR iiwa 14 R820, data sheet and dimensions of the specification, to the flange without a media flange; KUKA publishes no masses of the links",
    },
    {
        "id": "irb120",
        "joints": "6",
        "convention": "dh",
        "masses": "no masses",
        "source": "ABB IRB 120-3/0.6, dimensions and limits of the product specification (axis 6 without software limit: 400 deg); ABB publishes no masses of the links",
    },
    {
        "id": "katana450-chapter3",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "thesis table 3.1 and eq. 3.2; links of table 4.2",
    },
    {
        "id": "katana450-chapter4",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "thesis eq. 4.2-4.7; links of table 4.2",
    },
    {
        "id": "katana450-chapter5",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "thesis table 5.1 and eq. 5.6; links of table 4.2; attachment of 130 mm as the tool",
    },
    {
        "id": "koch",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "google-deepmind/mujoco_menagerie (Apache-2.0), low_cost_robot_arm/low_cost_robot_arm.xml, commit 464b5ae8: the follower of Koch v1.1, joints named as LeRobot names them; approximate limits of the source; tool at the frame of the static finger, the moving one held at zero; stiffness of the drives: rough, as of other servos of its class",
    },
    {
        "id": "kr6-r900",
        "joints": "6",
        "convention": "chain",
        "masses": "no masses",
        "source": "KUKA KR 6 R900 sixx (KR AGILUS), dimensions and limits of the specification; a DH chain whose axes 1, 4 and 6 count backwards, as the controller's do; KUKA publishes no masses of the links",
    },
    {
        "id": "lekiwi",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "the SO-101 follower that LeKiwi carries on its base (its README names the arm; joints named as LeRobot's lekiwi names them), TheRobotStudio/SO-ARM100 (Apache-2.0), Simulation/SO101/so101_new_calib.urdf, commit 0aee1d0f: zero in the middle of each range (the new zero); tool at gripperframe, the jaw held at zero; right angles, which the source rounds, are exact; the base of the arm is the robot's base, without its wheels; stiffness of the drives: a servo of it deflects by 1.8 to 2.6 degrees under 1.47 N m",
    },
    {
        "id": "panda",
        "joints": "7",
        "convention": "mdh",
        "masses": "with masses",
        "source": "Franka Emika, robot and interface specifications: nominal DH (Craig) to the flange, limits of the data sheet; masses and centres of mass identified by C. Gaz et al., IEEE RA-L 4(4), 2019, as in franka_description",
    },
    {
        "id": "so100",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "TheRobotStudio/SO-ARM100 (Apache-2.0), Simulation/SO100/so100.urdf, commit 0c8e2892: the zero of that file, which is not the middle of the ranges; tool at the frame of the fixed jaw, the moving jaw held at zero; right angles, which the source rounds, are exact; stiffness of the drives: a servo of it deflects by 1.8 to 2.6 degrees under 1.47 N m",
    },
    {
        "id": "so101",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "TheRobotStudio/SO-ARM100 (Apache-2.0), Simulation/SO101/so101_new_calib.urdf of the follower, commit 0aee1d0f: zero in the middle of each range (the new zero); tool at gripperframe, the jaw held at zero; right angles, which the source rounds, are exact; stiffness of the drives: a servo of it deflects by 1.8 to 2.6 degrees under 1.47 N m",
    },
    {
        "id": "so101-leader",
        "joints": "5",
        "convention": "chain",
        "masses": "with masses",
        "source": "TheRobotStudio/SO-ARM100 (Apache-2.0), Simulation/SO101/so101_leader_new_calib.urdf, commit 02aab7d8: zero in the middle of each range (the new zero); tool at handle_frame_link, the trigger held at zero; inertias of its printed parts are estimates of the source; right angles, which it rounds, are exact",
    },
    {
        "id": "ur10",
        "joints": "6",
        "convention": "dh",
        "masses": "with masses",
        "source": "Universal Robots DH and mass tables (UR10, CB series)",
    },
    {
        "id": "ur10e",
        "joints": "6",
        "convention": "dh",
        "masses": "with masses",
        "source": "Universal Robots, article 'DH parameters for calculations of kinematics and dynamics': nominal DH, masses and centres of mass; limits of the data sheet (UR10e)",
    },
    {
        "id": "ur3e",
        "joints": "6",
        "convention": "dh",
        "masses": "with masses",
        "source": "Universal Robots, article 'DH parameters for calculations of kinematics and dynamics': nominal DH, masses and centres of mass; limits of the data sheet (UR3e)",
    },
    {
        "id": "ur5e",
        "joints": "6",
        "convention": "dh",
        "masses": "with masses",
        "source": "Universal Robots, article 'DH parameters for calculations of kinematics and dynamics': nominal DH, masses and centres of mass; limits of the data sheet (UR5e)",
    },
]
COLUMNS: list[dict[str, str]] = [
    {
        "columns": "q1_deg … qn_deg",
        "meaning": "joint readings, all of them in every row. _rad instead of _deg; _mm for a prismatic joint",
    },
    {"columns": "x_mm, y_mm, z_mm", "meaning": "position of the tool point. _m instead of _mm"},
    {"columns": "qw, qx, qy, qz", "meaning": "orientation of the tool, a unit quaternion"},
    {"columns": "phi_deg, theta_deg, psi_deg", "meaning": "or as ZXZ Euler angles; _rad instead of _deg"},
    {
        "columns": "m1x_mm, m1y_mm, m1z_mm, m2x_mm …",
        "meaning": "or markers on the tool. A marker that was not seen is an empty cell, never zero. One reflector moved between three nests is three markers, one in a row: visit the same poses with each",
    },
    {
        "columns": "tipx_mm, tipy_mm, tipz_mm",
        "meaning": "beside markers: a point of the tool digitised with a probe while the markers were visible; it is then the tool point instead of their mean. Empty cells in all other rows",
    },
    {
        "columns": "socket_id, plane_id",
        "meaning": "or, without an instrument, the ball socket or the plane that held the tool's ball: 1, 2, … and 0 for none.",
    },
    {
        "columns": "bar_id, bar_mm",
        "meaning": "or the ball bar (its centre mount, 1, 2, …, 0 for none) and the length it read, centre to centre",
    },
    {
        "columns": "link1_deg … linkn_deg",
        "meaning": "or the angle behind gear and backlash, from link-side encoders, also beside the tool",
    },
    {
        "columns": "cmd1_deg … cmdn_deg",
        "meaning": "beside the readings: where the controller sent the joints. Nothing is fitted to it; readings that follow the motion's sign are warned of",
    },
    {
        "columns": "tilt1x_deg …",
        "meaning": "or the rotation of joint 1 about axis x (y, z) of its frame beyond its command, from inclinometers: only the columns that were read, empty cells where nothing was read. session counts the mountings. Jobs of kind joint_parameters read them alone, identify and gap beside the tool",
    },
    {
        "columns": "tilt0x_deg, tilt0y_deg",
        "meaning": "or the rotation of the base about axis x (y, z) of the robot's base frame, from an inclinometer on the base, up to a constant in every session; an axis that stands upright is refused. Only identify and gap read it, beside the tool",
    },
    {
        "columns": "u1_px, v1_px …",
        "meaning": "or corner 1, 2, … of a board that a camera saw in this row: pixels, the centre of the top left one (0, 0), u to the right and v down, as OpenCV has it. Other programs put (0.5, 0.5) there: take half a pixel off. Cells of a corner that was not seen are empty. Cameras and boards are described in the campaign's conditions (cameras, boards)",
    },
    {
        "columns": "su1_px, sv1_px …",
        "meaning": "standard deviation of that corner, px; where none is given all weigh alike",
    },
    {
        "columns": "camera, board",
        "meaning": "which camera saw which board, by name or by number from 1; only where the campaign has several. In Parquet and JSON columns too",
    },
    {"columns": "t_s", "meaning": "time"},
    {"columns": "qd1_deg_s …, qdd1_deg_s2 …", "meaning": "joint velocities and accelerations"},
    {"columns": "tau1_nm …", "meaning": "measured joint torques"},
    {"columns": "dir1 … dirn", "meaning": "last motion of that joint: −1, 0 or +1"},
    {"columns": "payload_kg", "meaning": "mass at the tool point"},
    {
        "columns": "payload_com_x_mm, payload_com_y_mm, payload_com_z_mm",
        "meaning": "beside payload_kg: the centre of that mass in the tool frame. _m instead of _mm",
    },
    {
        "columns": "fx_n, fy_n, fz_n and mx_nm, my_nm, mz_nm",
        "meaning": "force and moment on the tool point, in the tool frame (those of a process or a hanging cable). One of the two groups is enough",
    },
    {
        "columns": "load3_kg, load3_x_mm …",
        "meaning": "a mass on the link of joint 3 beyond what the robot states, and its place. The place is in the frame in which the robot states centres of mass; both may differ from row to row.",
    },
    {
        "columns": "load3_fx_n …, load3_mx_nm …",
        "meaning": "force and moment on the link of joint 3, about the origin and in the axes of the same frame. One of the two groups is enough",
    },
    {"columns": "temperature_c", "meaning": "temperature"},
    {
        "columns": "base_tilt_x_deg, base_tilt_y_deg",
        "meaning": "what an inclinometer on the base or column read about x and y of the base frame, as a condition that enters the model; any zero, the same in all rows. A trajectory to be corrected may state it row by row",
    },
    {"columns": "session", "meaning": "integer: one setting-up of tracker and markers"},
    {"columns": "pose_id", "meaning": "integer shared by repeats of one pose"},
    {
        "columns": "row",
        "meaning": "integer: number of the row in the order of measurement, where rows have no t_s and are not uploaded in that order",
    },
    {
        "columns": "sx_mm, sy_mm, sz_mm",
        "meaning": "standard deviation of the position of this row. Only a measured position takes it: the noise of contacts, link encoders and inclinometers comes from repeats, or from what the fit leaves (--noise-mm states that of contacts)",
    },
]
EXPORTS: list[dict[str, str]] = [
    {"id": "json", "ending": ".json"},
    {"id": "urdf", "ending": ".urdf"},
    {"id": "mjcf", "ending": ".mjcf.xml"},
    {"id": "usd", "ending": ".usda"},
    {"id": "dh-csv", "ending": ".dh.csv"},
    {"id": "mdh-csv", "ending": ".mdh.csv"},
    {"id": "ur-yaml", "ending": ".yaml"},
    {"id": "matlab", "ending": ".m"},
    {"id": "corrector", "ending": ".klt"},
    {"id": "c", "ending": ".c"},
]
