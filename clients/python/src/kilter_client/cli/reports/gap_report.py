"""The report of a gap search as text: where, what, how much it closes, what could not be tested, what to measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_client.cli.reports.identify_report import describe_correction_frames, show_load_model
from kilter_client.cli.terminal.output import number, print_line, show_rows

MOST_PLACES = 12
TORQUE_HEAD = ("joint", "rigid bodies", "with friction", "with what was found", "unit")
STANDS_OUT = 0.05  # p of a place below which it stands out
BAR = 40  # characters of the longest bar
GAP_ROWS = (
    ("before", "train", "before"),
    ("after", "train", "after"),
    ("noise_rms", "train", "noise floor"),
    ("validation_before", "held out", "before"),
    ("validation_after", "held out", "after"),
    ("validation_noise_rms", "held out", "noise floor"),
)


def show_gap(result: Mapping[str, Any]) -> None:
    """Print a gap report."""
    print_line(f"verdict: {result['verdict']}. {result.get('sentence') or ''}".rstrip())
    if result.get("motion"):
        _show_motion(result)
        return
    gap = result["gap"]
    unit = "deg" if gap.get("before_deg") is not None else "mm by views" if gap.get("lengths") == "by_views" else "mm"
    _show_misfit_places(result.get("where") or [])
    _effects(result.get("effects") or [], unit)
    whole = (result.get("adequacy") or {}).get("sentence")
    if whole:
        print_line(f"the model as a whole: {whole}")
    _gap(result, unit)
    _kinds(result.get("measurements") or [])
    _control(result)
    if result.get("prior"):
        print_line(result["prior"]["sentence"])
    show_load_model(result.get("load_model") or [])
    show_unobservable(result.get("null_directions") or [])
    _not_testable(result.get("not_testable") or [])
    _next_poses(result.get("next_poses") or [], result.get("told_apart") or {})
    if result.get("version_id") and result.get("reference"):
        print_line(describe_correction_frames(result["reference"]))
    for warning in result.get("warnings") or ():
        if warning.get("code") != "poses_will_not_tell":  # said with the poses
            print_line(f"warning: {warning['message']}")


def _show_motion(result: Mapping[str, Any]) -> None:
    """Print what a log of torques says, joint by joint."""
    _effects(result.get("effects") or [], "mm")
    motion = result["motion"]
    show_rows(TORQUE_HEAD, list_torques(motion), title=f"Torques never used, rms ({motion['motions']} motions in all)")
    rows = [(one["name"], number(one["value"], 3), one["unit"]) for one in motion["friction"]]
    show_rows(("offset and friction", "value", "unit"), rows)
    for warning in result.get("warnings") or ():
        print_line(f"warning: {warning['message']}")


def list_torques(motion: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return rows of what models leave of the torque of each joint."""
    return [
        (str(one["joint"]), *(number(one[key], 3) for key in ("rigid", "friction", "found")), one["unit"])
        for one in motion["joints"]
        if not one["at_rest"]
    ]


def _show_misfit_places(places: Sequence[Mapping[str, Any]]) -> None:
    sure = [p for p in places if p["p_value"] < STANDS_OUT]
    if not sure:
        if places:
            print_line(
                f"Where the model is wrong: no place stands out (the clearest has p {number(places[0]['p_value'], 2)})"
            )
        return
    rows = [
        (str(p["factor"]), str(p["level"]), number(p["excess"], 3), number(p["p_value"], 2)) for p in sure[:MOST_PLACES]
    ]
    show_rows(("where", "level", "excess chi2", "p"), rows, title="Where the model is wrong")
    if len(sure) > MOST_PLACES:
        print_line(f"  and {len(sure) - MOST_PLACES} more: see --json")


def _effects(effects: Sequence[Mapping[str, Any]], unit: str) -> None:
    if not effects:
        print_line("Nothing is missing that the library could name.")
        return
    rows = []
    for effect in effects:
        aliases = ", ".join(_name(alias) for alias in effect.get("alias_set") or ())
        amounts = [_amount(p) for p in effect.get("parameters") or ()] or [("", "", "")]
        head = (
            str(effect["id"]),
            _joints(effect),
            str(effect["verdict"]),
            number(effect.get("gain_mm"), 3),
            *([] if unit == "deg" else [number(effect.get("moves_mm"), 3)]),
            number(effect.get("p_value"), 2),
            aliases,
        )
        rows += [(*(head if k == 0 else ("",) * len(head)), *amount) for k, amount in enumerate(amounts)]
    moves = () if unit == "deg" else ("moves mm",)
    head_row = ("effect", "joints", "verdict", f"gain {unit}", *moves, "p", "or one of")
    show_rows(
        (*head_row, "parameter", "amplitude", "interval"),
        rows,
        title="What is missing, with amplitudes as the search fitted them",
    )
    for effect in effects:
        _class(effect)
        failed = [name for name, passed in (effect.get("gates") or {}).items() if passed is False]
        if failed or (effect["verdict"] == "provisional" and effect.get("to_confirm")):
            passed = f"not passed {', '.join(failed)}" if failed else "not all tests were made"
            print_line(f"  {_name(effect)} is not more than {effect['verdict']}: {passed}")
            for remedy in effect.get("to_confirm") or ():
                print_line(f"    {remedy}")
        _remarks(effect, unit)


