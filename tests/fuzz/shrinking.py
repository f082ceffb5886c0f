"""Hypothesis as a fuzzer: edits of the seeds that it chooses, and shrinks once one has done harm."""

from __future__ import annotations

import time
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from .engine import LARGEST, Finding, run_one
from .targets import Target

_ROUND = 200  #: inputs between two looks at the clock


def inputs(target: Target) -> st.SearchStrategy[bytes]:
    """Return a strategy: a seed with up to eight spans replaced by tokens, bytes or other parts of a seed."""
    pool = [data[:LARGEST] for data in target.seeds()]
    spans = st.sampled_from(pool).flatmap(
        lambda data: st.integers(0, len(data)).map(lambda at: data[at : at + 64])
    )
    tokens = [st.sampled_from(list(target.tokens))] if target.tokens else []
    edit = st.tuples(st.floats(0, 1), st.integers(0, 40), st.one_of(st.binary(max_size=12), spans, *tokens))
    return st.builds(_edited, st.sampled_from(pool), st.lists(edit, max_size=8)) | st.binary(max_size=200)


def _edited(data: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    for place, span, new in edits:
        at = int(place * len(data))
        data = data[:at] + new + data[at + span :]
    return data[:LARGEST]


def fuzz_by_hypothesis(target: Target, seconds: float, first_seed: int = 0) -> str:
    """Run inputs for some seconds; return a line of figures. Errors: Finding, shrunk."""
    strategy, count, found = inputs(target), 0, list[Finding]()
    target.run(target.seeds()[0])  # what is made once (imports, a drive) is not the input's fault
    until_s = time.monotonic() + seconds

    def run(data: bytes) -> None:
        nonlocal count
        if time.monotonic() > until_s and not found:
            return
        count += 1
        try:
            run_one(target, data)
        except Finding as finding:
            found.append(finding)
            raise

    while time.monotonic() < until_s:
        first_seed += 1
        rules: Any = settings(
            max_examples=_ROUND,
            deadline=None,
            database=None,
            phases=[Phase.generate, Phase.shrink],
            suppress_health_check=list(HealthCheck),
        )
        try:
            seed(first_seed)(rules(given(strategy)(run)))()
        except Exception as error:
            if found:
                raise found[-1] from error
            raise
    return f"{target.name}: {count:,} inputs by hypothesis in {seconds:.0f} s, nothing found"
