from __future__ import annotations

from collections.abc import Callable

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from pydantic import BaseModel

from kilter_core.errors import NotConvergedError, TooFewPosesError
from kilter_service.ground.errors import PROBLEMS
from kilter_service.web import problems


class Payload(BaseModel):
    model_config = {"extra": "forbid"}
    count: int


@pytest.fixture
def client(serve: Callable[[FastAPI], httpx.Client]) -> httpx.Client:
    app = FastAPI()
    problems.install(app)

    @app.get("/few")
    def few() -> None:
        raise TooFewPosesError("10 poses, 12 needed: measure 2 more.", poses=np.int64(10), needed=np.arange(2))

    @app.get("/broken")
    def broken() -> None:
        raise ValueError("secret path /etc/kilter")

    @app.post("/payload")
    def payload(payload: Payload) -> Payload:
        return payload

    return serve(app)


def test_a_core_error_becomes_a_problem_document(client: httpx.Client) -> None:
    answer = client.get("/few")
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert document == {
        "type": "urn:kilter:problem:too_few_poses",
        "title": "Too few poses",
        "status": 400,
        "detail": "10 poses, 12 needed: measure 2 more.",
        "code": "too_few_poses",
        "context": {"poses": 10, "needed": [0, 1]},
        "request_id": answer.headers["x-request-id"],
    }


def test_an_unexpected_error_leaks_nothing(client: httpx.Client, caplog: pytest.LogCaptureFixture) -> None:
    answer = client.get("/broken")
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert answer.json()["request_id"] in caplog.text


def test_an_unknown_field_is_a_422_that_names_it(client: httpx.Client) -> None:
    answer = client.post("/payload", json={"count": 1, "colour": "red"})
    assert answer.status_code == 422
    assert answer.json()["code"] == "payload_invalid"
    assert answer.json()["context"]["errors"][0]["place"] == "body.colour"


@pytest.mark.parametrize(
    ("method", "path", "code"), [("GET", "/nowhere", "not_found"), ("PUT", "/few", "method_not_allowed")]
)
def test_what_the_framework_refuses_is_a_problem_too(client: httpx.Client, method: str, path: str, code: str) -> None:
    assert client.request(method, path).json()["code"] == code


def test_every_code_of_core_is_in_the_table() -> None:
    from kilter_core import errors as core_errors

    codes = {
        c.default_code
        for c in vars(core_errors).values()
        if isinstance(c, type) and issubclass(c, core_errors.CoreError)
    }
    assert codes - {"core_error"} <= set(PROBLEMS)
    assert NotConvergedError.default_code in PROBLEMS