def _class(effect: Mapping[str, Any]) -> None:
    """What is claimed, where that is not one member by its name: all it may be, and what would name it."""
    claim, about = effect.get("claim") or {}, effect.get("physical_class") or {}
    if claim.get("said") != "class":
        if effect.get("class"):
            print_line(f"  {_name(effect)} stands for its class: {effect['class']}")
        return
    others = ", ".join([*(about.get("members") or ()), *(about.get("outside") or ())])
    print_line(f"  {_name(effect)} stands for its class: {claim['words']} (any of: {others})")
    lacking = " and ".join(str(e["words"]) for e in claim.get("evidence") or () if not e.get("met"))
    if lacking:
        print_line(f"    a name inside the class needs {lacking}")


def _remarks(effect: Mapping[str, Any], unit: str) -> None:
    """Joints that the data do not show, what a confirmation said, and whether it matters."""
    unseen = sorted(set(effect.get("joints") or ()) - set(effect.get("seen_joints") or effect.get("joints") or ()))
    if unseen:
        print_line(f"  {effect['id']} is not seen at joint {', '.join(map(str, unseen))}: zero is within the interval")
    gain = effect.get("gain_mm")
    if gain is not None and gain < 0.0:
        print_line(
            f"  {_name(effect)} adds {number(-gain, 2)} to the plain rms error: it is named because it explains the surer "
            "readings better, each weighed by its noise"
        )
    if effect.get("too_small_to_matter"):
        print_line(f"  {_name(effect)} moves the tool by {number(effect.get('moves_mm'), 2)} mm: too small to matter")
    for one in (effect.get("claim") or {}).get("evidence") or ():
        if one.get("met") and one.get("told"):
            print_line(f"  {_name(effect)}: {one['told']}")
    half = effect.get("halves")
    if half:
        both = (
            ""
            if half.get("with_mm") is None
            else (
                f", each predicts the other with {number(half['with_mm'], 3)} {unit}, "
                f"{number(half['without_mm'], 3)} {unit} without it"
            )
        )
        print_line(
            f"  {_name(effect)} beside what else is left: {sum(half['named'])} of 2 halves name it, amplitudes "
            f"{number(half['apart_sigma'], 2)} sigma "
            f"apart{both}{_describe_shared_joints(effect.get('joints') or (), half.get('joints'))}"
        )
    told = effect.get("replication")
    if told:
        words = {
            "replicated": "was seen again with the same amplitude",
            "contradicted": "is contradicted",
            "not_seen": "does not stand out",
            "other_size": "has another size, and predicts better all the same",
            "not_testable": "cannot be tested",
        }
        apart = f" ({number(told['apart_sigma'], 2)} sigma apart)" if told.get("apart_sigma") is not None else ""
        print_line(
            f"  in the confirmation {_name(effect)} {words[told['outcome']]}{apart}. {told.get('reason') or ''}".rstrip()
        )
        if told.get("with_mm") is not None:
            print_line(
                f"  the confirmation has {number(told['with_mm'], 3)} {unit} with it, "
                f"{number(told['without_mm'], 3)} {unit} without it"
            )


def _describe_shared_joints(joints: Sequence[int], both: Sequence[int] | None) -> str:
    """At which of several joints both halves name it."""
    if both is None or len(joints) < 2:
        return ""
    return f"; both name it at joint {', '.join(map(str, both))}" if both else "; at no joint do both name it"


def _amount(p: Mapping[str, Any]) -> tuple[str, str, str]:
    interval = f"{number(p.get('interval_low'), 3)} to {number(p.get('interval_high'), 3)}"
    return str(p["name"]), f"{number(p['value'], 4)} {p['unit']}", interval


def _gap(result: Mapping[str, Any], unit: str) -> None:
    gap = result["gap"]
    end = unit.partition(" ")[0]
    rows = [(rows, name, number(gap.get(f"{key}_{end}"), 4)) for key, rows, name in GAP_ROWS]
    show_rows(("rows", "", f"rms {unit}"), rows, title="The gap", numbers=False)
    if end != unit:
        print_line(
            "mm by views are beside the rotation of the tool, as sure as those of a typical view; moves are at the tool"
        )
    if gap.get(f"noise_{end}") is not None:
        said = f"noise of {'a joint' if unit == 'deg' else 'a coordinate'}: {number(gap[f'noise_{end}'])} {unit}"
        print_line(said if unit == "deg" else f"{said}; the noise floor above is what it leaves of an error in space")
    bars = (result.get("figures") or {}).get("gap_bar", {}).get("data") or []
    if bars:
        across, along = ("x", "y") if bars[0].get("orientation") == "h" else ("y", "x")
        _bar(bars[0][along], bars[0][across])
    closure = gap.get("closure")
    how = gap.get("held_out")
    if closure is None and how:
        print_line(f"held-out rows: {how}")
    if closure is not None:
        print_line(f"closed on held-out rows ({how}): {100 * closure:.1f} % of what is above the noise")
    if gap.get("held_out_set_aside") is not None:
        every = gap.get(f"validation_after_all_{end}")
        with_them = (
            f", which no model of this search predicts; with them after is {number(every)} {unit}" if every else ""
        )
        print_line(f"held-out rows left out of these errors: {gap['held_out_set_aside'] or 'none'}{with_them}")
    _coverage(result.get("predictive") or {}, (result.get("adequacy") or {}).get("held_out") or {})


