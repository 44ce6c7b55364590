"""A gap hunt from rows to report: where the model is wrong, what is missing, how sure that is, what to measure next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.gap.adequacy import Adequacy, adequacy
from core.gap.aliases import SAME, Alias, aliases_of
from core.gap.candidates import Library, with_testable
from core.gap.control import Control, controls, false_names
from core.gap.figures import figures
from core.gap.heldout import Bench, gap_document, noise_document, train_rms
from core.gap.hunt import Hunt, hunt
from core.gap.intervals import Amplitude, amplitudes
from core.gap.next_poses import rows_of, separate
from core.gap.options import GapOptions
from core.gap.prepare import NOT_FITTED, Prepared, Workshop
from core.gap.report import GapReport
from core.gap.scan import Scorer
from core.gap.settle import chance, settled, shrunk
from core.gap.shadow import bumped
from core.gap.source import LinkSource, ToolSource
from core.gap.stability import inclusion
from core.gap.stored import stored
from core.gap.testability import Testability, alias_matrix, smallest_rows, testability, untestable
from core.gap.trajectory import hold_out
from core.gap.verdict import Evidence, Judged, judge, run_verdict, sentence
from core.gap.where import where
from core.model import Calibration
from core.observations import Observations
from core.robot import Robot

Floats = NDArray[np.float64]
Progress = Callable[[float, str], None]

STRANGE_SHARE = 0.01  # of the spread of the measured points: a residual above this is no missing effect
STRANGE_DEG = 2.0  # the same for joint data


def find_gap(
    robot: Robot,
    observations: Observations,
    options: GapOptions | None = None,
    start: Calibration | None = None,
    validation: Observations | float | None = None,
    progress: Progress | None = None,
) -> GapReport:
    """Find where the model is wrong, name what is missing, add it, and show the gap shrink on poses never used.

    ``start`` is the model to begin with (nominal geometry without one); its effects are kept and re-fitted.
    ``validation`` is other observations, a fraction of the poses to hold out, or None: then one pose is left out at a
    time. ``progress(fraction, stage)`` may raise to cancel.

    Raises:
        TooFewPosesError: the geometry alone needs more poses. ObservationError: nothing measured.
        OptionError: options that do not exist or fit.

    """
    options = options or GapOptions()
    tell = progress or (lambda fraction, stage: None)
    if isinstance(validation, float):
        inside, outside = hold_out(observations, validation, options.seed)
        observations, validation = observations.select(inside), observations.select(outside)
    begin = start or Calibration.nominal(robot)
    prepared = Workshop(begin, observations, options, _part(tell, 0.0, 0.15)).run()
    return _Run(robot, begin, prepared, options, validation, tell).report()


def _part(tell: Progress, low: float, high: float) -> Progress:
    """Map a stage's own fraction into its share of the whole."""
    return lambda fraction, stage: tell(low + (high - low) * min(1.0, fraction), stage)


