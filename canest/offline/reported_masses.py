"""The masses that other controllers report (SPN 1760, a maker's own), against ours and a ticket."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core.frames import FloatColumn, FrameBlock, IntColumn, MonotonicClock
from canest.decode.per_sender import PerSender
from canest.doctor.differing_masses import ROLE, differing
from canest.offline.leg import Leg
from canest.pipeline.signal_map import wants_of

if TYPE_CHECKING:
    from canest.config import Config

#: of a sender's values one in so long is kept
_EVERY_US = 1_000_000
#: our standard deviations within which a sender agrees
_WITHIN = 2.0


@dataclass(frozen=True, slots=True)
class ReportedMass:
    """What one controller reported over a log.

    sender: its address (0x0B), or the column or message. values: masses above 0 kg. mass_kg: the last.
    difference_pct: from ours, mean over the load legs (positive: it reports more). agrees: within two of our
        standard deviations on every load leg. error_pct: from the truth, likewise. None: nothing to compare.
    """

    sender: str
    values: int
    mass_kg: float
    difference_pct: float | None = None
    agrees: bool | None = None
    error_pct: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return all fields by name, as JSON types, numbers to three decimals."""
        return {name: round(v, 3) if isinstance(v, float) else v for name, v in asdict(self).items()}


class ReportedMasses:
    """Keeps what every sender reports while a log streams by, a value a second. Errors: ConfigError."""

    def __init__(self, config: Config) -> None:
        self._source = source = config.signals.get(ROLE)
        self._frames = None
        if source is not None and source.message is not None:
            wants = wants_of(config.model_copy(update={"signals": {ROLE: source}}))
            self._frames = PerSender(wants, config.databases)
        self._monotonic = MonotonicClock(round(config.sampling.max_backward_s * 1e6))
        self._kept: dict[str, tuple[list[int], list[float]]] = {}
        self._counts: dict[str, int] = {}

    def push(self, block: FrameBlock) -> None:
        """Take the next frames."""
        if self._frames is None or self._source is None:
            return
        passed = FrameBlock(self._monotonic(block.t_us), block.can_id, block.length, block.data)
        for address, samples in self._frames.push(passed).items():
            name = str(self._source.message) if address is None else f"0x{address:02X}"
            if ROLE in samples:
                self._keep(name, *samples[ROLE])

    def push_samples(self, samples: Mapping[str, tuple[IntColumn, FloatColumn]]) -> None:
        """Take the next samples of a table: role -> stamps and values."""
        if ROLE in samples and self._source is not None:
            t_us, values = samples[ROLE]
            self._keep(str(self._source.column), self._monotonic(t_us), values)

    def compared(self, legs: Sequence[Leg]) -> tuple[list[ReportedMass], list[Leg]]:
        """Return every sender compared with the legs, and the legs with what each sender reported there."""
        with_reports = [replace(leg, reported_kg=self._within(leg)) for leg in legs]
        loads = [leg for leg in with_reports if leg.is_valid]
        found = []
        for name, (_, values) in sorted(self._kept.items()):
            ours = [leg for leg in loads if name in leg.reported_kg]
            found.append(
                ReportedMass(
                    name,
                    self._counts[name],
                    values[-1],
                    _mean_pct([(leg.reported_kg[name], leg.mass_kg) for leg in ours]),
                    all(_is_within(leg, leg.reported_kg[name]) for leg in ours) if ours else None,
                    _mean_pct(
                        [
                            (leg.reported_kg[name], leg.true_mass_kg)
                            for leg in with_reports
                            if name in leg.reported_kg
                        ]
                    ),
                )
            )
        return found, with_reports

    def _keep(self, name: str, t_us: IntColumn, values: FloatColumn) -> None:
        known = np.isfinite(values) & (values > 0.0)  # some senders send 0 kg while they stand
        if not known.any():
            return
        stamps, masses = self._kept.setdefault(name, ([], []))
        self._counts[name] = self._counts.get(name, 0) + int(np.count_nonzero(known))
        for stamp, mass_kg in zip(t_us[known].tolist(), values[known].tolist(), strict=True):
            if not stamps or not 0 <= stamp - stamps[-1] < _EVERY_US:
                stamps.append(stamp)
                masses.append(mass_kg)
            else:
                masses[-1] = mass_kg

    def _within(self, leg: Leg) -> dict[str, float]:
        """Return the median mass of each sender while a leg lasted."""
        first_us, last_us = leg.passed_us
        found = {}
        for name, (stamps, masses) in sorted(self._kept.items()):
            inside = [m for t, m in zip(stamps, masses, strict=True) if first_us <= t <= last_us]
            if inside:
                found[name] = round(float(np.median(inside)), 3)
        return found


def report_lines(reported: Sequence[Mapping[str, Any]], legs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the reports as sentences: each sender, senders that differ, and who is nearest to the truth.

    reported, legs: as summary.json has them.
    """
    lines = []
    for mass in reported:
        text = f"{mass['sender']}: {mass['mass_kg']:,.0f} kg"
        if mass["difference_pct"] is not None:
            agrees = "agrees with ours within 2 std" if mass["agrees"] else "does not agree with ours"
            text += f", {mass['difference_pct']:+.1f} % of ours ({agrees})"
        if mass["error_pct"] is not None:
            text += f", {mass['error_pct']:+.1f} % of the truth"
        lines.append(text)
    lines += differing({mass["sender"]: mass["mass_kg"] for mass in reported})
    errors = {mass["sender"]: mass["error_pct"] for mass in reported if mass["error_pct"] is not None}
    own = [
        leg["mass_error_pct"] for leg in legs if leg["load"] is not None and leg["mass_error_pct"] is not None
    ]
    if errors and own:
        errors["ours"] = math.fsum(own) / len(own)
        nearest = min(errors, key=lambda name: abs(errors[name]))
        others = ", ".join(f"{name} {pct:+.1f} %" for name, pct in errors.items() if name != nearest)
        lines.append(f"nearest to the truth is {nearest}, {errors[nearest]:+.1f} % (others: {others})")
    return lines


def _mean_pct(pairs: Sequence[tuple[float, float | None]]) -> float | None:
    shares = [100.0 * (mass_kg / of_kg - 1.0) for mass_kg, of_kg in pairs if of_kg]
    return math.fsum(shares) / len(shares) if shares else None


def _is_within(leg: Leg, mass_kg: float) -> bool:
    assert leg.mass_kg is not None
    return abs(mass_kg - leg.mass_kg) <= _WITHIN * (leg.mass_std_kg or 0.0)
