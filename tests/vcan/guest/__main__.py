"""``python -m guest [--systemd] [--timeout S] -- COMMAND…``: run a command in a guest, its output here."""

from __future__ import annotations

import argparse
import sys

from guest.machine import Guest, GuestError


def main() -> int:
    parser = argparse.ArgumentParser(prog="guest", description="Run a command where vcan0 is real.")
    parser.add_argument("--systemd", action="store_true", help="with systemd as process 1")
    parser.add_argument("--timeout", type=float, default=300, metavar="S", help="from the boot, default 300")
    parser.add_argument("command", nargs="+", metavar="COMMAND")
    arguments = parser.parse_args()
    try:
        with Guest(arguments.command, init="systemd" if arguments.systemd else "shell") as guest:
            shown = 0
            for _ in guest.follow(arguments.timeout):
                text = guest.output()
                print(text[shown:], end="", flush=True)
                shown = len(text)
            result = guest.result()
            print(result.output[shown:], end="", flush=True)
            return result.status
    except GuestError as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