@dataclass(frozen=True)
class _Run:
    robot: Robot
    begin: Calibration
    prepared: Prepared
    options: GapOptions
    validation: Observations | None
    tell: Progress

    def report(self) -> GapReport:
        prepared, world = self.prepared, self.prepared.world
        rows = prepared.visits.observations
        self.tell(0.15, "where the model is wrong")
        places = where(world, rows, self.options.seed, prepared.moving)
        judged = testability(world, prepared.library)
        strange = self._strange()
        candidates = () if strange else with_testable(prepared.library, judged.able)
        trusted = world.setting.trusted
        freedom = world.setting.noise.freedom if world.setting.noise.absolute else np.inf
        scorer = Scorer.of(candidates, trusted, freedom)
        limits = np.array([max(abs(p.lower), abs(p.upper)) for p in prepared.library.parameters])
        found = hunt(world.setting, world, scorer, limits, self.options, _part(self.tell, 0.2, 0.5))
        found = shrunk(settled(found, self.options.alpha), world)
        fit = adequacy(found.world, prepared.visits.condition, found.columns)
        effects, control, held = self._judged(found, fit)
        verdict = "unexplained" if strange else run_verdict(effects, fit)
        said = strange or sentence(verdict, effects, fit)
        warnings = (*prepared.warnings, *({"code": "not_a_missing_effect", "message": strange} for _ in [0] if strange))
        gap = gap_document(prepared, found, held.report())
        self.tell(0.95, "next poses and pictures")
        return GapReport(
            stored=stored(found, self.begin, prepared.rows, self.options, referenced=not strange),
            verdict=verdict, sentence=said, effects=effects, where=places,
            gap=gap, adequacy=fit, not_testable=untestable(prepared.library, judged, world, rows),
            smallest_detectable=smallest_rows(prepared.library, judged),
            next_poses=self._next_poses(found, effects), negative_control=control,
            alias_matrix=alias_matrix(world, candidates, found.chosen), noise=noise_document(found.world.setting),
            warnings=warnings, figures=figures(found, rows, gap), library=prepared.library,
        )  # fmt: skip

    def _judged(self, found: Hunt, fit: Adequacy) -> tuple[tuple[Judged, ...], dict[str, Any], Bench]:
        """Evidence for every chosen candidate, and the gates."""
        held = Bench(found, self.prepared, self.validation)
        aliases = {k: aliases_of(found, k) for k in found.chosen}
        classes = {k: tuple(a.place for a in rivals) for k, rivals in aliases.items()}
        part = _part(self.tell, 0.5, 0.7)
        shares = inclusion(
            found, classes, self.options.resamples, self.options.seed, lambda f: part(f, "selecting again on resamples")
        )
        part = _part(self.tell, 0.7, 0.8)
        shuffled = controls(found, self.options.permutations, self.options.seed, lambda f: part(f, "negative control"))
        part = _part(self.tell, 0.8, 0.92)
        sizes = amplitudes(found, lambda f: part(f, "profile intervals"))
        out = []
        for n, k in enumerate(found.chosen):
            self.tell(0.92 + 0.02 * n / len(found.chosen), "held-out poses")
            evidence = self._evidence(found, k, aliases[k], shares[k], shuffled[n], sizes, held)
            out.append(judge(found, evidence, fit.adequate, self.prepared.library))
        out.sort(key=lambda j: -j.evidence.gain_mm)
        return tuple(out), self._control_document(found, shuffled), held

    def _evidence(
        self, found: Hunt, place: int, rivals: tuple[Alias, ...], share: tuple[float, float], control: Control,
        sizes: dict[int, Amplitude], held: Bench,
    ) -> Evidence:  # fmt: skip
        selector = found.selector
        rest = selector.columns([k for k in found.chosen if k != place])
        candidate = selector.scorer.candidates[place]
        unit = 180.0 / np.pi if isinstance(found.world.setting.source, LinkSource) else 1e3
        return Evidence(
            place, candidate, rivals, share, held.gain_of(place), control,
            tuple(sizes[c] for c in candidate.columns),
            chance(found, place),
            (train_rms(found.world, rest) - train_rms(found.world, found.columns)) * unit,
            bumped(found, place, self.prepared.visits.observations.q),
        )  # fmt: skip

    def _control_document(self, found: Hunt, shuffled: tuple[Control, ...]) -> dict[str, Any]:
        share = false_names(found, self.options.permutations, self.options.seed)
        rows = [
            {
                **found.selector.scorer.candidates[c.place].named(), "shuffled": c.label, "shuffles": c.shuffles,
                "survived": c.survived, "passed": c.passed,
            }
            for c in shuffled
        ]  # fmt: skip
        return {
            "passed": all(c.passed for c in shuffled), "effects": rows, "shuffles": self.options.permutations,
            "names_in_shuffled_residuals": share,
        }  # fmt: skip

    def _strange(self) -> str:
        """Sentence when the residual is too large for any missing effect: another robot, another tool, other units."""
        world = self.prepared.world
        size = train_rms(world, [])
        position = self.prepared.visits.observations.position
        if isinstance(world.setting.source, LinkSource):
            strange, words = np.degrees(size) > STRANGE_DEG, f"{np.degrees(size):.2f} deg"
        else:
            spread = self._spread(position)
            strange, words = (
                size > STRANGE_SHARE * spread,
                f"{size * 1e3:.1f} mm over a workspace of {spread * 1e3:.0f} mm",
            )
        if not strange and NOT_FITTED not in {w["code"] for w in self.prepared.warnings}:
            return ""
        return (
            f"After fitting the geometry {words} are left. This is not a missing effect: the observations belong to "
            "another robot, tool, joint order or unit, or the tool was changed during the campaign. Check these first."
        )

    def _spread(self, position: Floats | None) -> float:
        source = self.prepared.world.setting.source
        assert isinstance(source, ToolSource)
        points = (
            source.model.predict(source.batch, self.prepared.world.values).position if position is None else position
        )
        return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))

    def _next_poses(self, found: Hunt, effects: tuple[Judged, ...]) -> list[dict[str, Any]]:
        """For the least certain effect: poses that separate it from its nearest rival, or sharpen it."""
        if not effects:
            return []
        open_ = [(j, [a for a in j.alias_set if a.correlation < SAME]) for j in effects]
        asked = next(((j, a) for j, a in open_ if a), None)
        if asked is None:
            weak = [j for j in effects if j.verdict == "provisional"]
            if not weak:
                return []
            asked = (weak[0], [])
        j, rivals = asked
        target = j.evidence.candidate
        others = [k for k in found.columns if k not in target.columns]
        values = np.array([a.value for a in j.evidence.amplitudes])
        proposals = separate(
            found.world, self.prepared.visits.observations, target, [a.candidate for a in rivals[:1]], others, values,
            self.options.next_poses, self.options.seed,
        )  # fmt: skip
        return rows_of(proposals, (target.label, rivals[0].candidate.label if rivals else "geometry"), self.robot)


__all__ = ["GapReport", "Library", "Testability", "find_gap"]
