"""The sentences of a diagnosis: what was found, that an engineer can act on."""

from __future__ import annotations

from collections.abc import Sequence

from canest.diagnosis.search.choice import Chosen
from canest.vehicle.effects import effect_class


def describe(chosen: Chosen) -> str:
    """Return an effect with its value as part of a sentence, e.g. "a headwind of 6.5 ± 0.1 m/s"."""
    return chosen.effect().describe(chosen.std)


def describe_equivalents(chosen: Chosen) -> str:
    """Return which other effects would do as well, and what would separate them ('' when none)."""
    names = list(dict.fromkeys(e.effect for e in chosen.equivalent if e.effect != chosen.candidate.effect))
    if not names:
        return ""
    listed = ", ".join(n.replace("_", " ") for n in names)
    way = effect_class(names[0]).separated_by
    return f"this data cannot tell it from {listed}" + (f"; {way} would" if way else "")


def finding_of(
    verdict: str,
    chosen: Sequence[Chosen],
    before_N: float,
    after_N: float,
    hints: Sequence[str],
    hidden_N: float | None = None,
) -> str:
    """Return the one sentence of the report. hidden_N: what no effect alone removes more of, where so."""
    if verdict == "nothing-to-explain":
        return f"The model fits this data as well as its noise allows ({before_N:.0f} N): nothing to add."
    hint = f" The remainder goes with {hints[0]}." if hints else ""
    if not chosen:
        missing = f"Something is missing from the model ({before_N:.0f} N of residual)"
        return f"{missing}, {_why_none(hidden_N)}.{hint}"
    change = f"held-out residual {before_N:.0f} N before, {after_N:.0f} N after"
    if verdict == "unexplained":
        only = describe(chosen[0])
        return f"Most of the residual stays unexplained ({change}); {only} is all that was found.{hint}"
    added = ", with ".join(filter(None, (describe(chosen[0]), " and ".join(map(describe, chosen[1:])))))
    alike = describe_equivalents(chosen[0])
    rest = f" A part stays unexplained.{hint}" if verdict == "partly" else ""
    return f"{capitalised(added)}: {change}{'; ' + alike if alike else ''}.{rest}"


def _why_none(hidden_N: float | None) -> str:
    """Return why nothing was found in a residual that something causes."""
    if hidden_N is None:
        return "and none of the known effects explains it"
    return (
        f"and what any known effect would remove of it is below {hidden_N:.0f} N, too little to be noticed: "
        "half a step of the reported torque, or a slope of 0.02 %"
    )


def capitalised(text: str) -> str:
    """Return a text that begins with a capital letter, otherwise as it is."""
    return text[:1].upper() + text[1:]


def too_short_finding(seconds: float, needed_s: float, residual_N: float) -> str:
    """Return the finding of a log that is too short to separate effects."""
    return (
        f"{seconds:.0f} s with open gates show how large the residual is ({residual_N:.0f} N), not where it "
        f"comes from: {needed_s:.0f} s are the least, some minutes at different speeds and loads are better."
    )
