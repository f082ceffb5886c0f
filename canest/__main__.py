"""The `canest` command, which `python -m canest` is as well."""

import sys


def main() -> None:
    """Import the command line and run it. An interrupt while it is imported is one like any other."""
    try:
        from canest.cli.main import main as command
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(1)
    command()


if __name__ == "__main__":
    main()
