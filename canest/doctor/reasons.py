"""Why there is no estimate, in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from canest.core.gates import Gate
from canest.core.roles import ROLES
from canest.core.samples import RATE_HZ, STATUS_LABELS, Status
from canest.doctor.other_identifiers import message_of, other_format
from canest.doctor.signal_report import WHY_NOT_HELD
from canest.doctor.warnings import interleaved_clocks
from canest.pipeline.build import model_spec
from canest.vehicle.driveline_state import CLUTCH_ROLES
from canest.vehicle.model import LongitudinalModel

if TYPE_CHECKING:
    from canest.config import Config
    from canest.decode.counters import Counters
    from canest.grid.clock import Clock
    from canest.logs.base import LogReader
    from canest.pipeline.pipeline import Pipeline
    from canest.pipeline.table_map import TableMap

#: a clock that is set back this often, and for this share of its stamps, is not one clock
_FEW_JUMPS, _JUMPING_SHARE = 10, 0.01
#: fewer gaps say nothing of the unit of time
_FEW_GAPS = 10
#: a config that fits leaves a quarter of what is driven open at least (measured, simulated and real drives)
_OPEN_SHARE = 0.05
#: no more frames than these fit into a tick, at 1 Mbit/s
_MOST_IN_A_TICK = 200
#: stale roles that a sentence names
_STALE_SHOWN = 3


class FinishedRun(Protocol):
    """A log that has gone through a pipeline: what read it, and what took it."""

    @property
    def config(self) -> Config:
        """The config in use."""

    @property
    def pipeline(self) -> Pipeline:
        """What made the estimates, at the end of the log."""

    @property
    def table_map(self) -> TableMap:
        """Which column of a table is which role."""

    @property
    def reader(self) -> LogReader:
        """What read the log, at its end."""


def why_unestimated(run: FinishedRun) -> str:
    """Return the reason: a signal that nothing works without, else the gates, else too little data."""
    if not run.reader.frames:
        return "the log is empty: it holds no frames"
    if run.reader.kind == "table":
        lacking = _lacking_column(run)
    else:
        lacking = why_no_signal(run.config, run.pipeline.decoder.counters, run.reader.frames)
    if lacking:
        return lacking
    return why_not_learning(run)


def needed_roles(config: Config, model: LongitudinalModel) -> dict[str, str]:
    """Return the roles without which nothing is learned -> what else a user should know about one."""
    needed = dict.fromkeys(model.required_roles(), "")
    if "engine_torque_pct" in needed and config.vehicle.reference_torque_Nm is None:
        without = (
            "torque in percent means nothing without it: vehicle.reference_torque_Nm can give it instead"
        )
        needed["reference_torque"] = f", and {without}"
    if config.gates.brake.assume_when_pedal_released and "accelerator" in config.signals:
        needed["accelerator"] = ", and gates.brake.assume_when_pedal_released takes that for braking"
    return needed


def why_no_signal(config: Config, counters: Counters, frames: int) -> str:
    """Return which needed signal never had a value in the log's frames, '' when all had."""

    def problem_of(role: str) -> str:
        if _valid(counters, role):
            return ""
        return f"{describe(config, role)} {_absence(config, counters, role, frames)}"

    return what_lacks(config, LongitudinalModel(model_spec(config)), problem_of)


def what_lacks(config: Config, model: LongitudinalModel, problem_of: Callable[[str], str]) -> str:
    """Return the first thing that a force cannot be had without, '' when all is there.

    problem_of: what is wrong with a role that has not a single value, '' for one that has some.
    """
    for role, more in needed_roles(config, model).items():
        if reason := problem_of(role):
            return reason + more
    speeds = [problem_of(role) or _clutch_lacks(role, config, problem_of) for role in model.speed_roles]
    if all(speeds):
        return "no speed: " + "; ".join(speeds)
    ways = [[reason for role in way if (reason := problem_of(role))] for way in model.ratio_ways]
    if ways and all(ways):
        return "no gear ratio: " + "; ".join(dict.fromkeys(reason for way in ways for reason in way))
    return ""


def _clutch_lacks(role: str, config: Config, problem_of: Callable[[str], str]) -> str:
    """Return why an engine's speed gives none of the vehicle, '' where it may."""
    if role != "engine_speed" or config.vehicle.has_one_gear:
        return ""
    mapped = [clutch for clutch in CLUTCH_ROLES if clutch in config.signals]
    if any(not problem_of(clutch) for clutch in mapped):
        return ""
    return f"engine_speed gives none while {' and '.join(mapped)}, which report the clutch, have no value"


def why_not_learning(run: FinishedRun) -> str:
    """Return what kept an estimator with all its signals from an estimate."""
    pipeline = run.pipeline
    missing = pipeline.estimator.missing()
    if missing:
        return f"estimator {run.config.estimator.name} cannot work here: {missing}"
    shares = gate_shares(pipeline.gate_counts, pipeline.samples)
    if backward := why_no_time(pipeline.clock):
        return backward
    if not pipeline.samples:
        return "the log is too short for a single 50 Hz sample of the needed signals"
    if not pipeline.updated:
        return (
            f"every sample was refused by a gate: {shares}{stale_roles_text(pipeline)} "
            "(canest check compares the signals)"
        )
    return (
        f"only {pipeline.updated / RATE_HZ:.1f} s of {pipeline.samples / RATE_HZ:.1f} s could be learned from"
        + (f" (gates: {shares})" if shares else "")
    )


