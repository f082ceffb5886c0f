"""A bound of the mass that the driving contradicted for a while, though no longer at the end."""

from __future__ import annotations

_BOUND = "vehicle.mass_m"  #: how the keys of both bounds begin


class PastContradiction:
    """Remembers the last one. An estimator tells only what contradicts the facts now."""

    def __init__(self) -> None:
        self._sentence = ""

    def note(self, sentences: str) -> None:
        """Take what an estimator says after a block (`Estimator.contradiction`)."""
        for sentence in sentences.split("; "):
            if _BOUND in sentence:
                self._sentence = sentence

    def notes(self, now: str) -> list[str]:
        """Return it in a sentence; [] for none, or where the estimator says it at the end as well."""
        return [f"at times {self._sentence}"] if self._sentence and _BOUND not in now else []
