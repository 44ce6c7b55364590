"""Results of jobs and versions as text: metrics, parameters, what the data could not determine.

The result of an activation, and the log of activations, as text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from kilter_client.cli.reports.answer import (
    IN_JSON,
    LINES,
    PLACEHOLDER,
    fit_messages,
    format_next,
    show_answer,
    suggest_after_today,
    suggest_for_version,
)
from kilter_client.cli.reports.gap_report import show_gap, show_unobservable
from kilter_client.cli.reports.identify_report import show_identification, show_parameters
from kilter_client.cli.terminal.output import (
    is_note_due,
    number,
    print_line,
    print_lines,
    screen_columns,
    show_list,
    show_rows,
)
from kilter_client.results.shown_jobs import MODELS, nominal_words

STAGES = tuple(MODELS)
MEASURES = (
    ("mean_mm", "mean mm"),
    ("rms_mm", "rms mm"),
    ("p95_mm", "p95 mm"),
    ("max_mm", "max mm"),
    ("orientation_deg", "orientation deg"),
)

MASSES = "load_error"  # carried beside effects that follow loads: nobody asks for it
MOST_CHANGES = 8  # that planned poses show, of a table


ONCE = {
    "directions_derived",
    "load_not_stated",
    "default_load_used",
}  # notes on how rows were sent, not on what was found


def show_job(
    job: dict[str, Any], details: bool = True, head: bool = True, suggested: Sequence[str] = (), server: str = ""
) -> None:
    """Print a job: how it stands (``head``), what is in its result, and what is ``suggested`` to do next.

    Without ``details`` its answer is on one screen, without notes that were shown for this robot of the ``server`` lately.
    """
    result = job.get("result") or {}
    version = result.get("version_id")
    stored = list(suggested)
    if version and job["kind"] not in ("evaluate", "drift"):
        stored = describe_stored(version, result, suggested)
    if head or details or not result:
        print_line(f"{job.get('name') or job['id']}: {job['state']}{_stage(job)}")
    long = job["kind"] in ("plan", "joint_parameters", "fleet") or result.get("iso9283")
    if result and not details and not long:
        if server:
            result = {**result, "warnings": [one for one in result.get("warnings") or () if _is_due(one, job, server)]}
        show_answer({"headline": result.get("sentence"), **result}, stored)
        return
    error = job.get("error")
    if error:
        print_line(f"  {error.get('code')}: {error.get('message')}")
    if job["kind"] == "gap" and result:
        show_gap(result)
    elif job["kind"] == "plan" and result:
        show_plan(result)
    elif job["kind"] == "rezero" and result:
        print_line(result["sentence"])
        show_result(result)
    elif job["kind"] == "drift" and result:
        show_drift(result)
    else:
        show_result(result)
    print_lines(stored)


def _is_due(warning: Mapping[str, Any], job: Mapping[str, Any], server: str) -> bool:
    code = warning.get("code")
    return code not in ONCE or is_note_due(server, f"{code} {job.get('robot')}")


def describe_stored(version: str, result: Mapping[str, Any], suggested: Sequence[str]) -> list[str]:
    """Say under which name a version is stored and how to go on, or what speaks against it, a line each."""
    objections: Sequence[Mapping[str, Any]] = result.get("objections") or ()
    if not objections:
        return [" ".join([f"Stored as {version}.", *suggested])]
    return [f"Stored as {version}, but not fit to correct with:", *(f"  {one['message']}" for one in objections)]


def show_plan(result: Mapping[str, Any]) -> None:
    """Print how many poses were planned and what they are worth."""
    print_line(f"{result['count']} poses for {result['purpose']}")
    if result.get("separates"):
        print_line(f"{' and '.join(result['separates'])} correlate by {number(result['correlation'], 3)} in these data")
    show_smallest(result, MOST_CHANGES)
    for proposal in result.get("proposals") or ():
        worth = number(proposal["information_factor"], 3)
        print_line(f"  {proposal['change'] or 'new poses'}: {proposal['poses']}, information times {worth}")
    if (result.get("told_apart") or {}).get("enough"):  # that they do not is a warning
        print_line(f"  {result['told_apart']['sentence']}")
    if result.get("within") == "campaigns":
        print_line("all where the robot was driven in its campaigns; --anywhere goes to its limits")
    for warning in result.get("warnings") or ():
        print_line(f"warning: {warning['message']}")


def show_version(version: dict[str, Any], details: bool = True) -> None:
    """Print a version, its parameters and what is next; without ``details`` its errors and what speaks against it."""
    print_line(f"version {version['id']} of {version.get('robot')}, made {str(version.get('created_at'))[:16]}")
    started = f", started from {version['parent_id']}" if version["parent_id"] else ""
    print_line(f"  {'active' if version['active'] else 'not active'}, made by {version['job_id']}{started}")
    effects = [name.replace("_", " ") for name in version.get("effects") or () if name != MASSES]
    print_line(f"  effects: {', '.join(effects) or 'none, geometry alone'}")
    for objection in version.get("objections") or ():
        print_line(f"  not fit to correct with: {objection['message']}")
    for campaign in version["campaigns"]:
        print_line(f"  {campaign['use']}: campaign {campaign['id']}, {campaign['rows']} rows")
    if not details:
        show_answer(version, suggest_for_version(version))
        return
    _workspace((version.get("details") or {}).get("workspace"))
    show_result({**(version.get("details") or {}), **version})
    print_lines(suggest_for_version(version))


def _workspace(found: Mapping[str, Any] | None) -> None:
    """Where the version corrects all over the joint limits, and why its limits are what they are."""
    if not found:
        return
    print_line(f"  {found['sentence']}")
    counts = {"corrected": found["ok"], "damped": found["damped"], "limited": found["limited"]}
    counts |= {f"refused ({word})": count for word, count in (found.get("refused") or {}).items()}
    rows = [(word, f"{100 * count / found['poses']:.1f} %") for word, count in counts.items() if count]
    show_rows(("all over the joint limits", "share of the poses"), rows)


def show_result(result: Mapping[str, Any]) -> None:
    """Print the parts of a result that are tables or sentences for people; the rest is in the JSON."""
    _metrics(result.get("metrics") or {}, "re-zeroed by" if _is_rezeroed(result) else "train")
    for campaign, report in (result.get("iso9283") or {}).items():
        _iso9283(campaign, report)
    show_parameters(result.get("parameters") or [])
    show_identification(result)
    _joints(result.get("joints") or [])
    _configurations(result.get("configurations") or [])
    show_unobservable(result.get("null_directions") or [])
    for warning in result.get("warnings") or ():
        print_line(f"warning: {warning.get('message', warning) if isinstance(warning, Mapping) else warning}")
    if result.get("noise_mm") is not None:
        source = f" (from {result['noise_source']})" if result.get("noise_source") else ""
        print_line(f"noise of a coordinate: {number(result['noise_mm'])} mm{source}")
    if result.get("pixels"):
        _pixels(result["pixels"])


def _pixels(pixels: Mapping[str, Any]) -> None:
    print_line(f"noise of a corner: {number(pixels['noise_px'])} px (within views)")
    for name, where in (("train", "views that were fitted"), ("validation", "views held out")):
        if tool := pixels.get(name):
            low, high = number(tool["low_mm"]), number(tool["high_mm"])
            off = f"{number(tool['rms_mm'])} mm rms (95 %: {low} to {high} mm)"
            print_line(f"the tool in {where} is off by {off}, the noise of the views taken off")
    _left_open(pixels)


def _left_open(block: Mapping[str, Any], where: str = "") -> None:
    if left := block.get("left_open"):
        may = f"{number(left['rms_mm'])} mm rms (95 %: up to {number(left['high_mm'])} mm){where}"
        print_line(f"by what the fit leaves open the tool may be off by {may}; views hardly see size and distance")


def _stage(job: Mapping[str, Any]) -> str:
    progress = job.get("progress") or {}
    if job["state"] not in ("queued", "running") or not progress:
        return ""
    return f", {100 * float(progress.get('fraction') or 0):.0f} %, {progress.get('stage')}"


def _is_rezeroed(result: Mapping[str, Any]) -> bool:
    """Whether it is of a re-zeroing, or of the version that one made."""
    return "p_after" in result or any(one.get("code") == "rezeroed" for one in result.get("warnings") or ())


def _metrics(metrics: Mapping[str, Any], train: str) -> None:
    """Print errors by rows: of an evaluation those of each campaign, else those that were fitted, called ``train``."""
    blocks = [
        (block.get("name") or (train if name == "train" else name), block)
        for name, block in metrics.items()
        if isinstance(block, Mapping)
    ]
    present = [stage for _, block in blocks for stage in STAGES if isinstance(block.get(stage), Mapping)]
    if not present:
        return
    measures = [m for m in MEASURES if any(m[0] in (b.get(s) or {}) for _, b in blocks for s in STAGES)]
    rows = [
        (
            f"{name} ({block.get('n', '?')})",
            _label(block, stage),
            *(number(block[stage].get(key)) for key, _ in measures),
        )
        for name, block in blocks
        for stage in STAGES
        if isinstance(block.get(stage), Mapping)
    ]
    show_rows(("rows", "model", *(label for _, label in measures)), rows, numbers=True)
    aside = [f"{name} {block['left_out'] or 'none'}" for name, block in blocks if block.get("left_out") is not None]
    if aside and train == "train":
        print_line(f"rows left out of these errors: {', '.join(aside)}")
    for name, block in blocks:
        if block.get("within_u95") is not None:
            print_line(
                f"{100 * block['within_u95']:.0f} % of the coordinates of {name} lie within their 95 % intervals"
            )
        if train != "train":
            _left_open(block, f" in {name}")
        if block.get("budget"):
            _show_budget(name, block["budget"])


def _show_budget(name: str, budget: Mapping[str, Any]) -> None:
    k, u = number(budget["k"], 1), number(budget["expanded_mm"], 3)
    missing = ", ".join(budget["not_assessed"]).replace("_", " ")
    lacks = f"; not assessed: {missing}" if missing else ""
    print_line(f"expanded uncertainty of a coordinate of {name} (k = {k}): {u} mm{lacks}")


def _label(block: Mapping[str, Any], stage: str) -> str:
    if stage != "nominal":
        return MODELS[stage]
    means = ((block.get(name) or {}).get("mean_mm") for name in ("nominal", "registration_only"))
    return nominal_words(*means)


def _iso9283(campaign: str, report: Mapping[str, Any]) -> None:
    """Criteria of ISO 9283 by symbol, and why the others cannot be given."""
    rows = [
        (
            symbol,
            number(found["mm"]),
            str(found.get("n") or min(pose["n"] for pose in found["poses"])),
            found["demands"],
        )
        for symbol, found in report["metrics"].items()
    ]
    texts = [(symbol, mm, repeats, str(demands)) for symbol, mm, repeats, demands in rows]
    show_rows(("ISO 9283", "mm", "repeats", "demanded"), texts, title=f"campaign {campaign}", numbers=True)
    for refused in report.get("refused") or ():
        print_line(f"not given: {refused['message']}")


def _joints(joints: list[Mapping[str, Any]]) -> None:
    """How far link and motor angle are apart, and what of it is left."""
    rows = [
        (
            str(joint["joint"]),
            f"{motion['use']} {motion['campaign']}",
            number(motion["raw_deg"]),
            number(motion["left_deg"]),
            number(motion["left_deg"] / motion["raw_deg"], 2) if motion["raw_deg"] else "",
        )
        for joint in joints
        for motion in joint["motions"]
    ]
    if rows:
        show_rows(("joint", "motion", "apart, std deg", "left, std deg", "left of it"), rows)


def _configurations(configurations: list[Mapping[str, Any]]) -> None:
    rows = [
        (str(c["joint"]), c["axis"], number(c["payload_kg"]), ", ".join(f"{v:.1f}" for v in c["q_deg"]))
        for c in configurations
    ]
    if rows:
        show_rows(("joint", "axis", "payload kg", "joint values (deg, prismatic mm)"), rows)


EXIT_CODES = {"ok": 0, "moved": 3, "cannot_tell": 4}
NEVER_SUMMED = (
    "No sums: with frames set up anew, or by a joint log alone, a check does not show every cause, and what creeps is not "
    "seen. Leave the instrument where it stands for some checks."
)
LISTED = 6  # causes of a table, the best first
HISTORY = 6  # newest checks and changes that are shown
FIRST = re.compile(r"; |(?<=[.]) ")  # the rest of a sentence of a check says what it rests on


def show_drift(result: Mapping[str, Any]) -> None:
    """Print the verdict, what to do, what was looked at, and what such rows can show."""
    print_line(result["sentence"])
    if result.get("remedy"):
        print_line(f"  {result['remedy']}")
    if result["verdict"] != "ok":
        _show_causes(result)
    show_smallest(result)
    for warning in result.get("warnings") or ():
        print_line(f"warning: {warning['message']}")


def show_smallest(result: Mapping[str, Any], most: int | None = None) -> None:
    """Print which changes rows show in 95 % of the checks, and which they do not; of the former ``most`` at most."""
    rows = [(one["words"], f"{number(one['value'], 2)} {one['unit']}") for one in result.get("smallest") or ()]
    if rows:
        show_rows(("such rows show", "from a change of"), rows[:most])
        if most is not None and len(rows) > most:
            print_line(f"and {len(rows) - most} more changes (--json)")
        print_line(
            f"in 95 % of the checks; an arm that has not moved alarms in {number(result['false_alarm'])} of them at most"
        )
    if result.get("unseen"):
        print_line(f"they do not show: {', '.join(result['unseen'])}")
    for sentence in result.get("faint") or ():
        print_line(sentence)


def show_history(found: Mapping[str, Any]) -> None:
    """Print how a robot stands, its checks with what was done between them, and the charts that say most."""
    print_line(f"{found['robot']}: {found['sentence']}")
    events = [(str(one["at"]), one["verdict"].replace("_", " "), one["sentence"]) for one in found["history"]]
    events += [(str(one["at"]), one["what"], _said_of_mark(one)) for one in found["marks"]]
    events.sort(key=itemgetter(0))
    if left := max(len(events) - HISTORY, 0):
        print_line(f"{left} older checks and changes: --json")
    show_rows(
        ("when", "", ""), [(at[:16].replace("T", " "), what, FIRST.split(said)[0]) for at, what, said in events[left:]]
    )
    charts = sorted(found["charts"], key=_height, reverse=True)[:LISTED]
    rows = [
        (
            one["words"],
            f"{number(_latest_value(one['values']), 3)} {one['unit']}",
            number(one["scatter"], 2),
            f"{number(_height(one), 2)} of {number(one['limit'], 2)}",
            str(one["since"] or "")[:10],
        )
        for one in charts
    ]
    if rows:
        show_rows(("chart", "last", "scatter", "sum", "since"), rows)
    elif found["checks"]:
        whole = any(one["whole"] for one in found["history"] if one["version_id"] == found["version_id"])
        print_line("The sums over many checks begin with the fourth that agrees." if whole else NEVER_SUMMED)


def _said_of_mark(one: Mapping[str, Any]) -> str:
    return f"{one['note']} ({one['repair_id']})" if one.get("repair_id") else str(one["version_id"])


def _latest_value(values: Sequence[float | None]) -> float:
    """The number of the last check that shows it."""
    return next((value for value in reversed(values) if value is not None), 0.0)


def _height(chart: Mapping[str, Any]) -> float:
    """The larger sum at the last check that has one."""
    return max(next((value for value in reversed(chart[way]) if value is not None), 0.0) for way in ("up", "down"))


def show_robots(found: Mapping[str, Any]) -> None:
    """Print how all robots stand, the worst first."""
    rows = [
        (
            one["robot"],
            one["state"].replace("_", " "),
            str(one["checks"]),
            "" if one["age_days"] is None else f"{one['age_days']} days ago",
            FIRST.split(one["sentence"], maxsplit=1)[0],
        )
        for one in found["robots"]
    ]
    show_list(("robot", "stands", "checks", "last", ""), rows)


def _show_causes(result: Mapping[str, Any]) -> None:
    rows = [
        (one["words"], _changes(one), number(one["gain"], 3), "refuted" if one["refuted"] else "may be")
        for one in result["looked_at"][:LISTED]
    ]
    show_rows(("cause", "change", "explains", ""), rows)


def _changes(cause: Mapping[str, Any]) -> str:
    seen = [one for one in cause["numbers"] if one["u95"] is not None]
    if len(cause["numbers"]) == 1:
        return "".join(f"{number(one['change'], 3)} ± {number(one['u95'], 2)} {one['unit']}" for one in seen)
    return ", ".join(
        f"{one['name']} {number(one['change'], 3)} ± {number(one['u95'], 2)} {one['unit']}" for one in seen
    )


ACTIVATED_ONCE = {"compensation_unknown"}  # warnings that hold until somebody does what they ask for


def show_active(server: str, state: str, document: Mapping[str, Any]) -> None:
    """Print that a version is active, what its stream leaves out, and on what it was compared."""
    print_line(f"{document['id']} is {state}.{_describe_gain(document.get('compared'))}")
    if document["not_corrected"]:
        print_line(document["not_corrected"])
    for objection in document.get("objections") or ():
        print_line(f"forced, though: {objection['message']}")
    for warning in document.get("warnings") or ():
        if warning["code"] not in ACTIVATED_ONCE or is_note_due(server, warning["message"]):
            print_line(f"warning: {warning['message']}")
    _show_preview(document.get("preview"))
    _show_comparison(document["id"], document.get("compared"))
    print_lines(format_next("correct", document["robot"], PLACEHOLDER, "-o", "corrected.csv"))


def _describe_gain(compared: Mapping[str, Any] | None) -> str:
    """Say how large the error is now and was before, on poses that no fit used; nothing where there were none."""
    if not compared:
        return ""
    rival = compared["active"] or compared["registration_only"]
    before = f"{number(rival['mean_mm'], 2)} -> " if rival else ""
    return f" Mean error on {compared['poses']} poses that no fit used: {before}{number(compared['mean_mm'], 2)} mm."


def _show_preview(preview: Mapping[str, Any] | None) -> None:
    """Print what the version does with the robot's poses."""
    if not preview:
        return
    poses = "measured poses" if preview["within"] == "campaigns" else "poses within the joint limits"
    every = "all" if preview["corrected"] == preview["poses"] else f"{preview['corrected']} of"
    refused = sum(preview["refused"].values())
    held = ((preview["damped"], "near a singularity"), (preview["limited"], "held at a limit"), (refused, "refused"))
    said = "".join(f", {count} {words}" for count, words in held if count)
    largest = "" if preview["largest_mm"] is None else f" Largest correction: {number(preview['largest_mm'], 3)} mm."
    print_line(f"Corrects {every} {preview['poses']} {poses}{said}.{largest}")


