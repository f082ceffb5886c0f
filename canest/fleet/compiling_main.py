"""The process that compiles the kernels: it replays the bundled drive with each estimator, and ends.

Takes a pickle of estimator -> options on stdin. Its argument is the file for the record of what numba keeps.
"""

from __future__ import annotations

import json
import pickle
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from canest.config import load_config
from canest.core import jit
from canest.core.errors import CanestError
from canest.offline.log_run import LogRun

#: three minutes of driving as candump text; its config is `class8`
_DRIVE = Path(__file__).parents[1] / "demo" / "drive.log.xz"


def main() -> None:
    """Compile, and write the record where numba has kept everything."""
    options: dict[str, dict[str, Any]] = pickle.load(sys.stdin.buffer)
    if not jit.enable():
        return
    config = load_config("class8")
    for name, own in options.items():
        estimator = config.estimator.model_copy(update={"name": name, "options": own})
        with suppress(CanestError):  # an estimator that needs what this drive lacks
            run = LogRun(_DRIVE, config.model_copy(update={"estimator": estimator}))
            with closing(run.reader):
                for _ in run.estimates():
                    pass
    files = jit.kept_files()
    if all(Path(file).exists() for file in files):
        record = Path(sys.argv[1])
        new = record.with_suffix(".new")
        new.write_text(json.dumps(files), encoding="utf-8")
        new.replace(record)


if __name__ == "__main__":
    main()
