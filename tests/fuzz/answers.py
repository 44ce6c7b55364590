"""Whether an answer is one that the OpenAPI document promises: status, media type and shape."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import httpx
import jsonschema_rs


class Answers:
    """The answers that an OpenAPI document promises."""

    def __init__(self, interface: Mapping[str, Any]) -> None:
        self._paths, self._components = interface["paths"], interface["components"]
        self._validators: dict[str, jsonschema_rs.Validator] = {}

    def fault(self, method: str, path: str, answer: httpx.Response) -> str | None:
        """Say what is wrong with an answer; None: it is as promised."""
        if answer.status_code >= 500 and answer.status_code != 503:
            return f"status {answer.status_code}: {answer.text[:300]}"
        responses = self._paths[path][method]["responses"]
        promised = responses.get(str(answer.status_code)) or responses.get(f"{answer.status_code // 100}XX")
        if promised is None:
            return f"status {answer.status_code} is not promised"
        if "content" not in promised:
            return f"{len(answer.content)} bytes where none are promised" if answer.content else None
        media = answer.headers.get("content-type", "").partition(";")[0]
        if media not in promised["content"]:
            return f"status {answer.status_code} as {media or 'nothing'}, promised {', '.join(promised['content'])}"
        return self._shape(media, promised["content"][media].get("schema", {}), answer)

    def _shape(self, media: str, schema: Mapping[str, Any], answer: httpx.Response) -> str | None:
        if not media.endswith("json"):
            return None
        try:
            document = json.loads(answer.content, parse_constant=_no_constant)
        except ValueError as error:
            return f"status {answer.status_code} is not JSON: {error}"
        wrong = next(self._validator(schema).iter_errors(document), None)
        return (
            None if wrong is None else f"status {answer.status_code}: {list(wrong.instance_path)} {wrong.message[:200]}"
        )

    def _validator(self, schema: Mapping[str, Any]) -> jsonschema_rs.Validator:
        key = json.dumps(schema, sort_keys=True)
        if key not in self._validators:
            whole = {"components": self._components, **schema}
            self._validators[key] = jsonschema_rs.Draft202012Validator(whole)
        return self._validators[key]


def _no_constant(name: str) -> float:
    raise ValueError(name)
