"""The sentences of a diagnosis: what was found, that an engineer can act on, and the numbers under it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from canest.diagnosis.search.choice import Chosen
from canest.diagnosis.search.fitted_sets import FittedSet
from canest.vehicle.effects import effect_class

#: words of the first sentence at most
MAX_WORDS = 25
#: effects named at most for one cause in the first sentence, and sets in the line of those as likely
_NAMED, _SETS_NAMED = 4, 5


@dataclass(frozen=True)
class Statement:
    """What a diagnosis states: one sentence without numbers, and the lines with numbers that go under it."""

    finding: str
    details: tuple[str, ...] = ()


def describe(chosen: Chosen) -> str:
    """Return an effect with its value as part of a sentence, e.g. "a headwind of 6.5 ± 0.1 m/s"."""
    return chosen.effect().describe(chosen.std)


def by_urgency(effects: Iterable[str]) -> list[str]:
    """Return effect names, each once: dangers first, then the commonest."""
    return sorted(dict.fromkeys(effects), key=lambda n: (-effect_class(n).urgency, effect_class(n).rarity))


def far_from_given_mass(error_pct: float, stds: float) -> str:
    """Return that the estimate is far from the given mass, by more than so many standard deviations."""
    heavier = "heavier" if error_pct > 0.0 else "lighter"
    return (
        f"The estimate before is {abs(error_pct):.0f} % {heavier} than the given mass, "
        f"by more than {stds:.0f} standard deviations: if the mass is wrong, all of this is."
    )


def load_against_constant_mass() -> str:
    """Return that a changed load was found with a mass that was given as constant."""
    return (
        "The given mass is constant, and a changed load was found: these contradict each other. It is taken "
        "for the mass before the change; a truth table can hold a mass that changes."
    )


def alternatives(chosen: Chosen) -> list[str]:
    """Return the other effects that would do as well in its place, dangers first."""
    return by_urgency(e.effect for e in chosen.equivalent if e.effect != chosen.candidate.effect)


def describe_equivalents(chosen: Chosen) -> str:
    """Return which other effects would do as well, and what would separate them ('' when none)."""
    names = alternatives(chosen)
    if not names:
        return ""
    listed = ", ".join(effect_class(n).in_words() for n in names)
    way = effect_class(names[0]).separated_by
    return f"this data cannot separate it from {listed}, alone or together" + (
        f"; {way} would" if way else ""
    )


def describe_end(chosen: Chosen) -> str:
    """Return that a value lies at the end of its range ('' where it does not)."""
    end = chosen.candidate.reached_end(chosen.deviation)
    if end is None:
        return ""
    info = chosen.candidate.info
    limit = f"{end:.3g} {info.unit}".strip()
    most = "most" if end == info.high else "least"
    return f"{limit} is the {most} that is tried: the true value may lie beyond it, or the cause is another"


class Context(NamedTuple):
    """What a statement needs beside the effects that were chosen.

    rivals: sets of effects that are as likely. hints: signals that the remainder goes with. hidden_N: what no
    effect alone removes more of, where so. grade_N: what the error of the grade's reference may make. delay:
    of the torque, where it is usual and all that was found. usual: whether what is left is within the errors
    that every drive has. not_excluded: effects that this data does not rule out.
    """

    rivals: Sequence[FittedSet] = ()
    hints: Sequence[str] = ()
    hidden_N: float | None = None
    grade_N: float = 0.0
    delay: Chosen | None = None
    usual: bool = False
    not_excluded: Sequence[str] = ()


def statement_of(
    verdict: str, chosen: Sequence[Chosen], before_N: float, after_N: float, context: Context | None = None
) -> Statement:
    """Return what the report states."""
    context = context or Context()
    rivals = context.rivals
    hint = (f"The remainder goes with {context.hints[0]}.",) if context.hints else ()
    rest = (*_usually_late(context.delay), *_not_excluded(chosen, context))
    if verdict == "nothing-to-explain":
        fits = (
            f"Residual {before_N:.0f} N: noise, and what torque, tyres and wind are off by in every vehicle"
        )
        fits += f", and up to {context.grade_N:.0f} N of the grade's reference." if context.grade_N else "."
        finding = "The model fits this data as well as usual errors allow: nothing to add."
        return Statement(finding, (fits, *rest))
    if not chosen:
        why = (f"Residual {before_N:.0f} N.", _why_none(context.hidden_N))
        return Statement(
            "Something is missing from the model, and none of the known effects explains it for certain.",
            (*why, *_as_likely(chosen, rivals), *rest, *hint),
        )
    lines = [
        f"{capitalised('; '.join(filter(None, (describe(c), describe_end(c), describe_equivalents(c)))))}."
        for c in chosen
    ]
    change = f"Held-out residual {before_N:.0f} N before, {after_N:.0f} N after."
    beside = _open_beside(chosen, context) if verdict == "explained" else []
    headline = _headline(verdict, chosen, (_others(chosen, rivals), beside), usual=context.usual)
    return Statement(headline, (change, *lines, *_as_likely(chosen, rivals), *rest, *hint))


def _headline(
    verdict: str, chosen: Sequence[Chosen], besides: tuple[Sequence[str], Sequence[str]], *, usual: bool
) -> str:
    """Return the first sentence: every cause with what it may be instead, as many as there are words for.

    besides: effects of sets as likely, and effects that may be there beside one cause.
    """
    others, beside = besides
    causes = [c for c in chosen if not c.candidate.is_delay]
    if not causes:  # every engine reports late: it is no reason to look for others
        causes, others = list(chosen), ()
    causes.sort(key=_danger, reverse=True)
    end = {
        "explained": "explain{s} the residual.",
        "partly": f"explain{{s}} a part of the residual; {_of_the_rest('the rest', usual)}.",
        "unexplained": f"explain{{s}} little of the residual; {_of_the_rest('most', usual)}.",
    }[verdict]
    for named in range(_NAMED, 0, -1):
        phrases = _phrases(causes, others, named)
        subject = ", and ".join(phrases) if any(" or " in p for p in phrases) else " and ".join(phrases)
        several = len(causes) > 1
        text = f"{capitalised(subject)} {end.format(s='' if several else 's')}"
        if len(text.split()) > MAX_WORDS:
            continue
        for most in range(_NAMED, 0, -1) if beside and not several else ():
            longer = f"{text.removesuffix('.')}; {_one_of(beside, most, '')} may be there besides."
            if len(longer.split()) <= MAX_WORDS:
                return longer
        return text
    return f"{capitalised(_one_of([causes[0].candidate.effect], 1, ''))} and others {end.format(s='')}"


def _phrases(causes: Sequence[Chosen], others: Sequence[str], named: int) -> list[str]:
    """Return what each cause may be, dangers first; what was taken first where two would read the same."""
    phrases, taken_first = [], []
    for i, c in enumerate(causes):
        own, most = c.candidate.effect, named if i == 0 else min(named, 2)
        same = by_urgency([own, *alternatives(c), *(others if i == 0 else ())])
        phrases.append(_one_of(same, most, own))
        taken_first.append(_one_of([own, *(n for n in same if n != own)], most, own))
    return phrases if len({*phrases}) == len(phrases) else taken_first


def _of_the_rest(name: str, usual: bool) -> str:
    """Return the words for what is left. usual: it is within the errors that every drive has."""
    return "the rest is within usual errors" if usual else f"{name} stays unexplained"


def _danger(chosen: Chosen) -> int:
    """Return the urgency of the most dangerous effect that a choice may be."""
    return max(effect_class(n).urgency for n in (chosen.candidate.effect, *alternatives(chosen)))


def _one_of(names: Sequence[str], most: int, own: str) -> str:
    """Return "a dragging brake, wind or others": the first ones, and the one that was taken."""
    shown = list(names[:most])
    if own in names and own not in shown:
        shown[-1:] = [own] if len(shown) > 1 else shown[-1:]
    words = [effect_class(n).in_words() for n in shown]
    if len(names) > len(shown):
        words.append("others")
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _others(chosen: Sequence[Chosen], rivals: Sequence[FittedSet]) -> list[str]:
    """Return the effects of sets as likely that are neither chosen nor named beside a choice."""
    named = {c.candidate.effect for c in chosen} | {n for c in chosen for n in alternatives(c)}
    return [n for rival in rivals for n in rival.names if n not in named]


def _open_beside(chosen: Sequence[Chosen], context: Context) -> list[str]:
    """Return the effects that this data does not rule out beside one cause, dangers first.

    One effect that explains the residual is no proof that it is alone: what looks like a small error of
    another one may be a fault.
    """
    named = {*_others(chosen, context.rivals), *(n for c in chosen for n in alternatives(c))}
    return [n for n in by_urgency(context.not_excluded) if n not in named]


def _as_likely(chosen: Sequence[Chosen], rivals: Sequence[FittedSet]) -> tuple[str, ...]:
    """Return the line that names the sets which the data does not separate from the chosen one, if any."""
    others = [rival for rival in rivals if not rival.has_effects_of(chosen)]
    if len(rivals) < 2 or not others:
        return ()
    sets = [" with ".join(effect_class(n).in_words() for n in by_urgency(r.names)) or "none" for r in others]
    more = f"; and {len(sets) - _SETS_NAMED} more" if len(sets) > _SETS_NAMED else ""
    return (f"About as likely: {'; '.join(sets[:_SETS_NAMED])}{more}.",)


def _usually_late(delay: Chosen | None) -> tuple[str, ...]:
    """Return the line about a delay of the torque that is no finding; none without one."""
    if delay is None:
        return ()
    return (
        f"Torque is reported {delay.value:.2g} ± {delay.std:.1g} s late, as engines do; `effects` may have "
        f"it: {{effect: torque_delay, delay_s: {delay.value:.2g}}}.",
    )


def _not_excluded(chosen: Sequence[Chosen], context: Context) -> tuple[str, ...]:
    """Return the line of effects that may be there as well; none where all are ruled out or named before."""
    named = {name for rival in context.rivals for name in rival.names} if len(context.rivals) > 1 else set()
    names = [n for n in by_urgency(context.not_excluded) if n not in named]
    if not names:
        return ()
    listed = ", ".join(effect_class(n).in_words() for n in names)
    return (f"Not ruled out in the size of an ordinary fault: {listed}.",)


def _why_none(hidden_N: float | None) -> str:
    """Return why nothing was found in a residual that something causes."""
    if hidden_N is None:
        return "None of the known effects explains it."
    return (
        f"What any known effect would remove of it is below {hidden_N:.0f} N, too little to be noticed: "
        "half a step of the reported torque, or a slope of 0.02 %."
    )


def capitalised(text: str) -> str:
    """Return a text that begins with a capital letter, otherwise as it is."""
    return text[:1].upper() + text[1:]


def too_short_statement(seconds: float, needed_s: float, residual_N: float) -> Statement:
    """Return the statement about a log that is too short to separate effects."""
    return Statement(
        f"{seconds:.0f} s with open gates show how large the residual is, not where it comes from.",
        (
            f"Residual {residual_N:.0f} N. {needed_s:.0f} s are the least that separate effects; some "
            "minutes at different speeds and loads are better.",
        ),
    )
