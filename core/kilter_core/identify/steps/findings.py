"""What a metrologist should know of a fit before trusting it: the checks after a fit, in the order they are told."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from kilter_core.identify.fleet.said import prior_warnings
from kilter_core.identify.identifiable.load_model import far_from_stated, load_rows
from kilter_core.identify.plausibility.another_arm import another_arm
from kilter_core.identify.plausibility.astray_rows import unless_astray
from kilter_core.identify.report import fit_warnings
from kilter_core.identify.steps.camera_findings import bad_timing, bent_boards, gauges
from kilter_core.identify.steps.fit import Fitted
from kilter_core.identify.steps.start import Study
from kilter_core.identify.steps.uncertainty import Uncertainty
from kilter_core.identify.steps.validation import HeldOut
from kilter_core.identify.view_report import tell_less, too_large_to_deploy, wrong_views


@dataclass(frozen=True)
class Outcome:
    """A study with what each step found."""

    study: Study
    fitted: Fitted
    held: HeldOut
    known: Uncertainty

    @property
    def load_rows(self) -> list[dict[str, Any]]:
        """Masses and centres as stated and as found."""
        fit = self.known.arm_fit
        return load_rows(self.fitted.arm, fit.names, fit.sigma, fit.problem.prior_sigma)


CHECKS_AFTER: tuple[Callable[[Outcome], Iterable[dict[str, Any]]], ...] = (
    lambda one: fit_warnings(one.known.arm_fit, one.study.train, one.known.repeats),
    lambda one: () if one.fitted.learned is None else (one.fitted.learned.warning(),),
    lambda one: another_arm(one.fitted.arm),
    lambda one: gauges(one.known.fit),
    lambda one: bent_boards(one.known.fit),
    lambda one: bad_timing(one.known.fit),
    lambda one: far_from_stated(one.load_rows),
    lambda one: () if one.known.beyond is None else (one.known.beyond.warning(one.study.inside),),
    lambda one: wrong_views(one.fitted.fit, one.fitted.begin, one.study.options, one.study.inside),
    lambda one: one.study.remarks,
    lambda one: () if one.held.poses is None else one.held.poses.warnings(),
    lambda one: () if one.study.fleet is None else prior_warnings(one.study.fleet, one.fitted.fit),
    lambda one: too_large_to_deploy(one.known.views, one.held.rms_mm("registration_only")),
    lambda one: tell_less(one.known.views, one.held.rms_mm("identified")),
)


def list_findings(outcome: Outcome) -> tuple[dict[str, Any], ...]:
    """Warnings of all checks, without those that another one explains."""
    return tuple(unless_astray(finding for check in CHECKS_AFTER for finding in check(outcome)))
