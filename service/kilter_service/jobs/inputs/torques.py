"""Logs of joint torques: searched for what bodies and friction lack, or fitted with the effects that were asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_service.campaigns.store import renumber_poses_and_sessions
from kilter_service.ground.core import core_motion, core_observations
from kilter_service.jobs.inputs.plain import to_json_types
from kilter_service.jobs.kind import JobInput, JobOutput, Progress

READ = ("effects", "seed")


def as_session(rows: Observations) -> Observations:
    """A campaign without sessions is one of its own."""
    return rows if rows.session is not None else replace(rows, session=np.zeros(len(rows), dtype=np.int64))


def are_logs(job: JobInput) -> bool:
    """Whether all campaigns of a job are logs of torques."""
    return bool(job.campaigns) and all(map(core_observations.is_log, job.campaigns.values()))


def fit_torques(job: JobInput, progress: Progress) -> JobOutput:
    """Fit logs with the effects of torques that the job asks for; campaigns that validate, or a third of the motions, judge."""
    held = job.validation if isinstance(job.validation, dict) else {}
    parts = renumber_poses_and_sessions(map(as_session, [*job.campaigns.values(), *held.values()]))
    rows = core_motion.join_logs(parts[: len(job.campaigns)])
    return search_torques(job, rows, parts[len(job.campaigns) :], progress, fitted=True)


def search_torques(
    job: JobInput, rows: Observations, apart: Sequence[Observations], progress: Progress, fitted: bool = False
) -> JobOutput:
    """Search logs of joint torques, or fit them; it makes no version, for it says nothing of where the tool is.

    Raises:
        OptionError: an effect that torques do not show.

    """
    held = [int(session) for one in apart if one.session is not None for session in np.unique(one.session)]
    wanted, others = core_motion.split_effects(_effects(job))
    if others:
        raise OptionError(
            f"{_name(others[0])} is not an effect of torques, and these rows are a log of them: "
            "`kilter server effects` lists those that are.",
            option="effects",
        )
    options = core_motion.MotionOptions(job.options.seed, wanted if wanted or fitted else None, fitted)
    report = core_motion.find_missing_torque(
        job.robot, Observations.concatenate([rows, *apart]), options, progress, held
    )
    found = core_motion.to_document(report)
    starts = np.cumsum([0, *(len(one) for one in job.campaigns.values())])[:-1]
    assert rows.session is not None
    names = {int(rows.session[k]): job.names.get(c, c) for c, k in zip(job.campaigns, starts, strict=True)}
    found["warnings"] += _unused_options(job)
    for effect in found["effects"]:
        effect["campaign"] = names.get(effect.pop("session"))
    return JobOutput(to_json_types({**found, "start": job.version_id, "version_id": None}))


def refuse_effects_of_torques(asked: Sequence[Any]) -> None:
    """Refuse effects that poses do not show.

    Raises:
        OptionError: an effect of torques.

    """
    for name in core_motion.split_effects(asked)[0]:
        raise OptionError(
            f"{name} is an effect of torques, and these rows are poses: name a log with t_s and tau1_nm ....",
            option="effects",
        )


def _unused_options(job: JobInput) -> list[dict[str, Any]]:
    """Say which options were given that say nothing of torques."""
    fields = type(job.options).model_fields.items()
    asked = {name: getattr(job.options, name) for name, _ in fields}
    unused = [n for n, field in fields if n not in READ and asked[n] != field.get_default(call_default_factory=True)]
    if not unused:
        return []
    message = f"{', '.join(unused)} did nothing: logs of torques are told by effects and seed alone. Leave them out."
    return [{"code": "options_unused", "message": message}]


def _effects(job: JobInput) -> list[Any]:
    return [one if isinstance(one, str) else one.model_dump(mode="json") for one in job.options.effects]


def _name(effect: Any) -> str:
    return str(effect if isinstance(effect, str) else effect["id"])
