"""What an identification says besides its errors: parameters, intervals, influence, and how well the poses were chosen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from kilter_client.cli.terminal.output import number, print_line, show_rows
from kilter_client.files import files_look
from kilter_client.results.record import decimals, ends, estimate

NOMINAL_DIGITS = 7  # the nominal robot is exact
MANY_WEIGHTS = 12  # learned weights from which a line stands for all of them
LEARNED = "residual_"
INDICES = ("O1", "O2", "O3", "O4", "O5")
MOST_INFLUENCES = 30
MOST_ROWS = 10


def show_parameters(parameters: list[Mapping[str, Any]]) -> None:
    """Print parameters: nominal, value, change and 95 % interval, with the digits that their sigma allows."""
    if not parameters:
        return
    weights = [p for p in parameters if str(p["name"]).startswith(LEARNED)]
    folded = weights if len(weights) > MANY_WEIGHTS else []
    rows = [_row(p) for p in parameters if p not in folded]
    show_rows(("parameter", "nominal", "value", "change", "95 %", "unit", ""), rows)
    if folded:
        print_line(
            f"and {len(folded)} learned weights, {folded[0]['name']} to {folded[-1]['name']}: no physics; see --json"
        )


def show_identification(result: Mapping[str, Any]) -> None:
    """Print what an identification adds: method, intervals, learning, observability, groups, influence."""
    for line in _lines(result):
        print_line(line)
    if result.get("prior"):
        print_line(result["prior"]["sentence"])
    if result.get("masses"):
        print_line(result["masses"]["sentence"])
    show_load_model(result.get("load_model") or [])
    if (result.get("method") or {}).get("name") == "influence":  # of the others the page shows it
        _influence(result.get("influence") or [])


def _set_aside(rows: list[Mapping[str, Any]]) -> Iterator[str]:
    if rows:
        named = [f"{r['campaign']} row {r['row']} ({number(r['residual_sigma'], 2)} sigma)" for r in rows[:MOST_ROWS]]
        more = f" and {len(rows) - MOST_ROWS} more" if len(rows) > MOST_ROWS else ""
        yield f"{len(rows)} rows count less than half: {', '.join(named)}{more}; see kilter measure suspicious"


def _views(pixels: Mapping[str, Any]) -> Iterator[str]:
    if pixels.get("given_mm") is not None and pixels.get("shuffled_mm") is not None:
        yield (
            f"before the fit camera and arm agree to {number(pixels['given_mm'])} mm, "
            f"with shuffled joints to {number(pixels['shuffled_mm'])} mm"
        )


def _lines(result: Mapping[str, Any]) -> Iterator[str]:
    method = result.get("method") or {}
    if method:
        more = ", ".join(f"{k.replace('_', ' ')} {_short(v)}" for k, v in method.items() if k != "name")
        yield f"method {method['name']}" + (f": {more}" if more else "")
    yield from _set_aside(result.get("set_aside") or [])
    yield from _views(result.get("pixels") or {})
    if result.get("intervals"):
        yield f"95 % intervals by {result['intervals']}"
    learned = result.get("learned") or {}
    if learned.get("p_value") is not None:
        yield (
            f"{', '.join(learned['effects'])} {'kept' if learned['kept'] else 'left out'}: error of poses held out "
            f"{number(learned['held_out_without_mm'])} mm without, {number(learned['held_out_with_mm'])} mm with it, "
            f"p = {number(learned['p_value'], 2)}"
        )
    frames = result.get("reference") or {}
    if frames:
        yield describe_correction_frames(frames)
    seen = result.get("observability") or {}
    if seen:
        values = ", ".join(f"{name} {number(seen.get(name), 3)}" for name in INDICES)
        yield f"observability: {values}; {seen['rank']} of {seen['parameters']} directions seen"
    groups = result.get("correlated_groups") or []
    if groups:
        yield "parameters that go together (correlation):"
    for group in groups:
        yield f"  {number(group['correlation'], 3)}  {', '.join(group['parameters'])}"


def describe_correction_frames(frames: Mapping[str, str]) -> str:
    """Say in which frames corrections work."""
    return f"corrections work in the base frame of the {frames['base']} and the tool frame of the {frames['tool']}"


def _influence(rows: list[Mapping[str, Any]]) -> None:
    """How far the tool moves when each parameter alone is off by its step, most influential first."""
    if not rows:
        return
    texts = [
        (
            str(row["name"]),
            f"{number(row['step'], 3)} {row['unit']}",
            *(number(row[key], 3) for key in ("mean_mm", "min_mm", "max_mm", "mean_k")),
            f"{100 * row['leads']:.0f} %",
        )
        for row in rows[:MOST_INFLUENCES]
    ]
    head = ("influence of", "off by", "mean mm", "least", "most", "mean k", "leads")
    show_rows(head, texts, numbers=True)
    if len(rows) > MOST_INFLUENCES:
        print_line(f"and {len(rows) - MOST_INFLUENCES} of less influence; see --json")


def _row(p: Mapping[str, Any]) -> tuple[str, ...]:
    value, sigma = p.get("value"), p.get("sigma")
    places = decimals(sigma)
    shown = "-" if value is None else estimate(value, places)
    interval = ends(value, sigma, p.get("lower"), p.get("upper"))
    nominal = number(p.get("nominal"), NOMINAL_DIGITS)
    change = estimate(p.get("change"), places)
    return str(p["name"]), nominal, shown, change, interval, str(p.get("unit") or ""), _remark(p)


def _remark(p: Mapping[str, Any]) -> str:
    if p.get("reason"):
        return str(p["reason"])
    if p.get("stiffness_nm_deg"):
        return f"stiffness {number(p['stiffness_nm_deg'])} N m/deg"
    if p.get("from_prior"):
        return "from other robots of the type"
    if not p.get("identifiable", True):
        return "not identifiable from these poses"
    return "" if p.get("plausible", True) else files_look.why_unusual(p["name"], p.get("value"), p.get("sigma"))


def _short(value: Any) -> str:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else number(value)


HEAD = ("body", "", "stated", "found", "sigma", "stated sigma", "unit")


def show_load_model(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the masses that the data could see, and count the others."""
    seen = [row for row in rows if row["seen"]]
    if seen:
        show_rows(HEAD, [_load_row(row) for row in seen], title="Masses that the data determine")
    if len(seen) < len(rows):
        print_line(
            f"{len(rows) - len(seen)} of {len(rows)} masses and centres are known no better than stated; see --json"
        )


def _load_row(row: Mapping[str, Any]) -> tuple[str, ...]:
    body = "payload" if row["link"] is None else f"link {row['link']}"
    found = (number(row[key]) for key in ("stated", "value"))
    return body, str(row["parameter"]), *found, *(number(row[key], 2) for key in ("sigma", "prior_sigma")), row["unit"]
