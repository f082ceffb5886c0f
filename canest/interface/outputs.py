"""The file that a caller wants estimates in: never one that they were made from."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

from canest.config.database_files import config_files
from canest.config.schema import Config
from canest.core.errors import UsageError
from canest.logs.estimate_writer import FRAME_ENDINGS, refuse_other_formats
from canest.offline.replay import Output
from canest.system.output_conflicts import keep_apart


def output_of(path: str | Path, log: Any, truth: Any, config: Config, given: Any) -> Output:
    """Return the file for estimates of a log, in the format that its name ends with.

    log, truth: as the caller gave them. config: in use. given: the one that it was made from, if another.
    Errors: UsageError for what is no path, a file that is one of them, or of no format of estimates.
    """
    if not isinstance(path, str | os.PathLike) or not os.fspath(path):
        raise UsageError("output: no path", found=path if path else "nothing", expected='e.g. "est.csv"')
    path = Path(path)
    inputs = config_files(config) + (config_files(given) if isinstance(given, Config) else [])
    inputs += [
        (f"the {what} {file}", file)
        for what, file in (("log", log), ("truth", truth))
        if isinstance(file, str | Path)
    ]
    keep_apart(inputs, [("output", path)])
    refuse_other_formats(path, "output")
    if not path.name.lower().endswith(FRAME_ENDINGS):
        return Output(path)
    from canest.node.broadcast_log import open_broadcast_log  # wanted for logs of frames alone

    return Output(path, opened=partial(open_broadcast_log, config.broadcast, None))
