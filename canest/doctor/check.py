"""The doctor: does this config fit this log or bus, and if not, which signal stops the estimator?"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from canest.config.sections import Source
from canest.core.frames import FrameBlock
from canest.core.roles import ROLES
from canest.core.samples import STATUS_LABELS
from canest.core.table_block import TableBlock
from canest.decode.database import is_j1939
from canest.decode.per_sender import PerSender
from canest.doctor.config_warnings import config_warnings
from canest.doctor.constant_torque import constant_torque_hints
from canest.doctor.cycle_times import clock_hints
from canest.doctor.differing_masses import ROLE, differing
from canest.doctor.facts import FactsCheck
from canest.doctor.missing_signals import missing_signal_warnings
from canest.doctor.other_identifiers import other_format, other_group_members, unknown_identifiers
from canest.doctor.past_contradiction import PastContradiction
from canest.doctor.raw_values import RawValueCheck, text_hints
from canest.doctor.reasons import (
    gate_shares,
    needed_roles,
    stale_roles_text,
    what_lacks,
    why_hardly_open,
    why_no_time,
)
from canest.doctor.received import Received, ReceivedValues
from canest.doctor.signal_report import RoleReport, Sender, address_text, complaint, judge, senders_of
from canest.doctor.slow_signals import delay_notes, slow_signal_hints
from canest.doctor.stretches import Samples
from canest.doctor.unmapped_groups import UnmappedGroups
from canest.doctor.warnings import stale_warnings, stream_warnings
from canest.logs.log_warnings import log_warnings
from canest.pipeline.build import model_spec
from canest.pipeline.pipeline import Pipeline
from canest.pipeline.signal_map import decoder_for, wants_of
from canest.pipeline.signal_timing import stale_limit_s
from canest.pipeline.table_map import TableMap, wrong_kind
from canest.vehicle.model import LongitudinalModel

if TYPE_CHECKING:
    from canest.config import Config
    from canest.logs.base import LogReader


@dataclass(slots=True)
class Report:
    """What the doctor found. stops: what keeps the estimator from working, '' when nothing does.

    hints: what to do about what was found. notes: what was not read or not used.
    """

    roles: list[RoleReport]
    frames: int
    duration_s: float
    samples: int
    updated: int
    gates: dict[str, int]
    status: str
    stops: str
    hints: list[str]
    notes: list[str]

    @property
    def ready(self) -> bool:
        """Return whether the estimator works with this config on this log or bus."""
        return not self.stops

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON types."""
        return {**asdict(self), "ready": self.ready}


#: Frames that are looked at together. A live bus gives some 40 at a time, and each look has a fixed cost.
_FRAMES_AT_ONCE = 4096


