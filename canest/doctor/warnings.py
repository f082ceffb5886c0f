"""What a user should know beside the numbers: what could not be decoded or accepted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.core.roles import COMPARED
from canest.core.samples import RATE_HZ
from canest.pipeline.signal_timing import stale_limit_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canest.config import Config
    from canest.grid.clock import Clock
    from canest.pipeline.intake import Intake
    from canest.pipeline.pipeline import Pipeline

_ADDRESSES_SHOWN = 8
#: a role that was stale for less, as before its first value, is not worth a word
_STALE_LEAST_S, _STALE_SHARE = 1.0, 0.01


def interleaved_clocks(clock: Clock) -> str:
    """Return that stamps come from two clocks in turn, and what was left out; '' where they do not."""
    others = clock.of_another_clock
    if not others or 2 * clock.decreasing > clock.stamps:  # one clock that runs backwards
        return ""
    named = ", ".join(f"0x{address:02X}" for address in sorted(clock.other_addresses)[:_ADDRESSES_SHOWN])
    more = len(clock.other_addresses) - _ADDRESSES_SHOWN
    senders = (f" from {named}" + (f" and {more} more" if more > 0 else "")) if named else ""
    return (
        f"two clocks are interleaved: {others:,} of {clock.stamps:,} stamps{senders} lie far from those "
        "around them and were left out; record with one clock, or take one interface"
    )


def stale_warnings(config: Config, pipeline: Pipeline) -> list[str]:
    """Return which roles closed the gate `stale`, for how long, and after which silence they do."""
    notes = []
    for role, ticks in sorted(pipeline.stale_ticks.items(), key=lambda item: -item[1]):
        if ticks < max(_STALE_LEAST_S * RATE_HZ, _STALE_SHARE * pipeline.samples):
            continue
        limit_s = stale_limit_s(role, config.signals[role])
        never = "" if role in pipeline.intake.received else ", and never had a value"
        share = f"{100 * ticks / pipeline.samples:.0f} % of the time"
        notes.append(
            f"{role} was stale for {ticks / RATE_HZ:,.1f} s, {share}: "
            f"a value counts for {limit_s:g} s (signals.{role}.stale_s){never}"
        )
    return notes


def stream_warnings(intake: Intake, stuck_ticks: Mapping[str, int] | None = None) -> list[str]:
    """Return what could not be used of all that an intake was given, one sentence each.

    stuck_ticks: ticks on which a sensor stood still and the vehicle did not (`canest.vehicle.stuck_sensor`).
    """
    notes = []
    mended = {name: n for name, n in intake.clock.counters.items() if n}
    if mended:
        counted = ", ".join(f"{n:,} {name.replace('_', ' ')}" for name, n in mended.items())
        back_s = intake.clock.most_set_back_us * 1e-6
        by = f" by {back_s:,.1f} s at most: is it one log, in order?" if back_s else ""
        notes.append(f"time stamps: {counted}{by}")
    if interleaved := interleaved_clocks(intake.clock):
        notes.append(interleaved)
    if left_out := intake.clock.scraps_left_out:
        notes.append(
            f"{left_out:,} of {intake.clock.stamps:,} stamps lie a few at a time between gaps and were "
            "left out: are they in seconds?"
        )
    lost = intake.decoder.counters.lost()
    if lost:
        notes.append("not decoded: " + ", ".join(f"{n:,} {what}" for what, n in lost.items()))
    for role, others in sorted(intake.decoder.counters.contested().items()):
        if role in COMPARED:
            continue
        counts = ", ".join(f"{n:,} from 0x{address or 0:02X}" for address, n in others.items())
        notes.append(f"{role} comes from several addresses: not used {counts}; name one with source:")
    refused = intake.range_rate_check.refused
    if refused:
        counts = ", ".join(f"{n:,} of {role}" for role, n in sorted(refused.items()))
        notes.append(f"jumps beyond physics, not used: {counts}")
    for role, ticks in sorted((stuck_ticks or {}).items()):
        seconds = f"{ticks / RATE_HZ:,.1f} s"
        notes.append(f"{role} stood still while the vehicle did not: frozen, taken as silent for {seconds}")
    return notes
