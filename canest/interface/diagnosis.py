"""What a diagnosis found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from canest.interface.estimates import Estimates, pandas

if TYPE_CHECKING:
    import pandas as pd

    from canest.config import Config


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What the vehicle model lacks in measured data.

    Attributes:
        finding: one sentence.
        verdict: "explained", "partly", "unexplained" or "nothing-to-explain".
        effects: the effects that were added, as entries of a config's `effects`.
        document: the content of diagnosis.json: every effect tried with value, standard deviation and share,
            the errors before ("baseline") and after.
        config: the config with what was found, for another drive.
        before, after: `Estimates` of each drive without and with it.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> found = canest.diagnose(drive, drive.config, truth=drive.truth)
        >>> found.document["after"]["residual_rms_N"] <= found.document["baseline"]["residual_rms_N"]
        True
    """

    finding: str
    verdict: str
    effects: tuple[Mapping[str, Any], ...]
    document: Mapping[str, Any] = field(repr=False)
    config: Config = field(repr=False)
    before: tuple[Estimates, ...] = field(repr=False)
    after: tuple[Estimates, ...] = field(repr=False)

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas table: a row per effect tried, best first. Errors: UsageError.

        Columns: effect, parameters, settings, score, explained (shares of the held-out residual variance),
        equivalent (effects that this data cannot separate from it), selected.
        """
        return pandas().DataFrame(self.document["candidates"])
