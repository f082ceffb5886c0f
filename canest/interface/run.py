"""Runs what the public functions ask for, and puts what came out into the public classes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from canest.config.database_files import read_databases
from canest.config.schema import Config
from canest.core import jit
from canest.core.errors import UsageError
from canest.core.estimates import Estimates
from canest.core.masses import LEAST_MASS_KG
from canest.core.samples import EstimateBlock, ModelBlock
from canest.interface.comparison import Comparison
from canest.interface.diagnosis import Diagnosis
from canest.interface.estimates import Replay, columns_of, estimates_of
from canest.interface.inputs import LogFile, log_of, require_number
from canest.interface.outputs import output_of
from canest.interface.signals import Signals
from canest.logs.truth import read_truth
from canest.offline.replay import compiling_pays, replay
from canest.offline.scoring import Reference


class _Collector:
    """Keeps every estimate of a replay."""

    def __init__(self) -> None:
        self.parts: list[Estimates] = []

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        e = estimates
        self.parts.append(
            Estimates(samples.t_us, e.mass_kg, e.mass_std_kg, e.grade, e.grade_std, e.status, samples.gate)
        )


def replayed(
    log: LogFile,
    config: Config,
    truth: Any,
    mass_kg: float | None,
    after_s: float,
    channel: str | None,
    output: str | Path | None,
    given: Any = None,
) -> Replay:
    """Replay a log and keep what was estimated. given: what the config of a table was made from."""
    collector = _Collector()
    result = replay(
        log,
        config,
        output=output_of(output, log, truth, config, given) if output is not None else None,
        reference=_reference(truth, mass_kg, after_s),
        listener=collector,
        channel=channel,
    )
    estimates = Estimates.concatenate(collector.parts)
    collector.parts.clear()
    return Replay(**columns_of(estimates), summary=result.summary, config=config)


def compared(
    log: LogFile,
    config: Config,
    truth: Any,
    mass_kg: float | None,
    names: Sequence[str] | None,
    after_s: float,
    channel: str | None,
) -> Comparison:
    """Run many estimators on one log."""
    from canest.estimators.registry import require_known
    from canest.offline.compare import compare

    if isinstance(names, str) or (names is not None and not isinstance(names, Iterable)):
        raise UsageError("no list", where="estimators", found=names, expected="a list of names")
    if names is not None and not names:
        raise UsageError(
            "no estimators", where="estimators", found=names, expected="a list of names, or None"
        )
    for name in names or ():
        if not isinstance(name, str):
            raise UsageError(
                "no name", where="estimators", found=getattr(name, "__name__", name),
                expected="the name of an estimator; docs/extending.md gives a class of your own one",
            )  # fmt: skip
        require_known(name, where="estimators")
    reference = _reference(truth, mass_kg, after_s)
    found = compare(config, log, reference=reference, names=names, channel=channel)
    estimates = {name: estimates_of(e) for name, e in found.estimates.items()}
    return Comparison(found.table, estimates, found.true_mass_kg, found.true_grade, found.speed_mps)


def diagnosed(
    logs: Sequence[LogFile],
    config: Config,
    truths: Sequence[Any],
    mass_kg: float | None,
    channel: str | None,
    passes: int,
) -> Diagnosis:
    """Diagnose logs of one vehicle together. Errors: LogError where one cannot be read."""
    from canest.diagnosis.entries import entries
    from canest.diagnosis.outcome import document
    from canest.diagnosis.report.revised_config import revised_config
    from canest.diagnosis.run import diagnose

    if mass_kg is not None:
        require_number("mass_kg", mass_kg, LEAST_MASS_KG, "kg ")
    paths = [Path(log) if isinstance(log, str) else log for log in logs]
    files = [log_of(truth, "truth") if truth is not None else None for truth in truths]
    jit.enable(compiling_pays(paths, passes))
    found = diagnose(
        paths,
        config,
        truths=[Path(file) if isinstance(file, str) else file for file in files],
        mass_kg=mass_kg,
        channel=channel,
    )
    revised = read_databases(revised_config(found))
    return Diagnosis(
        found.finding,
        found.verdict,
        revised.effects[len(found.config.effects) :],
        document(found, entries(found), [str(path) for path in paths], config.file),
        revised,
        tuple(map(estimates_of, found.estimates_before)),
        tuple(map(estimates_of, found.estimates_after)),
    )


def signals_of(log: LogFile, config: Config, channel: str | None) -> Signals:
    """Decode a log."""
    from canest.offline.signals import read_signals

    t_us, values = read_signals(log, config, channel)
    return Signals(t_us / 1e6, values)


def _reference(truth: Any, mass_kg: float | None, after_s: float) -> Reference:
    """Return what estimates are compared with. Errors: UsageError for what is no mass or time, LogError."""
    if mass_kg is not None:
        require_number("mass_kg", mass_kg, LEAST_MASS_KG, "kg ")
    require_number("after_s", after_s, 0.0)
    return Reference(read_truth(log_of(truth, "truth")) if truth is not None else None, mass_kg, after_s)