def _show_comparison(version: str, compared: Mapping[str, Any] | None) -> None:
    if not compared or not compared["active"]:  # else the headline has all of it
        return
    where = ", ".join(compared.get("campaign_names") or compared["campaigns"])
    print_line(
        f"Compared on {compared['poses']} poses ({compared['rows']} rows) that neither was fitted to, of {where}:"
    )
    rivals = (("registration only", compared["registration_only"]), (compared["active_version"], compared["active"]))
    rows = [
        (name, number(rival["mean_mm"]), number(rival["larger_by_mm"], 2), number(rival["margin_mm"], 2))
        for name, rival in rivals
        if rival
    ]
    new = (f"{version} (new)", number(compared["mean_mm"]), "", "")
    show_rows(("model", "mean mm", "new larger by mm", "chance mm"), [*rows, new], numbers=True)


def show_activations(document: Mapping[str, Any]) -> None:
    """Print the log, newest first."""
    rows = [
        (
            str(entry["at"])[:16].replace("T", " "),
            f"forced {entry['action']}" if entry["forced"] else entry["action"],
            entry["version_id"],
            entry["actor"],
            entry["reason"] or ", ".join(objection["code"] for objection in entry["objections"]),
        )
        for entry in document["activations"]
    ]
    show_list(("when", "what", "version", "by", "why"), rows)


def show_today(document: Mapping[str, Any]) -> None:
    """Print how good a robot is today, in the server's words."""
    standing = document["standing"]
    suggested = suggest_after_today(document)
    print_line(f"{standing['words']}. {standing['sentence']}")
    sentences = [one for one in document["sentences"] if one != standing["sentence"]]
    print_lines(fit_messages(sentences, screen_columns(), LINES - 1 - len(suggested), IN_JSON))
    print_lines(suggested)