def _coverage(told: Mapping[str, Any], unseen: Mapping[str, Any]) -> None:
    """Coverage of the intervals and chi-square of held-out rows, without and with those that were set aside."""
    if told.get("of"):
        shares = [100.0 * told[f"inside{end}"] / told[f"of{end}"] for end in ("", "_all") if told.get(f"of{end}")]
        with_them = f", {shares[1]:.0f} % with rows set aside" if len(shares) > 1 else ""
        print_line(f"held-out coordinates within their 95 % intervals: {shares[0]:.0f} % of {told['of']}{with_them}")
    if unseen:
        every = (
            f", {number(unseen['chi2_all'] / unseen['freedom_all'], 3)} with them" if unseen.get("freedom_all") else ""
        )
        print_line(
            f"chi-square of {unseen['poses']} held-out poses, which no choice saw: {number(unseen['chi2_per_freedom'], 3)} "
            f"per number, p {number(unseen['p_value'], 2)}{every}"
        )


def _bar(names: Sequence[str], values: Sequence[float]) -> None:
    longest = max(values, default=0.0) or 1.0
    width = max(len(name) for name in names)
    for name, value in zip(names, values, strict=True):
        print_line(f"  {name:<{width}} {'#' * max(1, round(BAR * value / longest))} {number(value, 3)}")


def _kinds(kinds: Sequence[Mapping[str, Any]]) -> None:
    """Noise and errors of each kind of measurement, where there are several."""
    if len(kinds) < 2:
        return
    keys = ("noise", "before", "after", "validation_before", "validation_after")
    rows = [(str(k["kind"]), str(k["unit"]), *(number(k.get(key), 3) for key in keys)) for k in kinds]
    show_rows(
        ("measured", "unit", "noise", "before", "after", "held out before", "held out after"),
        rows,
        title="By kind of measurement (rms)",
    )


def _control(result: Mapping[str, Any]) -> None:
    control = result.get("negative_control") or {}
    rows = control.get("effects") or []
    if rows:
        tried = "; ".join(
            f"{_name(r)}: {100 * r['survived']:.0f} % of {r['shuffles']} shuffles of {r['shuffled']}" for r in rows
        )
        print_line(
            f"negative control {'passed' if control.get('passed') else 'NOT passed'} (names that survived: {tried})"
        )


def _not_testable(rows: Sequence[Mapping[str, Any]]) -> None:
    """What is missing, and which effects wait for it; reasons and remedies of each are in the JSON."""
    if not rows:
        return
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(str(row.get("missing") or row["reason"]), []).append(row)
    print_line(
        f"What these data cannot test, by what is missing ({len(rows)}; how to test each: --json, not_testable):"
    )
    for missing, own in groups.items():
        print_line(f"  {missing}: {', '.join(dict.fromkeys(_name(row) for row in own))}")
        if len(own) == 1:
            print_line(f"    how to test it: {own[0]['remedy']}")


def _next_poses(poses: Sequence[Mapping[str, Any]], told: Mapping[str, Any]) -> None:
    if not poses:
        return
    print_line(f"Measure next ({len(poses)} poses):")
    for kind, change in dict.fromkeys((p.get("kind"), p.get("change")) for p in poses):
        own = [p for p in poses if (p.get("kind"), p.get("change")) == (kind, change)]
        apart, factor = " from ".join(own[0].get("separates") or ["?"]), own[-1].get("information_factor")
        more = "" if factor is None else f", information times {number(factor, 3)} after all"
        print_line(f"  {change or 'new poses'}: {len(own)}, to tell {apart}{more}")
    if told.get("sentence"):
        print_line(f"  {told['sentence']}")


def _name(effect: Mapping[str, Any]) -> str:
    joints = _joints(effect)
    return f"{effect['id']} j{joints}" if joints else str(effect["id"])


def _joints(effect: Mapping[str, Any]) -> str:
    return ",".join(str(joint) for joint in effect.get("joints") or ())


def show_unobservable(directions: list[Any]) -> None:
    """Print each combination of parameters that changes nothing that was measured."""
    if not directions:
        return
    print_line("What these data cannot distinguish:")
    for direction in directions:
        sentence = direction.get("sentence") if isinstance(direction, Mapping) else direction
        print_line(f"  - {sentence or _combination(direction)}")


def _combination(direction: Mapping[str, Any]) -> str:
    parts = direction.get("parameters") or ()
    return " ".join(f"{part['weight']:+.2f} {part['name']}" for part in parts) + " changes nothing that was measured."
