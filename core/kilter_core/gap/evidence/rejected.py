"""What the candidates that were not named would explain beside those that were."""

from __future__ import annotations

from typing import Any

from kilter_core.gap.search.forward_selection import SearchResult


def rejected_candidates(found: SearchResult) -> list[dict[str, Any]]:
    """Rows {id, joints, explains, p_value} of the candidates that were not named, the least likely by chance first.

    ``explains`` is the share of the squared residuals of the final fit that the candidate would take away with geometry
    fitted beside it (reduction S of the score test); ``p_value`` is family-wise, as that of a name. Candidates that the
    named ones or geometry imitate whole are left out: they have no score.
    """
    scorer, gram = found.selector.scorer, found.problem.gram.condition_on_columns(found.columns)
    scores = scorer.scores(gram)
    rows = [
        {
            **candidate.id_and_joints(),
            "explains": min(1.0, float(scores.S[k]) / gram.yy) if gram.yy > 0.0 else 0.0,
            "p_value": found.null.family_wise(float(scores.p[k]), len(scorer.candidates)),
        }
        for k, candidate in enumerate(scorer.candidates)
        if k not in found.chosen and scores.d[k] > 0
    ]
    return sorted(rows, key=lambda row: (row["p_value"], -row["explains"]))
