"""Verbs as methods: of a client that waits for the answer, and of one whose answers are awaited."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Coroutine
from typing import Any, Concatenate, ParamSpec, TypeVar

from kilter_client.requests.steps import Steps

P = ParamSpec("P")
T = TypeVar("T")
M = TypeVar("M")


def waiting(verb: Callable[P, Steps[T]]) -> Callable[Concatenate[Any, P], T]:
    """Return the method of a verb that returns when it is done."""

    def method(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        found: T = self.run(verb(*args, **kwargs))
        return found

    return _copy_verb_signature(method, verb)


def make_document_method(call: Callable[P, Steps[T]]) -> Callable[Concatenate[Any, P], T]:
    """Return the method of a call that returns what the server answered, as it is."""

    def method(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        found: T = self._run(call(*args, **kwargs))
        return found

    return _copy_verb_signature(method, call)


def make_async_method(verb: Callable[P, Steps[T]]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Return the method of a verb that is awaited."""

    async def method(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        found: T = await self.run(verb(*args, **kwargs))
        return found

    return _copy_verb_signature(method, verb)


def _copy_verb_signature(like: M, verb: Callable[..., Any]) -> M:
    """Give a method the name, the words and the signature of its verb; it returns what the steps end with."""
    method: Any = like
    method.__name__, method.__doc__, method.__module__ = verb.__name__, verb.__doc__, verb.__module__
    method.__qualname__ = f"Kilter.{verb.__name__}"
    signature = inspect.signature(verb)
    returns = str(signature.return_annotation).removeprefix("Steps[").removesuffix("]")
    own = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    method.__signature__ = inspect.Signature([own, *signature.parameters.values()], return_annotation=returns)
    method.__annotations__ = {**verb.__annotations__, "return": returns}
    return like
