"""Documents of a JSON schema: mostly as it says, now and then with a hostile value, a field too few or too many."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hypothesis import strategies as st

from tests.fuzz.values import anything, numbers, texts

Schema = Mapping[str, Any]
DEEPEST = 8


class Shapes:
    """Draws documents of the schemas of an OpenAPI document; ``known`` are ids and names that exist."""

    def __init__(self, components: Mapping[str, Any], known: list[str]) -> None:
        self._components, self._known = components, known

    def draw(self, draw: st.DrawFn, schema: Schema, wild: int, depth: int = 0) -> Any:
        """Draw a document; one value of about ``wild`` is hostile, none where it is 0."""
        if "$ref" in schema:
            return self.draw(draw, self._components[schema["$ref"].rpartition("/")[2]], wild, depth)
        if wild and draw(st.integers(1, wild)) == 1:
            return draw(anything)
        options = schema.get("oneOf") or schema.get("anyOf")
        if options:
            return self.draw(draw, draw(st.sampled_from(list(options))), wild, depth)
        if "const" in schema:
            return schema["const"]
        if "enum" in schema:
            return draw(st.sampled_from(schema["enum"]))
        return self._of_type(draw, schema, wild, depth)

    def _of_type(self, draw: st.DrawFn, schema: Schema, wild: int, depth: int) -> Any:
        kind = schema.get("type")
        if kind == "object":
            return self._object(draw, schema, wild, depth)
        if kind == "array":
            return self._array(draw, schema, wild, depth)
        if kind == "string":
            return self._text(draw, schema, wild)
        if kind in ("integer", "number"):
            return _number(draw, schema, wild)
        return draw({"boolean": st.booleans(), "null": st.none()}.get(str(kind), anything))

    def _object(self, draw: st.DrawFn, schema: Schema, wild: int, depth: int) -> dict[str, Any]:
        needed, out = set(schema.get("required", ())), {}
        for name, part in schema.get("properties", {}).items():
            if name in needed or (depth < DEEPEST and draw(st.integers(0, 3)) == 0):
                out[name] = self.draw(draw, part, wild, depth + 1)
        if wild and draw(st.integers(1, 2 * wild)) == 1:
            out[draw(texts)] = draw(anything)
        if wild and out and draw(st.integers(1, 2 * wild)) == 1:
            del out[draw(st.sampled_from(sorted(out)))]
        return out

    def _array(self, draw: st.DrawFn, schema: Schema, wild: int, depth: int) -> list[Any]:
        if "prefixItems" in schema:
            return [self.draw(draw, part, wild, depth + 1) for part in schema["prefixItems"]]
        least = schema.get("minItems", 0)
        count = draw(st.integers(least, max(least, min(schema.get("maxItems", 6), 6))))
        return [self.draw(draw, schema.get("items", {}), wild, depth + 1) for _ in range(count)]

    def _text(self, draw: st.DrawFn, schema: Schema, wild: int) -> str:
        if self._known and draw(st.booleans()):
            return draw(st.sampled_from(self._known))
        if "pattern" in schema and draw(st.booleans()):
            return draw(st.from_regex(schema["pattern"]))
        return draw(texts) if wild else draw(st.text("abcdefgh_0123", min_size=1, max_size=8))


def _number(draw: st.DrawFn, schema: Schema, wild: int) -> Any:
    if wild and draw(st.integers(1, wild)) == 1:
        return draw(numbers)
    whole = schema["type"] == "integer"
    low, high = (
        schema.get("minimum", schema.get("exclusiveMinimum")),
        schema.get("maximum", schema.get("exclusiveMaximum")),
    )
    low, high = -400 if low is None else low, 400 if high is None else high
    high = max(low, high)
    return draw(st.integers(int(low), int(high)) if whole else st.floats(float(low), float(high)))
