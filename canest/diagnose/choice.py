"""What the search has found out about a candidate: chosen with others, or tried alone."""

from __future__ import annotations

from dataclasses import dataclass, field

from canest.diagnose.candidates import Candidate
from canest.vehicle.effects import Effect


@dataclass
class Chosen:
    """A selected candidate with its fitted deviation from neutral and standard deviation.

    explained: share of the first residual's held-out variance that comes back without it. needed: share
    of what is then left that it removes. equivalent: candidates that would do as well in its place.
    """

    candidate: Candidate
    deviation: float
    std: float = 0.0
    explained: float = 0.0
    needed: float = 0.0
    equivalent: list[Candidate] = field(default_factory=list)

    def sigmas(self) -> float:
        """Return how many standard deviations it is from neutral; 0 at a bound, where nothing is fitted."""
        info = self.candidate.info
        value = info.neutral + self.deviation
        inside = info.low < value < info.high
        return abs(self.deviation) / max(self.std, 1e-30) if inside else 0.0

    def effect(self) -> Effect:
        """Build the effect at its fitted value."""
        return self.candidate.make(self.deviation)


@dataclass(frozen=True)
class Tried:
    """What one candidate alone would do: deviation, std, share of held-out variance removed.

    explained: as that of `Chosen`, of what lasts for seconds; removed: of every window.
    """

    candidate: Candidate
    deviation: float
    std: float
    explained: float
    removed: float
