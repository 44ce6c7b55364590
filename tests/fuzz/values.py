"""Values that break what reads them: numbers beyond every type, texts that no database or terminal likes."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

WHOLE = [0, -1, 1, 2**31, 2**53 + 1, 2**63 - 1, 2**63, -(2**63) - 1, 2**64, 10**30, 10**400]
REAL = [0.0, -0.0, 1e-320, 5e-324, 1e308, -1e308, 1.7976931348623157e308, 1e-9, 0.1]
TEXTS = [
    "", " ", "\x00", "a\x00b", "\ud800", "x\udfff", "\u202egnp.exe", "\u200b", "\ufeff", "\r\n", "\x1b[31m", "\x7f",
    "=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "nan", "inf", "1e999", "null", "../../etc/passwd", "%00", "%2e%2e", "'", "\"",
    "'; DROP TABLE robot; --", "%s%n", "{}", "latest", "nominal", "cmp_", "ver_", "job_", "\U0001f916", "é" * 40,
    "a" * 201, "a" * 5000, "9" * 400, "-9223372036854775809", "18446744073709551616", "١٢٣", "W10", "WyJhIl0", "WzFd",
]  # fmt: skip
# What JSON parsers accept, refuse or choke on; never to be parsed again here.
RAW = [
    b"", b" ", b"null", b"true", b"0", b'""', b"[]", b"{}", b"[[]]", b"{", b"}", b"nul", b"NaN", b"-Infinity", b"1e999",
    b'{"a":1e999}', b'{"name":"a","name":"b"}', b"\xef\xbb\xbf{}", b"\xff\xfe{\x00}\x00", b"\x00", b"\xc3\x28", b"{}{}",
    b"[" * 100_000, b'{"a":' * 50_000, b"[" * 900 + b"]" * 900, b'{"a":' * 400 + b"1" + b"}" * 400, b"9" * 5000,
    b'{"name":"\\ud800"}', b'{"name":"\\u0000"}', b'{"\\ud800":1}', b'{"\\u0000":1}', b"-" * 1000, b'"' + b"a" * 70_000 + b'"',
]  # fmt: skip

texts = st.one_of(
    st.sampled_from(TEXTS),
    st.text(max_size=12),
    st.text(st.characters(codec=None, categories=None), max_size=6),
)
numbers: st.SearchStrategy[Any] = st.one_of(
    st.sampled_from([*WHOLE, *REAL]), st.integers(), st.floats(allow_nan=False, allow_infinity=False)
)
anything: st.SearchStrategy[Any] = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, texts),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=6,
)
