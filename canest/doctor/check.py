"""The doctor: does this config fit this log or bus, and if not, which signal stops the estimator?"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.config.sections import Source
from canest.core.frames import ERROR, EXTENDED, FloatColumn, FrameBlock, IntColumn
from canest.core.roles import ROLES
from canest.core.samples import STATUS_LABELS
from canest.core.table_block import TableBlock
from canest.decode import j1939
from canest.decode.database import find_signal, is_j1939
from canest.doctor.consistency import Plausibility
from canest.doctor.missing_signals import unheard
from canest.doctor.raw_values import RawValues, text_hints
from canest.doctor.reasons import gate_shares, needed_roles, what_lacks, why_hardly_open, why_no_time
from canest.doctor.signal_report import Finding, Sender, complaint, judge, senders_of
from canest.doctor.switches import Switches
from canest.doctor.torque_samples import StuckTorque
from canest.doctor.warnings import log_notes, stream_notes
from canest.pipeline.build import model_spec, stale_limit_s
from canest.pipeline.pipeline import Pipeline
from canest.pipeline.signal_map import SAYS_J1939, decoder_for
from canest.pipeline.tables import TableMap, wrong_kind
from canest.vehicle.model import LongitudinalModel

if TYPE_CHECKING:
    from canest.config import Config
    from canest.logs.base import LogReader

Samples = dict[str, tuple[IntColumn, FloatColumn]]


@dataclass(slots=True)
class Report:
    """The doctor's findings. stops: what keeps the estimator from working, '' when nothing does.

    hints: what to do about what was found. notes: what was not read or not used.
    """

    roles: list[Finding]
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


class Doctor:
    """Watches a stream; `report` says what it saw. Errors: ConfigError."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.pipeline = Pipeline(config)
        self._tables = TableMap(config)
        self._listening = decoder_for(config)
        anyone = {role: s.model_copy(update={"source": None}) for role, s in config.signals.items()}
        self._unasked = _unasked_reference(config)
        self._survey = decoder_for(config.model_copy(update={"signals": anyone | self._unasked}))
        self._ranges: dict[str, tuple[float, float, int]] = {}
        self._rows = self._bad_frames = self._standard_frames = self.frames = 0
        self._missing_cells: dict[str, int] = {}
        self._table_columns: set[str] = set()
        self._addresses: set[int] = set()
        self._pgns: set[int] = set()
        self._span_us: tuple[int, int] | None = None
        self._status = STATUS_LABELS[0]
        self.plausibility = Plausibility(config)
        self._comparisons = (self.plausibility, Switches(config), StuckTorque(config))
        self._raw = RawValues(config)

    def push(self, block: FrameBlock | TableBlock) -> None:
        """Take the next block of a log or bus."""
        if not len(block):
            return
        first, last = int(block.t_us.min()), int(block.t_us.max())
        known = self._span_us or (first, last)
        self._span_us = min(first, known[0]), max(last, known[1])
        self.frames += len(block)
        if isinstance(block, FrameBlock):
            samples = self._frames(block)
            estimates = self.pipeline.push(block)
        else:
            samples = self._tables.samples(block)
            self._rows += len(block)
            self._table_columns |= {*block.columns, *block.texts}
            estimates = self.pipeline.push_samples(samples, block.t_us)
        self._note(samples)
        if len(estimates):
            self._status = STATUS_LABELS[int(estimates.status[-1])]

    def report(self, log: LogReader | None = None) -> Report:
        """Return what was found in all blocks so far. log: where they came from, unless from a bus."""
        estimates = self.pipeline.finish()
        if len(estimates):
            self._status = STATUS_LABELS[int(estimates.status[-1])]
        model = LongitudinalModel(model_spec(self.config))
        needed, speeds = needed_roles(self.config, model), set(model.speed_roles)
        ratio = {role for way in model.ratio_ways for role in way}
        findings = []
        for role, source in self.config.signals.items():
            need = (
                "needed" if role in needed
                else "speed" if role in speeds
                else "ratio" if role in ratio
                else "optional"
            )  # fmt: skip
            findings.append(self._finding(role, source, need))
        order = {"needed": 0, "speed": 1, "ratio": 2, "optional": 3}
        findings.sort(key=lambda finding: order[finding.need])
        span = self._span_us or (0, 0)
        hints = self._hints(findings)  # compares what has come last, and the reason to stop may be in it
        if log is not None:
            hints += text_hints(self.config, getattr(log, "texts", {}))
        stops = ("" if log is None else wrong_kind(self.config, log)) or self._stops(model, findings)
        return Report(
            roles=findings,
            frames=self.frames,
            duration_s=(span[1] - span[0]) * 1e-6,
            samples=self.pipeline.samples,
            updated=self.pipeline.updated,
            gates=self.pipeline.gate_counts,
            status=self._status,
            stops=stops,
            hints=[hint for hint in hints if hint != stops],
            notes=([] if log is None else log_notes(log) + self._tables.notes())
            + stream_notes(self.pipeline.intake, self.pipeline.frozen),
        )

    def _frames(self, block: FrameBlock) -> Samples:
        self._bad_frames += int(np.count_nonzero(block.can_id & np.uint32(ERROR)))
        extended = (block.can_id & np.uint32(EXTENDED)) != 0
        self._standard_frames += int(np.count_nonzero(~extended))
        identifiers = np.unique(block.can_id[extended])
        self._addresses.update(np.unique(identifiers & np.uint32(0xFF)).tolist())
        groups = np.unique(identifiers >> np.uint32(8) << np.uint32(8))
        self._pgns.update(map(j1939.pgn_of, groups.tolist()))
        self._raw.push(block)
        heard = self._survey.push(block).samples
        self.plausibility.push({role: heard[role] for role in self._unasked if role in heard})
        return self._listening.push(block).samples

    def _note(self, samples: Samples) -> None:
        for role, (_, values) in samples.items():
            valid = values[np.isfinite(values)]
            self._missing_cells[role] = self._missing_cells.get(role, 0) + len(values) - len(valid)
            if len(valid):
                low, high, count = self._ranges.get(role, (np.inf, -np.inf, 0))
                self._ranges[role] = (
                    min(low, float(valid.min())),
                    max(high, float(valid.max())),
                    count + len(valid),
                )
        for comparison in self._comparisons:
            comparison.push(samples)

    def _finding(self, role: str, source: Source, need: str) -> Finding:
        known = ROLES.get(role)
        finding = Finding(
            role=role,
            text=known.text if known else "signal of an effect",
            need=need,
            expected=source.column or f"{source.message}.{source.signal}",
            source=source.source,
            unit=known.unit if known else "",
            from_table=source.column is not None,
        )
        if source.column is None:
            finding.senders = senders_of(self._survey.counters, role)
        elif source.column in self._table_columns:
            bad = self._missing_cells.get(role, 0)
            finding.senders = [Sender(None, self._row_rate(), self._rows, self._rows - bad, bad, 0, 0)]
        finding.labels = self._raw.labels(role) or self._tables.labels(role)
        low, high, count = self._ranges.get(role, (None, None, 0))
        finding.low, finding.high, finding.values = low, high, count
        # a mean rate over a silence tells nothing
        limit_s = math.inf if self.pipeline.clock.counters["gaps"] else stale_limit_s(role, source)
        finding.verdict, finding.hint = judge(finding, source, limit_s)
        return finding

    def _comes_from_others(self, role: str) -> bool:
        """Return whether a message that is matched by its exact identifier is there under others."""
        source = self.config.signals[role]
        if source.message is None or source.signal is None:
            return False
        message, _ = find_signal(self.config.databases, source.message, source.signal)
        return (
            message.is_extended_frame
            and not is_j1939(message)
            and j1939.pgn_of(message.frame_id) in self._pgns
        )

    def _row_rate(self) -> float | None:
        span = self._span_us or (0, 0)
        return (self._rows - 1) * 1e6 / (span[1] - span[0]) if span[1] > span[0] else None

    def _stops(self, model: LongitudinalModel, findings: list[Finding]) -> str:
        if not self.frames:
            return "nothing was received: the log is empty, or the bus is silent"
        found = {f.role: f for f in findings}

        def dead(role: str) -> str:
            finding = found[role]
            return "" if finding.values else f"{role} ({finding.text}) {complaint(finding)}"

        if lacking := what_lacks(self.config, model, dead):
            return lacking
        missing = self.pipeline.estimator.missing()
        if missing:
            return f"estimator {self.config.estimator.name} cannot work here: {missing}"
        if not self.pipeline.updated:
            backward = why_no_time(self.pipeline.clock)
            if backward or not self.pipeline.samples:
                return backward
            shares = gate_shares(self.pipeline.gate_counts, self.pipeline.samples)
            return f"every sample was refused by a gate: {shares}"
        return self.plausibility.missing_table() or why_hardly_open(self.pipeline, self._status)

    def _hints(self, findings: list[Finding]) -> list[str]:
        hints = [f"signals.{f.role}: {f.hint}" for f in findings if f.hint]
        if self.frames and not any(f.senders for f in findings):
            if self._standard_frames > self.frames / 2:
                hints.append("the bus speaks 11-bit identifiers: no J1939, a DBC of its own is needed")
            elif self._addresses:
                seen = ", ".join(f"0x{a:02X}" for a in sorted(self._addresses)[:12])
                hints.append(f"none of the config's messages is there; the bus has addresses {seen}")
        by_identifier = [f.expected for f in findings if not f.senders and self._comes_from_others(f.role)]
        if by_identifier:
            more = f" (and {len(by_identifier) - 1} more)" if len(by_identifier) > 1 else ""
            hints.append(
                f"{by_identifier[0]}{more} is matched by its whole identifier, and the bus has its parameter "
                f"group under others: to take it from them needs {SAYS_J1939}"
            )
        if self._bad_frames:
            hints.append(f"{self._bad_frames:,} error frames: check bit rate, termination and wiring")
        if self.frames:
            hints += unheard(self.config, self.pipeline.intake.heard)
        doubts = self.pipeline.estimator.doubts()
        hints += self._raw.hints() + [h for comparison in self._comparisons for h in comparison.hints()]
        return hints + ([doubts] if doubts else [])


def _unasked_reference(config: Config) -> dict[str, Source]:
    """Return where an engine would tell its reference torque (SPN 544) that the config does not ask for."""
    if "engine_torque_pct" not in config.signals or "reference_torque" in config.signals:
        return {}
    told = Source(message="EC1", signal="EngReferenceTorque")
    known = {m.name: m for database in config.databases for m in database.messages}.get("EC1")
    has = known is not None and is_j1939(known) and any(s.name == told.signal for s in known.signals)
    return {"reference_torque": told} if has else {}
