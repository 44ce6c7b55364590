"""Modules that read and write files, imported when they are first used: most commands and calls need none of them.

``from kilter_client.files import rigid_body`` stands for ``kilter_files.match.rigid_body``; what would be called as
something else here begins with ``files_``.
"""

from __future__ import annotations

from kilter_files.ground.later import later

with later(__name__):
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
    from kilter_files.formats.programs import remedies as files_remedies
    from kilter_files.formats.programs.poses import postures as files_postures
    from kilter_files.formats.programs.poses import track as files_track
    from kilter_files.look import refused as files_refusals
    from kilter_files.look import summaries as files_summary
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
    from kilter_files.robots import mesh_files as files_link_meshes
    from kilter_files.robots import read
    from kilter_files.tables import cut_recording
