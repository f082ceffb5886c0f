"""`python -m canest` is the same as the `canest` command."""

from canest.cli.main import main

if __name__ == "__main__":
    main()
