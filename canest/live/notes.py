"""What on the bus contradicts the config, as `canest check` and a replay say it, while the daemon runs."""

from __future__ import annotations

import re

from canest.config.schema import Config
from canest.core.samples import EstimateBlock, ModelBlock
from canest.doctor.facts import FactsCheck
from canest.doctor.mass_jump import MassJump
from canest.doctor.stretches import Samples, Stretches
from canest.system.journal import Journal

#: seconds of samples that are compared in one go, and between two looks at what was found; both take some ms
COMPARE_S, LOOK_S = 10.0, 60.0
#: samples that wait at most: a table of stamps that stand still has no end
_MOST_WAITING = 1 << 17

_NUMBER = re.compile(r"\d[\d.,]*")


class Notes:
    """Takes the decoded samples of the bus; memory does not grow with time.

    found: one sentence each, with the numbers of now. logged: the same as one text for the journal; it stays
    as it is while nothing but numbers differ.
    """

    def __init__(self, config: Config, journal: Journal) -> None:
        self._config, self._journal = config, journal
        self._gathered = Stretches(config.signals)
        self._compare_at_s = self._look_at_s = 0.0
        self._kinds: list[str] = []
        self.found: list[str] = []
        self.logged = ""
        self._check, self._jump = FactsCheck(config), MassJump()

    def push(self, samples: Samples) -> None:
        """Take the samples of a block: role -> t_us, values (n,)."""
        if self._gathered.waiting < _MOST_WAITING:
            self._gathered.add(samples)

    def listen(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take model samples with their estimates."""
        self._jump(samples, estimates)

    def update(self, now_s: float) -> None:
        """Compare what has come, when that is due; call it once a second. A defect in a check is survived."""
        if now_s < self._compare_at_s:
            return
        self._compare_at_s = now_s + COMPARE_S
        self._look_at_s = self._look_at_s or now_s + LOOK_S
        try:
            self._check.push(self._gathered.rest())
            if now_s >= self._look_at_s:
                self._look_at_s = now_s + LOOK_S
                self._look()
        except Exception as error:  # a defect of ours: the estimates do not depend on it
            self._journal.error("notes-failed", error=f"{type(error).__name__}: {error}")
            self._check = FactsCheck(self._config)

    def _look(self) -> None:
        self.found = [*self._check.hints(), *([self._jump.found] if self._jump.found else [])]
        kinds = [_NUMBER.sub("#", note) for note in self.found]
        if kinds != self._kinds:
            self._kinds, self.logged = kinds, "; ".join(self.found)
