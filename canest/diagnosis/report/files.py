"""Writes what a diagnosis found: diagnosis.json, revised.yaml, report.html."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from canest.config.schema import Config
from canest.core.errors import OutputError
from canest.diagnosis.data.problem import TooLittleDrivingError
from canest.diagnosis.entries import Entry, entries
from canest.diagnosis.outcome import document, empty_document
from canest.diagnosis.report.page import report_page
from canest.diagnosis.report.revised_config import revised_config, revised_text
from canest.diagnosis.run import Diagnosis
from canest.report.page import Page
from canest.system.result_files import write_results
from canest.system.shipped_files import find

JSON_NAME, CONFIG_NAME, REPORT_NAME = "diagnosis.json", "revised.yaml", "report.html"


@dataclass(frozen=True)
class Written:
    """What was written where; `found` as it stands in the JSON."""

    finding: str
    paths: list[Path]
    found: list[Entry] = field(default_factory=list)


def write(diagnosis: Diagnosis, config_name: str, logs: Sequence[str], directory: Path) -> Written:
    """Write all three files. config_name: what the diagnosis was called with. Errors: OutputError."""
    found = entries(diagnosis)
    _make(directory)
    config = revised_config(diagnosis)
    paths = _together(
        directory,
        document(diagnosis, found, logs, config_name),
        revised_text(diagnosis, config, _original(config_name), config_name),
        report_page(diagnosis, found, logs),
    )
    return Written(diagnosis.finding, paths, found)


def write_empty(
    error: TooLittleDrivingError, config: Config, config_name: str, logs: Sequence[str], directory: Path
) -> Written:
    """Write the three files of logs in which nothing could be measured: the config stays as it was."""
    finding = f"The model cannot be judged: {error.what}, {error.found}; `canest check` shows why."
    _make(directory)
    paths = _together(
        directory,
        empty_document(finding, logs, config, config_name, error.notes),
        f"# Nothing was added: {finding}\n" + _original(config_name),
        Page(title=" · ".join(Path(log).name for log in logs), headline=finding),
    )
    return Written(finding, paths)


def _original(config_name: str) -> str:
    return find("configs", config_name).read_text(encoding="utf-8")


def check_folder(directory: Path) -> None:
    """Refuse a folder that cannot be made, and make nothing. Errors: OutputError."""
    above = next(folder for folder in (directory, *directory.absolute().parents) if folder.exists())
    if not above.is_dir():
        raise OutputError(f"cannot make the directory: {above} is a file", where=str(directory))
    if not os.access(above, os.W_OK | os.X_OK):
        raise OutputError(f"cannot make the directory: {above} may not be written to", where=str(directory))


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the directory: {error.strerror}", where=str(directory)) from None


def _together(directory: Path, content: dict[str, Any], config: str, page: Page) -> list[Path]:
    """Write all three files, or none."""
    report = directory / REPORT_NAME
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    contents = {
        directory / JSON_NAME: text,
        directory / CONFIG_NAME: config,
        report: page.render(str(report)),
    }
    write_results(contents)
    return list(contents)
