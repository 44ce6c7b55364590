"""Robot descriptions that would cost much: refused before the work, with the limit named; what is left grows evenly."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Callable
from types import FrameType
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_core.errors import RobotError
from kilter_core.procedures.circle_points import _alone
from kilter_core.procedures.reference_frame import frame_of_features
from kilter_service.robots.importers import urdf_tree
from kilter_service.robots.importers.urdf import chain_document

pytestmark = pytest.mark.timeout(60)  # only a backstop: a URDF of 3000 joints was never answered


def steps(work: Callable[[], Any]) -> int:
    """Count the instructions of Python that a piece of work takes."""
    count = 0

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        count += event == "opcode"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<limit lower="-1" upper="1" effort="1" velocity="1"/>{inside}</joint>'
    )


def urdf(*parts: str, links: int) -> str:
    return f'<robot name="r">{"".join(f"""<link name="l{k}"/>""" for k in range(links))}{"".join(parts)}</robot>'


def chain(n: int, kind: str = "revolute", inside: str = "") -> str:
    return urdf(*(joint(f"j{k}", f"l{k}", f"l{k + 1}", kind, inside) for k in range(n)), links=n + 1)


def crowd(n: int) -> str:
    """An arm of two joints that carries n links in a row, and n side by side."""
    parts = [joint("a", "l0", "l1"), joint("b", "l1", "l2")]
    parts += [joint(f"row{k}", f"l{k}", f"l{k + 1}", "fixed") for k in range(2, n)]
    parts += [joint(f"side{k}", "l2", f"l{n + k}") for k in range(1, n)]
    return urdf(*parts, links=2 * n)


def refused(text: str, tip: str = "l1") -> str:
    with pytest.raises(RobotError) as caught:
        chain_document(text, "l0", tip, "arm")
    assert len(caught.value.message) < 1000, "the refusal repeats what was sent"
    return caught.value.message


def test_too_many_joints_links_or_elements_are_refused() -> None:
    assert "3001 links, at most 1000 are allowed" in refused(chain(3000), "l3000")
    assert "33 joints move" in refused(chain(33), "l33")
    origin = '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>'
    arm = chain(90, "fixed", origin).replace('type="fixed"', 'type="revolute"', 1)
    assert "elements, at most 512 are allowed" in refused(arm, "l90")
    assert chain_document(chain(32), "l0", "l32", "arm").document["joints"][31]["name"] == "j31"


def test_a_crowded_urdf_costs_as_much_more_as_it_holds() -> None:
    small, large = (steps(lambda n=n: chain_document(crowd(n), "l0", "l2", "arm")) for n in (100, 400))
    assert large < 5 * small


def test_many_links_in_a_row_weigh_what_they_weigh() -> None:
    """They were merged by calls inside each other, a thousand deep."""
    heavy = crowd(450).replace("/>", '><inertial><mass value="1"/></inertial></link>', 900)
    found = chain_document(heavy, "l0", "l2", "arm")
    assert found.document["links"][1]["mass_kg"] == pytest.approx(898)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (urdf(joint("a", "l0", "l1"), joint("b", "l1", "l2"), joint("c", "l2", "l1"), links=3), "is below joints"),
        (urdf(joint("a", "l0", "l1"), joint("b", "l2", "l3"), joint("c", "l3", "l2"), links=4), "is below itself"),
        (urdf(joint("a", "l0", "l1"), joint("b", "l1", "ghost"), links=2), "'ghost', which the URDF does not have"),
        (urdf(joint("a", "l0", "l1"), joint("a", "l1", "l2"), links=3), "two joints 'a'"),
        (urdf('<link name="l0"/>', joint("a", "l0", "l1"), links=2), "two links 'l0'"),
    ],
)
def test_what_is_no_tree_is_refused(text: str, said: str) -> None:
    """A loop beside the arm was followed without an end."""
    assert said in refused(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<robot>" + "<a/>" * 60_000 + "</robot>", "more than 50000 elements"),
        ("<robot>" + "<a>" * 70 + "</a>" * 70 + "</robot>", "more than 64 elements inside each other"),
        (f'<robot {" ".join(f"""a{k}="1" """ for k in range(70))}/>', "more than 64 attributes"),
        (f'<robot name="{"n" * 5000}"/>', "more than 4096 characters"),
        (f"<{'n' * 5000}/>", "more than 4096 characters"),
        (urdf(joint("j" * 200, "l0", "l1"), links=2), "has a name of 200 characters"),
        (urdf(joint("a", "l0", "l1", inside=f'<axis xyz="{"1 " * 2000}"/>'), links=2), "is not 3 numbers"),
    ],
)
def test_xml_is_counted_while_it_is_read(text: str, said: str) -> None:
    assert said in refused(text)


def test_comments_without_an_end_are_looked_at_once() -> None:
    """A pattern looked from every beginning to the end of the text: quadratic."""
    small, large = (steps(lambda n=n: urdf_tree._without_comments("<!--" * n)) for n in (1000, 100_000))
    assert large == small
    assert urdf_tree._without_comments("a<!-- ${x} -->b<!---->c<!--d") == "abc<!--d"


def document(**fields: Any) -> dict[str, Any]:
    return {"name": "large", **fields}


ELEMENT = {"axis": "Tx", "value": 1.0}
LARGE = [
    document(convention="chain", joints=[{"name": "j"}], elements=[{"joint": "j", "axis": "Rz"}] + [ELEMENT] * 5000),
    document(convention="chain", joints=[{"name": f"j{k}"} for k in range(33)], elements=[ELEMENT]),
    *(document(convention=kind, rows=[{}] * 33) for kind in ("dh", "mdh", "s_model", "mcpc")),
    document(convention="cpc", rows=[{"b": [0, 0, 1]}] * 33),
    document(convention="poe", axes=[{"direction": [0, 0, 1]}] * 200),
    document(convention="dh", rows=[{}], links=[{}] * 600),
    document(convention="urdf", urdf="<robot/>", base_link="b" * 200, tip_link="t"),
]


@pytest.mark.parametrize("route", ["/v1/robots", "/v1/robots/check", "/v1/robots/convert?to=chain"])
@pytest.mark.parametrize("large", LARGE, ids=lambda d: f"{d['convention']}-{len(d)}-{len(str(d))}")
def test_documents_of_too_many_parts_are_refused_by_every_route(
    shared_client: httpx.Client, route: str, large: dict[str, Any]
) -> None:
    answer = shared_client.post(route, json=large)
    assert answer.status_code == 422, answer.text
    assert "at most" in answer.json()["detail"]
    assert len(answer.content) < 10_000


def test_a_frame_of_many_points_takes_no_square_of_memory() -> None:
    """10 000 points of the plane took 800 MB."""
    points = np.random.default_rng(0).uniform(0, 1, (3000, 3)) * [1, 1, 0]
    tracemalloc.start()
    frame_of_features(points, points[:3000], np.array([0.5, 0.5, 1.0]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10e6


class Counted(np.ndarray[Any, Any]):
    """An array that counts the numbers its calculations give."""

    numbers = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [np.asarray(x) if isinstance(x, Counted) else x for x in inputs]
        found = getattr(ufunc, method)(*plain, **options)
        Counted.numbers += np.size(found)
        return np.asarray(found).view(Counted)


def test_rows_all_in_other_places_are_compared_with_near_ones_only() -> None:
    counts = []
    for rows in (1000, 4000):
        Counted.numbers = 0
        q = np.random.default_rng(0).uniform(-3, 3, (rows, 6)).view(Counted)
        assert len(_alone(q, 0)) == 0
        counts.append(Counted.numbers)
    assert counts[1] < 6 * counts[0]
