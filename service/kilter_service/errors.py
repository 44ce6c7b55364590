"""One table from error code to HTTP status, and the error the service itself raises."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_core.errors import CoreError

# 400 is the status of a code that is not listed: data that cannot be calibrated.
PROBLEMS: Mapping[str, tuple[int, str]] = {
    "robot_invalid": (400, "The robot description cannot be a serial arm"),
    "observations_invalid": (400, "The measurements cannot be what their columns say"),
    "foreign_observations": (400, "The observations look mixed up"),
    "rows_shared": (400, "The same rows were searched and would judge the result"),
    "option_invalid": (400, "An option does not exist or does not fit"),
    "markers_collinear": (400, "The markers lie on one line"),
    "markers_swapped": (400, "Markers have changed places"),
    "markers_mirrored": (400, "Markers are numbered or mirrored the other way round"),
    "markers_not_rigid": (400, "The markers are not a rigid body"),
    "arc_too_short": (400, "A joint moved too little for its axis to be seen"),
    "joint_constant": (400, "A joint never moves alone"),
    "circle_not_round": (400, "Points are off the circle their readings ask for"),
    "points_collinear": (400, "Points on one line do not define a frame"),
    "points_mirrored": (400, "Points are the mirror image of the known ones"),
    "contact_too_small": (400, "A socket, plane or bar has too few rows"),
    "sheet_order_wrong": (400, "The quarter points of a sheet are in the wrong order"),
    "too_few_poses": (400, "Too few poses"),
    "not_converged": (400, "The estimator found no minimum"),
    "metric_not_supported": (400, "The data cannot support this criterion"),
    "kind_unavailable": (400, "This kind of job does not exist"),
    "export_unavailable": (400, "This export format does not exist"),
    "campaigns_invalid": (400, "The campaigns do not fit the job"),
    "upload_incomplete": (400, "The upload broke off"),
    "token_missing": (401, "A token is needed"),
    "token_wrong": (401, "The token is not this server's"),
    "not_found": (404, "There is nothing at this address"),
    "robot_not_found": (404, "Unknown robot"),
    "campaign_not_found": (404, "Unknown campaign"),
    "job_not_found": (404, "Unknown job"),
    "version_not_found": (404, "Unknown parameter version"),
    "binding_refused": (400, "This address may not be listened on"),
    "token_file_open": (400, "The token file can be read by others"),
    "method_not_allowed": (405, "This address does not take that method"),
    "robot_exists": (409, "The robot's name is taken"),
    "name_taken": (409, "Another one has this name"),
    "name_invalid": (400, "The name looks like an id"),
    "reference_ambiguous": (409, "A prefix or name matches several"),
    "retired": (409, "It is retired"),
    "version_active": (409, "The version is active"),
    "cited": (409, "It is cited and cannot be purged"),
    "robot_in_use": (409, "The robot is in use"),
    "campaign_incomplete": (409, "Parts of the campaign are missing"),
    "campaign_committed": (409, "The campaign is stored already"),
    "cancelled": (409, "The job was cancelled"),
    "job_finished": (409, "The job has already finished"),
    "no_active_version": (409, "The robot has no active version"),
    "activation_refused": (409, "The version predicts worse than the one it would replace"),
    "activation_overtaken": (409, "Other versions were activated meanwhile"),
    "nothing_to_roll_back": (409, "There is no earlier version to return to"),
    "upload_too_large": (413, "The body is larger than its limit"),
    "media_type_unsupported": (415, "This media type is not read, or the body is packed"),
    "payload_invalid": (422, "The payload does not have the right shape"),
    "internal_error": (500, "Kilter failed"),
    "busy": (503, "The server answers as many requests as it can"),
    "not_ready": (503, "Kilter is not ready"),
    "database_unavailable": (503, "The database does not answer"),
    "jobs_taken": (409, "Another worker runs the jobs of this database"),
    "data_in_use": (409, "A server runs in this data folder already"),
    "database_outdated": (503, "The database is not of this version of Kilter"),
}


class ServiceError(CoreError):
    """A refusal of the service; its code is a key of the problem table."""

    default_code = "internal_error"