def why_hardly_open(pipeline: Pipeline, status: str) -> str:
    """Return why an estimator that got some samples does not work all the same, '' where it does.

    While the vehicle drives, most samples are open; where hardly one is, a gate is closed that should not be.
    """
    driven = pipeline.samples - pipeline.gate_counts.get(Gate.LOW_SPEED.label, 0)
    shares = gate_shares(pipeline.gate_counts, pipeline.samples)
    if pipeline.updated < _OPEN_SHARE * driven:
        return (
            f"hardly any sample may be learned from, {pipeline.updated:,} of {driven:,} while driving: "
            f"closed are {shares}{stale_roles_text(pipeline)}"
        )
    if status == STATUS_LABELS[Status.UNESTIMATED]:
        learned_s, all_s = pipeline.updated / RATE_HZ, pipeline.samples / RATE_HZ
        closed = f" (closed: {shares})" if shares else ""
        return f"no estimate yet: {learned_s:.1f} s of {all_s:.1f} s could be learned from{closed}"
    return ""


def why_no_time(clock: Clock) -> str:
    """Return that time stands still, runs backwards or comes from two clocks, '' where it passes."""
    set_back, stamps = clock.counters["clock_set_back"], clock.stamps
    backward = max(clock.counters["reordered"] + set_back, clock.decreasing)
    if interleaved := interleaved_clocks(clock):
        return interleaved
    if 2 * backward > stamps:
        # small steps alone, never far back: no clock, but the time from each frame to the next
        differences = "" if set_back else " (candump -t d writes differences, -t a writes times)"
        found = f"{backward:,} of {stamps:,} stamps lie before one that precedes them"
        return f"time runs backwards: {found}{differences}"
    if set_back > max(_FEW_JUMPS, _JUMPING_SHARE * stamps):
        return f"the time stamps jump back {set_back:,} times: out of order, or of two clocks in one log"
    gaps = clock.counters["gaps"]
    # frames come in bursts: of a log in milliseconds the gaps may be fewer than the stamps between them
    if 2 * gaps > stamps > 2 or (gaps >= _FEW_GAPS and 2 * clock.in_scraps > stamps):
        hold_s = clock.hold_us * 1e-6
        return (
            f"{gaps:,} of {stamps:,} stamps come more than {hold_s:g} s (sampling.hold_s) "
            "after the one before: are they in seconds?"
        )
    if stamps > _MOST_IN_A_TICK and clock.first_us == clock.last_us and not backward:
        return f"time stands still: all {stamps:,} stamps are the same"
    return ""


def stale_roles_text(pipeline: Pipeline) -> str:
    """Return which roles closed the gate `stale`, the longest first, '' where none did."""
    worst = sorted(pipeline.stale_ticks.items(), key=lambda item: -item[1])
    shares = (
        f"{role} {100 * ticks / max(pipeline.samples, 1):.0f} %" for role, ticks in worst[:_STALE_SHOWN]
    )
    return f" (stale: {', '.join(shares)})" if worst else ""


def gate_shares(gates: dict[str, int], samples: int) -> str:
    """Return the gates by how much they refused, largest first."""
    ordered = sorted(gates.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {100 * count / max(samples, 1):.0f} %" for name, count in ordered)


def describe(config: Config, role: str) -> str:
    """Return a role as a person would ask for it: what it is, and where the config expects it."""
    source = config.signals[role]
    text = ROLES[role].text if role in ROLES else "signal of an effect"
    if source.column is not None:
        return f"{role} ({text}; column {source.column})"
    origin = f"{source.message}.{source.signal}"
    if source.source is not None:
        origin += f" from 0x{source.source:02X}"
    return f"{role} ({text}; {origin})"


def _valid(counters: Counters, role: str) -> int:
    return sum(c.valid for c in counters.of_role(role).values())


def _absence(config: Config, counters: Counters, role: str, frames: int) -> str:
    seen = counters.of_role(role).values()
    missing, wrong = sum(c.not_available for c in seen), sum(c.error_value for c in seen)
    if missing and not wrong:
        return f"was sent as not available in all {missing:,} frames"
    if missing or wrong:
        return f"never had a value: {missing:,} frames not available, {wrong:,} in the error range"
    message = message_of(config, role)
    senders = [sender for sender in counters.senders.values() if role in sender.roles]
    unfit = sum(sender.wrong_length for sender in senders)
    if message is not None and unfit and unfit == sum(sender.frames for sender in senders):
        expected = f"the length that the DBC declares, {message.length} bytes"
        return f"never had a value: none of {unfit:,} frames has {expected}"
    if message is not None and (came := sum(sender.frames for sender in senders)):
        return f"never had a value: none of {came:,} frames holds it: {WHY_NOT_HELD}"
    other = other_format(config, role, counters)
    return f"was never seen in {frames:,} frames" + (f"; {other}" if other else "")


def _lacking_column(run: FinishedRun) -> str:
    held = set(getattr(run.reader, "columns", ()))
    bad: dict[str, int] = getattr(run.reader, "bad_cells", {})

    def problem_of(role: str) -> str:
        if role not in run.table_map.roles:
            return f"{describe(run.config, role)} is no column, and the log is a table"
        column = run.table_map.roles[role][0]
        if column not in held:
            return f"{describe(run.config, role)} is not in the table, which has {', '.join(sorted(held))}"
        if run.table_map.without_value.get(role, 0) >= run.reader.frames:
            return f"{describe(run.config, role)} holds nothing that signals.{role}.map lists"
        if bad.get(column, 0) >= run.reader.frames:
            return f"{describe(run.config, role)} holds no number in any of {run.reader.frames:,} rows"
        return ""

    return what_lacks(run.config, LongitudinalModel(model_spec(run.config)), problem_of)
