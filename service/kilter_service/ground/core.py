"""Rooms of the core, each imported when they are first used: the API and the commands start without their kernels.

They load numpy, scipy and compiled code, which a start must not wait for. ``from kilter_service.ground.core import core_gap``
stands for ``kilter_core.gap``, whose face names what may be used of it.
"""

from __future__ import annotations

from kilter_files.ground.later import later

with later(__name__):
    from kilter_core import arm as core_arm
    from kilter_core import correct as core_correct
    from kilter_core import effects as core_effects
    from kilter_core import evaluate as core_evaluate
    from kilter_core import gap as core_gap
    from kilter_core import identify as core_identify
    from kilter_core import measurement as core_measurement
    from kilter_core import model as core_model
    from kilter_core import motion as core_motion
    from kilter_core import observations as core_observations
    from kilter_core import plan as core_plan
    from kilter_core import procedures as core_procedures
    from kilter_core import transforms
    from kilter_core import watch as core_watch
