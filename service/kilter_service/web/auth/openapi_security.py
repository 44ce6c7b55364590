"""What OpenAPI says of tokens: the scheme, and for each route whether it needs one, of which role."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastapi import FastAPI

from kilter_service.web.auth.policy import rule_for_route

SCHEME = "token"
ROLE = "x-kilter-role"
WORDS = (
    "A token of this server. A higher role (viewer, operator, admin) may do what a lower one may. Where no token is an "
    "alternative, plain reads need none on the server's own machine."
)


def openapi_with_security(app: FastAPI) -> Callable[[], dict[str, Any]]:
    """Return what makes the description of an application, with its tokens."""
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        document = plain()
        schemes = document["components"].setdefault("securitySchemes", {})
        schemes[SCHEME] = {"type": "http", "scheme": "bearer", "description": WORDS}
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                _describe(operation, f"{method.upper()} {path}")
        return document

    return openapi


def _describe(operation: dict[str, Any], route: str) -> None:
    rule = rule_for_route(route)
    if rule.role is None:
        operation["security"] = []
        return
    operation[ROLE] = rule.role
    direct = rule.role == "viewer" and route.startswith("GET ")
    operation["security"] = [{SCHEME: []}, {}] if direct else [{SCHEME: []}]
