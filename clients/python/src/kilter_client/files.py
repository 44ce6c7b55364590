"""Modules that read and write files, imported when they are first used: most commands and calls need none of them.

``from kilter_client.files import rigid_body`` stands for ``kilter_files.match.rigid_body``; what would be called as
something else here begins with ``files_``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from kilter_files.ground.later import Later

__all__ = [
    "bag_pictures",
    "ballbar",
    "clock_checks",
    "cut_recording",
    "drawn_circle",
    "dwells",
    "files_arm",
    "files_ballbar_join",
    "files_beside_rows",
    "files_calibration",
    "files_episodes",
    "files_exported",
    "files_feeds",
    "files_found",
    "files_height",
    "files_homing",
    "files_link_meshes",
    "files_marks",
    "files_moved",
    "files_newest",
    "files_poses",
    "files_postures",
    "files_reading",
    "files_refusals",
    "files_report",
    "files_run",
    "files_second",
    "files_server",
    "files_session",
    "files_sources",
    "files_summary",
    "files_taken",
    "files_target",
    "files_tilt_join",
    "files_unusual",
    "frames_by_time",
    "joint_log",
    "kit_coverage",
    "kit_loads",
    "kit_words",
    "matching",
    "one_target",
    "read",
    "readings",
    "rigid",
    "rigid_body",
]

if TYPE_CHECKING:
    from kilter_files.formats.joints import joint_log
    from kilter_files.formats.joints.lerobot import beside_rows as files_beside_rows
    from kilter_files.formats.joints.lerobot import calibration as files_calibration
    from kilter_files.formats.joints.lerobot import episodes as files_episodes
    from kilter_files.formats.joints.lerobot import homing as files_homing
    from kilter_files.formats.joints.lerobot import moved as files_moved
    from kilter_files.formats.logs import ballbar
    from kilter_files.formats.programs import found as files_found
    from kilter_files.formats.programs import marks as files_marks
    from kilter_files.formats.programs import one_target, rigid
    from kilter_files.formats.programs import reading as files_reading
    from kilter_files.formats.programs.poses import postures as files_postures
    from kilter_files.look import refusals as files_refusals
    from kilter_files.look import summary as files_summary
    from kilter_files.look import unusual as files_unusual
    from kilter_files.match import arm as files_arm
    from kilter_files.match import clock_checks, dwells, frames_by_time, matching, rigid_body
    from kilter_files.rig import ballbar_join as files_ballbar_join
    from kilter_files.rig import drawn_circle, readings
    from kilter_files.rig import height as files_height
    from kilter_files.rig import tilt_join as files_tilt_join
    from kilter_files.rig.kit import coverage as kit_coverage
    from kilter_files.rig.kit import loads as kit_loads
    from kilter_files.rig.kit import words as kit_words
    from kilter_files.rig.live import feeds as files_feeds
    from kilter_files.rig.live import newest as files_newest
    from kilter_files.rig.live import server as files_server
    from kilter_files.rig.live import session as files_session
    from kilter_files.rig.live import taken as files_taken
    from kilter_files.rig.see import bag_pictures
    from kilter_files.rig.see import poses as files_poses
    from kilter_files.rig.see import run as files_run
    from kilter_files.rig.see import second as files_second
    from kilter_files.rig.see import sources as files_sources
    from kilter_files.rig.see import target as files_target
    from kilter_files.rig.sheet import report as files_report
    from kilter_files.robots import exported as files_exported
    from kilter_files.robots import link_meshes as files_link_meshes
    from kilter_files.robots import read
    from kilter_files.tables import cut_recording
else:
    joint_log = Later("kilter_files.formats.joints.joint_log")
    files_beside_rows = Later("kilter_files.formats.joints.lerobot.beside_rows")
    files_calibration = Later("kilter_files.formats.joints.lerobot.calibration")
    files_episodes = Later("kilter_files.formats.joints.lerobot.episodes")
    files_homing = Later("kilter_files.formats.joints.lerobot.homing")
    files_moved = Later("kilter_files.formats.joints.lerobot.moved")
    ballbar = Later("kilter_files.formats.logs.ballbar")
    files_found = Later("kilter_files.formats.programs.found")
    files_marks = Later("kilter_files.formats.programs.marks")
    one_target = Later("kilter_files.formats.programs.one_target")
    files_postures = Later("kilter_files.formats.programs.poses.postures")
    rigid = Later("kilter_files.formats.programs.rigid")
    files_reading = Later("kilter_files.formats.programs.reading")
    files_refusals = Later("kilter_files.look.refusals")
    files_summary = Later("kilter_files.look.summary")
    files_unusual = Later("kilter_files.look.unusual")
    files_arm = Later("kilter_files.match.arm")
    clock_checks = Later("kilter_files.match.clock_checks")
    dwells = Later("kilter_files.match.dwells")
    frames_by_time = Later("kilter_files.match.frames_by_time")
    matching = Later("kilter_files.match.matching")
    rigid_body = Later("kilter_files.match.rigid_body")
    files_ballbar_join = Later("kilter_files.rig.ballbar_join")
    drawn_circle = Later("kilter_files.rig.drawn_circle")
    files_height = Later("kilter_files.rig.height")
    kit_coverage = Later("kilter_files.rig.kit.coverage")
    kit_loads = Later("kilter_files.rig.kit.loads")
    kit_words = Later("kilter_files.rig.kit.words")
    files_feeds = Later("kilter_files.rig.live.feeds")
    files_newest = Later("kilter_files.rig.live.newest")
    files_server = Later("kilter_files.rig.live.server")
    files_session = Later("kilter_files.rig.live.session")
    files_taken = Later("kilter_files.rig.live.taken")
    readings = Later("kilter_files.rig.readings")
    bag_pictures = Later("kilter_files.rig.see.bag_pictures")
    files_poses = Later("kilter_files.rig.see.poses")
    files_run = Later("kilter_files.rig.see.run")
    files_second = Later("kilter_files.rig.see.second")
    files_sources = Later("kilter_files.rig.see.sources")
    files_target = Later("kilter_files.rig.see.target")
    files_report = Later("kilter_files.rig.sheet.report")
    files_tilt_join = Later("kilter_files.rig.tilt_join")
    files_exported = Later("kilter_files.robots.exported")
    files_link_meshes = Later("kilter_files.robots.link_meshes")
    read = Later("kilter_files.robots.read")
    cut_recording = Later("kilter_files.tables.cut_recording")