class Doctor:
    """Watches a stream; `report` returns what it saw. log: where it comes from. Errors: ConfigError."""

    def __init__(self, config: Config, log: str = "") -> None:
        self.config = config
        self.pipeline = Pipeline(config)
        self._tables = TableMap(config, log)
        self._decoder = decoder_for(config)
        anyone = {role: s.model_copy(update={"source": None}) for role, s in config.signals.items()}
        self._unmapped = _unmapped_reference(config)
        self._survey = decoder_for(config.model_copy(update={"signals": anyone | self._unmapped}))
        unowned = {role: want for role, want in wants_of(config).items() if want.source is None}
        self._by_sender = PerSender(unowned, config.databases) if unowned else None
        self._of_sender: dict[int | None, ReceivedValues] = {}
        self._received = Received(config.sampling.max_backward_s)
        self._status = STATUS_LABELS[0]
        self._facts = FactsCheck(config)
        self._past = PastContradiction()
        self._raw, self._groups = RawValueCheck(config), UnmappedGroups(config)
        self._waiting: list[FrameBlock] = []
        self._frames_waiting = 0

    def push(self, block: FrameBlock | TableBlock) -> None:
        """Take the next block of a log or bus. Small blocks of frames wait until they are worth a look."""
        if not isinstance(block, FrameBlock):
            self._look_at_waiting()
            self._look_at(block)
            return
        self._waiting.append(block)
        self._frames_waiting += max(1, len(block))  # even an empty block takes its place in the list
        if self._frames_waiting >= _FRAMES_AT_ONCE:
            self._look_at_waiting()

    def _look_at_waiting(self) -> None:
        waiting, self._waiting, self._frames_waiting = self._waiting, [], 0
        if waiting:
            self._look_at(waiting[0] if len(waiting) == 1 else FrameBlock.concatenate(waiting))

    def _look_at(self, block: FrameBlock | TableBlock) -> None:
        if not len(block):
            return
        self._received.push(block)
        if isinstance(block, FrameBlock):
            samples = self._frames(block)
            estimates = self.pipeline.push(block)
        else:
            samples = self._tables.samples(block)
            estimates = self.pipeline.push_samples(samples, block.t_us)
        self._received.values.note(samples)
        self._facts.push(samples)
        if len(estimates):
            self._status = STATUS_LABELS[int(estimates.status[-1])]
            self._past.note(self.pipeline.estimator.contradiction())

    def report(self, log: LogReader | None = None) -> Report:
        """Return what was found in all blocks so far. log: where they came from, unless from a bus."""
        self._look_at_waiting()
        estimates = self.pipeline.finish()
        if len(estimates):
            self._status = STATUS_LABELS[int(estimates.status[-1])]
        model = LongitudinalModel(model_spec(self.config))
        needed, speeds = needed_roles(self.config, model), set(model.speed_roles)
        ratio = {role for way in model.ratio_ways for role in way}
        reports = []
        for role, source in self.config.signals.items():
            need = (
                "needed" if role in needed
                else "speed" if role in speeds
                else "ratio" if role in ratio
                else "optional"
            )  # fmt: skip
            reports.append(self._role_report(role, source, need))
        order = {"needed": 0, "speed": 1, "ratio": 2, "optional": 3}
        reports.sort(key=lambda found: order[found.need])
        hints = self._hints(reports)  # compares what has come last, and the reason to stop may be in it
        if log is not None:
            hints += text_hints(self.config, getattr(log, "texts", {}))
        stops = ("" if log is None else wrong_kind(self.config, log)) or self._stops(model, reports)
        return Report(
            roles=reports,
            frames=self._received.frames,
            duration_s=self._received.duration_s,
            samples=self.pipeline.samples,
            updated=self.pipeline.updated,
            gates=self.pipeline.gate_counts,
            status=self._status,
            stops=stops,
            hints=[hint for hint in hints if hint != stops],
            notes=config_warnings(self.config, self._groups.came)
            + ([] if log is None else log_warnings(log) + self._tables.warnings())
            + stream_warnings(self.pipeline.intake, self.pipeline.stuck_ticks)
            + stale_warnings(self.config, self.pipeline)
            + delay_notes(self.config)
            + self._facts.unconfirmed(),
        )

    def _frames(self, block: FrameBlock) -> Samples:
        self._raw.push(block)
        self._groups.push(block)
        received = self._survey.push(block).samples
        if self._by_sender is not None:
            for address, samples in self._by_sender.push(block).items():
                self._of_sender.setdefault(address, ReceivedValues()).note(samples)
        self._facts.push({role: received[role] for role in self._unmapped if role in received})
        return self._decoder.push(block).samples

    def _role_report(self, role: str, source: Source, need: str) -> RoleReport:
        known = ROLES.get(role)
        found = RoleReport(
            role=role,
            text=known.text if known else "signal of an effect",
            need=need,
            expected=source.column or f"{source.message}.{source.signal}",
            source=source.source,
            unit=known.unit if known else "",
            from_table=source.column is not None,
        )
        if source.column is None:
            found.senders = senders_of(self._survey.counters, role, source.source is not None)
            if source.source is None:
                self._note_ranges(found)
        elif source.column in self._received.columns:
            bad, rows = self._received.values.missing_cells.get(role, 0), self._received.rows
            found.senders = [Sender(None, self._received.row_rate_hz, rows, rows - bad, bad, 0, 0)]
        found.labels = self._raw.labels(role) or self._tables.labels(role)
        low, high, count = self._received.values.ranges.get(role, (None, None, 0))
        found.low, found.high, found.values = low, high, count
        # a mean rate over a silence means nothing
        limit_s = math.inf if self.pipeline.clock.counters["gaps"] else stale_limit_s(role, source)
        refused = self.pipeline.intake.range_rate_check.refused[role]
        found.verdict, found.hint = judge(found, source, limit_s, refused)
        if not found.senders:
            found.hint = other_format(self.config, role, self._survey.counters)
        return found

    def _note_ranges(self, found: RoleReport) -> None:
        """Note for each sender of a role the range of its own values."""
        for sender in found.senders:
            own = self._of_sender.get(sender.address)
            if own is not None and found.role in own.ranges:
                sender.low, sender.high, _ = own.ranges[found.role]

    def _stops(self, model: LongitudinalModel, reports: list[RoleReport]) -> str:
        if not self._received.frames:
            return "nothing was received: the log is empty, or the bus is silent"
        by_role = {report.role: report for report in reports}

        def problem_of(role: str) -> str:
            found = by_role[role]
            return "" if found.values else f"{role} ({found.text}) {complaint(found)}"

        if lacking := what_lacks(self.config, model, problem_of):
            return lacking
        if refused := next((f for f in reports if f.need == "needed" and f.verdict == "refused"), None):
            return f"signals.{refused.role}: {refused.hint}"
        missing = self.pipeline.estimator.missing()
        if missing:
            return f"estimator {self.config.estimator.name} cannot work here: {missing}"
        if not self.pipeline.updated:
            backward = why_no_time(self.pipeline.clock)
            if backward or not self.pipeline.samples:
                return backward
            shares = gate_shares(self.pipeline.gate_counts, self.pipeline.samples)
            return f"every sample was refused by a gate: {shares}{stale_roles_text(self.pipeline)}"
        return self._facts.unfit() or why_hardly_open(self.pipeline, self._status)

    def _hints(self, reports: list[RoleReport]) -> list[str]:
        hints = [f"signals.{f.role}: {f.hint}" for f in reports if f.hint]
        if self._received.frames and not any(f.senders for f in reports):
            if self._received.standard_frames > self._received.frames / 2:
                seen = ", ".join(f"0x{i:03X}" for i in sorted(self._received.standard_ids)[:12])
                hints.append(
                    "none of the config's messages is there; the bus uses 11-bit identifiers, which are no "
                    f"J1939: a DBC that has {seen} is needed"
                )
            elif self._received.addresses:
                seen = ", ".join(f"0x{a:02X}" for a in sorted(self._received.addresses)[:12])
                hints.append(f"none of the config's messages is there; the bus has addresses {seen}")
        hints += other_group_members(self.config, reports, self._received.pgns)
        hints += unknown_identifiers(self.config, reports, self._received)
        if self._received.error_frames:
            hints.append(
                f"{self._received.error_frames:,} error frames: check bit rate, termination and wiring"
            )
        if self._received.frames:
            hints += missing_signal_warnings(self.config, self.pipeline.intake.received)
            hints += self._groups.hints()
            hints += slow_signal_hints(self.config, reports)
            if not self.pipeline.clock.counters["gaps"]:  # a mean rate over a silence means nothing
                hints += clock_hints(self.config, reports)
        warning = self.pipeline.estimator.contradiction()
        hints += self._raw.hints()
        if not why_no_time(self.pipeline.clock):  # without time nothing happens together
            hints += self._facts.hints()
        hints += constant_torque_hints(self.config, reports) + self._differing_masses(reports)
        return hints + ([warning] if warning else []) + self._past.notes(warning)

    def _differing_masses(self, reports: list[RoleReport]) -> list[str]:
        """Return that two senders report masses which differ."""
        senders = next((found.senders for found in reports if found.role == ROLE), [])
        last = {}
        for sender in senders:
            received = self._of_sender.get(sender.address, self._received.values)
            if (mass_kg := received.last.get(ROLE, 0.0)) > 0.0:
                last[address_text(sender.address)] = mass_kg
        return [f"signals.{ROLE}: {sentence}" for sentence in differing(last)]


def _unmapped_reference(config: Config) -> dict[str, Source]:
    """Return where an engine would send its reference torque (SPN 544) that the config does not map."""
    if "engine_torque_pct" not in config.signals or "reference_torque" in config.signals:
        return {}
    sent = Source(message="EC1", signal="EngReferenceTorque")
    known = {m.name: m for database in config.databases for m in database.messages}.get("EC1")
    has = known is not None and is_j1939(known) and any(s.name == sent.signal for s in known.signals)
    return {"reference_torque": sent} if has else {}
