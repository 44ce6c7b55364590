"""Help of the options of jobs, made from the contract by `make contract`: change it there."""

from __future__ import annotations

IDENTIFY = {
    "level": "1 joint offsets, 2 geometry, 3 geometry and effects; left out: 3 when effects are named, else 2.",
    "method": "The estimator.",
    "tilt_first": "Hold the effects while the geometry is identified: those of the start, else as fitted before it.",
    "effects": "Effects to identify, by id or with options; left out: none, at level 3 the thesis's three.",
    "free": "Parameters to identify, by name or pattern (alpha_*); left out: those of the level.",
    "fix": "Parameters to hold, by name or pattern (alpha_*).",
    "base": "Whether the base is fitted; removed: only distances between poses count.",
    "tool": "Whether the tool is fitted.",
    "loss": "huber bounds what a wrong row can pull, tukey sets it aside and names it.",
    "noise_mm": "Standard deviation of a coordinate, mm, above 0; left out: estimated from the rows.",
    "reference": "Frames that corrections work in: the robot's own, those of the registration, or auto: the robot's own for a frame that is fixed or found within 10 mm and 1 degree of it.",
    "refit": '["base"]: every campaign and session has a base of its own; ["tool"]: a tool (a remounted marker); []: all rows share one of each; left out: the device decides, and sheets and ball bars have bases of their own.',
    "sheet_order": "given: the quarter points of drawn sheets are in the right order, do not check; left out: checked.",
    "seed": "Seed of everything that is drawn by chance, 0 or more.",
    "start": "Id of the version to start from; left out: the nominal robot.",
    "limits": "The largest correction the version may make; left out: what it needs at 99 % of its poses, from 1 degree and 5 mm to 5 degrees and 10 mm.",
    "search_mm": "Half the width of a global search in lengths, mm, above 0.",
    "search_deg": "Half the width of a global search in angles, degrees, above 0.",
    "intervals": "Add 95 % intervals that do not rest on the covariance; left out: none.",
    "masses": "uncertain: errors of masses and centres are carried beside effects that follow the load, as load_error does; as_stated: masses are exact; auto: uncertain, but beside an effect that follows the sign of a load values are fitted with masses as stated, and sigmas hold what their errors do.",
    "mass_sigma_percent": "Standard deviation of every mass, percent of it, above 0; left out: what the robot says of each.",
    "com_sigma_mm": "Standard deviation of each coordinate of every centre of mass, mm, above 0; left out: what the robot says.",
    "prior": "fleet: add what versions of at least five other robots of this type say before the rows; left out: none of them is asked.",
    "socket_distances_mm": 'Known distances between ball sockets, mm, above 0: {"1-2": 400.0}.',
}
GAP = {
    "start": "Id of the version to continue from; left out: the nominal robot.",
    "alpha": "Chance of any false name in the whole search, between 0 and 0.5.",
    "effects": "Look for these effects only, by id or at some joints; left out: for all.",
    "noise_mm": "Standard deviation of a coordinate, mm, above 0, where no pose was measured twice.",
    "free": "Parameters to identify, by name or pattern (alpha_*); left out: those of the level.",
    "fix": "Parameters to hold, by name or pattern (alpha_*).",
    "base": "Whether the base is fitted.",
    "tool": "Whether the tool is fitted.",
    "reference": "Frames that corrections work in: the robot's own, those of the registration, or auto: the robot's own for a frame that is fixed or found within 10 mm and 1 degree of it.",
    "prior": "fleet: add what versions of at least five other robots of this type say before the rows; left out: none of them is asked.",
    "max_effects": "Most effects to name, 1 to 50; an effect at several joints is one.",
    "bootstraps": "Resamples behind the p-value of an effect, 1 to 20000.",
    "resamples": "Resamples of poses on which a name must return, 1 to 10000.",
    "permutations": "Shuffles of the negative control, 1 to 10000.",
    "next_poses": "Poses to propose, 0 to 1000.",
    "seed": "Seed of everything that is drawn by chance, 0 or more.",
    "matters_um": "Movement of the tool below which nothing matters, micrometres (um), 0 or more.",
    "budget_s": "Seconds that a search may take, above 0: it then ends with the best it has; left out: as many as it needs.",
    "limits": "The largest correction the version may make; left out: what it needs at 99 % of its poses, from 1 degree and 5 mm to 5 degrees and 10 mm.",
}
EVALUATE = {
    "version": "Id of the version; left out: the active one, else the nominal robot.",
    "refit": 'Frames refitted to these rows: [], ["base"] or ["base", "tool"] (the tracker was set up again).',
    "metrics": "Errors, or the criteria of ISO 9283.",
    "criteria": "Criteria of ISO 9283 that must be given; left out: all that the rows support.",
}
PLAN = {
    "purpose": "iso9283: cube and planes of the standard; identify: poses that determine the parameters best; separate: poses that tell two effects apart; check: the few poses that best show whether the arm has moved.",
    "method": "Of identify: d_optimal, views (the same of what cameras see of boards, which version or campaigns know) or the poses of iso9283; of iso9283: five_poses or two_poses for its cycles.",
    "count": "Poses, 1 to 2000, or cycles; left out: 118, 60, 12 or 5 poses by purpose, 30 cycles.",
    "effects": "Of identify: effects to see; of separate: the two, or one to tell from geometry; left out: what the gap search that made the version left undecided.",
    "seed": "Seed of the choice, 0 or more.",
    "noise_mm": "Standard deviation of a coordinate, or at the board of a corner that a camera sees, mm, above 0; left out: that of the repeats, else 0.05.",
    "version": "Id of the version to plan with; left out: the nominal robot.",
    "box_mm": "Lowest and highest corner, mm, of a box the tool stays in, in the frame of the measurements.",
    "keep_out_mm": "Lowest and highest corners, mm, of boxes that no line between joints and tool enters, in the frame of the measurements.",
    "without_joints": "Of check: joints, from 1, whose zeros need not be seen.",
    "floor_mm": "Height in the robot's base frame, mm, that no joint and no tool point goes below.",
    "within": "Where poses may be: where the robot was driven before, or anywhere in its limits.",
    "prior": "Of identify by d_optimal: fleet: add what versions of at least five other robots of this type say before the rows; left out: none of them is asked.",
    "payloads_kg": "Loads at hand, kg, 0 to 1000; used where an effect feels them.",
    "payload_com_mm": "Centre of these loads in the tool frame, mm; left out: the tool point.",
}
JOINT_PARAMETERS = {
    "readings": "Readings of an inclinometer.",
    "resolution_deg": "Resolution of the inclinometer, degrees, above 0.",
    "propose": "Name of the joint to propose configurations for.",
    "count": "Configurations to propose, 4 to 200.",
    "payloads_kg": "Loads at hand, kg, 0 or more.",
    "payload_com_mm": "Of a proposal: centre of these loads in the tool frame, mm; left out: the tool point.",
    "seed": "Seed of the choice, 0 or more.",
}
DRIFT = {
    "version": "Id of the version to check against; left out: the active one.",
    "noise_mm": "Standard deviation of a coordinate, mm, above 0; left out: what the version's fit found.",
    "new_setup": 'Frames that were set up anew: [], ["base"] or ["base", "tool"]. What looks like them is then not seen.',
}
REZERO = {
    "version": "Id of the version to change; left out: the active one.",
    "causes": "What moved: zero_3, sag_2, base, tool; left out: what a check of the rows names, if it is one cause.",
    "noise_mm": "Standard deviation of a coordinate, mm, above 0; left out: what the version's fit found.",
    "limits": "The largest correction the version may make; left out: what it needs at 99 % of its poses, from 1 degree and 5 mm to 5 degrees and 10 mm.",
}
