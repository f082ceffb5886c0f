"""canest: vehicle mass and road grade from the CAN bus, at 50 Hz, live or from logs.

The public names are those of `__all__` (docs/api.md); each is imported when it is first used. Type checkers
read them from `__init__.pyi`.
"""

__version__ = "0.1.0"

__all__ = [
    "BusError",
    "CanestError",
    "Comparison",
    "Config",
    "ConfigError",
    "Diagnosis",
    "Estimates",
    "FrameBlock",
    "Gate",
    "LogError",
    "OutputError",
    "Pipeline",
    "Replay",
    "Signals",
    "SimulatedDrive",
    "Status",
    "UsageError",
    "Vehicle",
    "compare",
    "demo_drive",
    "diagnose",
    "estimate",
    "estimators",
    "load_config",
    "read_signals",
    "replay",
    "simulate",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'canest' has no attribute {name!r}")
    from importlib import import_module  # not for `import canest`

    if name == "estimators":
        return import_module("canest.estimators")
    value = getattr(import_module("canest.api"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
