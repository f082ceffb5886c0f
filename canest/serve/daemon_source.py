"""Follows a daemon's live stream (`canest.telemetry.live_protocol`), and connects again when it ends."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from pathlib import Path

from canest.serve.watcher import Watcher

RETRY_S = 0.5
_LONGEST_LINE = 1 << 20  #: bytes; a status has some 10,000


async def follow_daemon(locate: Callable[[], Path], watcher: Watcher) -> None:
    """Hand every message to the watcher, for ever.

    locate: returns the stream's socket; asked before every attempt, since a daemon may come and go.
    """
    while True:
        watcher.lose(await _follow_once(locate(), watcher))
        await asyncio.sleep(RETRY_S)


async def _follow_once(path: Path, watcher: Watcher) -> str:
    """Return why a connection ended, or could not be made."""
    try:
        reader, writer = await asyncio.open_unix_connection(path, limit=_LONGEST_LINE)
    except FileNotFoundError:
        return f"no daemon is running ({path}: no such socket; canest status shows those that run)"
    except ConnectionRefusedError:
        return f"no daemon is running any more ({path})"
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    try:
        while line := await reader.readline():
            message = json.loads(line)
            if "refused" in message:
                return f"the daemon refused: {message['refused']}"
            watcher.take(message)
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"{path}: {error}"
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()
    return "the daemon has ended"
