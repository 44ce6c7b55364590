"""The report on a search, from what each of its steps found."""

from __future__ import annotations

from kilter_core.gap.evidence.held_out.by_kind import by_kind
from kilter_core.gap.evidence.held_out.held_out_errors import gap_document, noise_document
from kilter_core.gap.evidence.similarity.testability import alias_matrix, smallest_rows, untestable
from kilter_core.gap.evidence.verdict import sentence
from kilter_core.gap.outcome_warnings import Outcome, outcome_warnings
from kilter_core.gap.report.effect_curves import effect_curves
from kilter_core.gap.report.figures import figures
from kilter_core.gap.report.localization import remains
from kilter_core.gap.report.report import GapReport, Remains
from kilter_core.gap.report.set_aside import agreement_sentence, poses_again, rows_aside, version_doubts
from kilter_core.gap.search.finalize import rejected_candidates
from kilter_core.gap.search.linear.complete_form import incomplete_sentence
from kilter_core.parameters import metres


def build_report(outcome: Outcome) -> GapReport:
    """Build the report; what it says of poses is of all that was named, what it says of the version of what is stored."""
    study, fit, effects, stored = outcome.study, outcome.fit, outcome.effects, outcome.version.stored
    search, held, unseen = fit.search, fit.version.held, fit.unseen
    found, prepared, options = search.found, search.prepared, study.options
    rows, library, problem = prepared.visits.observations, prepared.library, prepared.problem
    verdict, judging, spikes = fit.verdict(effects), held.report(), held.set_aside
    place = None if fit.adequacy.adequate else remains(found.problem, found.columns, rows, options.seed)
    rest, gap = Remains(fit.misfit, place), gap_document(prepared, found, judging)
    again = poses_again(prepared, study.validation, spikes) if options.next_poses else []
    searched, unchosen = study.numbers
    sigma = metres(gap["noise_mm"] or 0.0)
    return GapReport(
        stored=stored.with_doubts(version_doubts(held, verdict, unseen)),
        verdict=verdict,
        effects=effects,
        unseen=unseen,
        remains=rest,
        sentence=sentence(verdict, effects, fit.adequacy, fit.misfit, rest.words)
        + ("" if unseen is None else unseen.sentence())
        + incomplete_sentence(fit.lacking)
        + agreement_sentence(prepared, study.validation, spikes),
        where=outcome.where,
        gap=gap,
        measurements=by_kind(prepared, found, held, judging),
        adequacy=fit.adequacy,
        misfit=fit.misfit,
        predictive=judging.predictive,
        not_testable=(*untestable(library, search.judged, problem, rows), *(one.untestable() for one in search.unseen)),
        smallest_detectable=smallest_rows(library, search.judged),
        refused=rejected_candidates(found),
        next_poses=[*again, *outcome.next_poses],
        told_apart=outcome.told_apart,
        negative_control=outcome.control,
        alias_matrix=alias_matrix(problem, search.candidates, found.chosen),
        noise=noise_document(found.problem.settings),
        warnings=outcome_warnings(outcome),
        figures=figures(found, rows, gap, held),
        effect_curves=effect_curves(found, effects),
        library=library,
        set_aside=rows_aside(stored.calibration, prepared.given, prepared.outlying, searched, sigma),
        held_aside=rows_aside(stored.calibration, study.validation, spikes, unchosen, sigma),
        spikes=spikes,
    )
