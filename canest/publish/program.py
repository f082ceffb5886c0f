"""A publisher as a program: follows its source until a signal ends it."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from canest.publish.follower import Follower

Follow = Callable[[Follower], Awaitable[None]]


async def run(
    follower: Follower, follow: Follow, beside: Callable[[asyncio.Event], Coroutine[Any, Any, None]]
) -> None:
    """Follow until SIGTERM or SIGINT.

    beside: what the publisher does meanwhile, until the event it is given. Errors: those of both.
    """
    os.nice(5)  # the daemon goes first
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    own = asyncio.ensure_future(beside(stop))
    others = [asyncio.ensure_future(follow(follower)), asyncio.ensure_future(follower.check())]
    done, _ = await asyncio.wait([own, *others], return_when=asyncio.FIRST_COMPLETED)
    stop.set()
    for task in others:
        task.cancel()
    await own
    for task in done - {own}:
        task.result()  # these end by an error alone
