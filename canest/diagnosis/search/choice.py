"""What the search has found out about a candidate: chosen with others, or tried alone."""

from __future__ import annotations

from dataclasses import dataclass, field

from canest.diagnosis.search.candidates import Candidate
from canest.vehicle.effects import Effect


@dataclass
class Chosen:
    """A selected candidate with its fitted deviation from neutral and standard deviation.

    scatter: standard deviation by blocks of the drive, what is counted when it is chosen; std: with what the
    small errors of every vehicle add. explained: share of the first residual's held-out variance that comes
    back without it; shifts: of that variance averaged over seconds, which is what shifts mass and grade.
    needed: share of what is then left that it removes; force_N: RMS of the force it makes. equivalent:
    candidates that would do as well in its place.
    """

    candidate: Candidate
    deviation: float
    std: float = 0.0
    explained: float = 0.0
    needed: float = 0.0
    equivalent: list[Candidate] = field(default_factory=list)
    scatter: float = 0.0
    shifts: float = 0.0
    force_N: float = 0.0

    @property
    def value(self) -> float:
        """Return the fitted parameter's value."""
        return self.candidate.info.neutral + self.deviation

    def effect(self) -> Effect:
        """Build the effect at its fitted value."""
        return self.candidate.make(self.deviation)


@dataclass(frozen=True)
class Tried:
    """What one candidate alone would do: deviation, std, share of held-out variance removed."""

    candidate: Candidate
    deviation: float
    std: float
    explained: float
