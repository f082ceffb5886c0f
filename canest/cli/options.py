"""Options that several commands share, so that they look and mean the same everywhere."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click

from canest.core.masses import LEAST_MASS_KG

if TYPE_CHECKING:
    from canest.config.schema import Config
    from canest.logs.budget import LogBudget

F = TypeVar("F", bound=Callable[..., Any])

CONFIG_HELP = "Config file, or the name of a shipped one (class8, kenworth, bmw-i3, ...)."


class Number(click.FloatRange):
    """A finite number from ``least`` to ``most``. unit: for the message, where it is easily mistaken."""

    def __init__(self, least: float, most: float | None = None, unit: str = "") -> None:
        super().__init__(least, most)
        end = "on" if most is None else f"to {most:g}"
        self._expected = f"a number from {least:g} {unit and unit + ' '}{end}"
        self._least, self._most = least, math.inf if most is None else most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; anything else is a usage error."""
        number: float = click.FLOAT.convert(value, param, ctx)
        if not (self._least <= number <= self._most and math.isfinite(number)):
            self.fail(f"found {number:g}, expected {self._expected}.", param, ctx)
        return number


MASS = Number(LEAST_MASS_KG, unit="kg")


# named tuples: `dataclasses` would be a tenth of what the help of a command costs
class ConfigChoice(NamedTuple):
    """A config, and what this call changes in it: -c, --set, --estimator, --initial-mass."""

    config_name: str | None
    overrides: tuple[str, ...] = ()
    estimator: str | None = None
    initial_mass: float | None = None

    @property
    def name(self) -> str:
        """The config's name. Errors: a usage error without -c."""
        if self.config_name is None:
            raise click.UsageError("missing option -c CONFIG", click.get_current_context())
        return self.config_name

    def load(self, *more: str, databases: bool = True) -> Config:
        """Load the config; ``more``: overrides that come last. Errors: ConfigError, a usage error.

        databases: read the DBC files too.
        """
        overrides = (*self.overrides, *more)
        return load(self.name, overrides, self.estimator, self.initial_mass, databases=databases)


class TruthChoice(NamedTuple):
    """What the estimates are compared with: --truth, --mass, --after."""

    truth: str | None
    mass_kg: float | None
    after_s: float


class Outputs(NamedTuple):
    """What is written: -o, --json, --report."""

    output: str | None
    json_path: str | None
    report: str | None
    columns: str | None = None
    with_frames: bool = False


def grouped(**groups: Any) -> Callable[[F], F]:
    """Hand a command some of its options as named tuples: name of the argument -> type.

    An option belongs to the type that has a field of its name. Stands below the options.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def command(**options: Any) -> Any:
            made = {
                name: group(**{field: options.pop(field) for field in group._fields})
                for name, group in groups.items()
            }
            return function(**options, **made)

        return command  # type: ignore[return-value]

    return decorate


def config_option(required: bool = True) -> Callable[[F], F]:
    """Return the -c/--config option."""
    return click.option(
        "-c", "--config", "config_name", required=required, metavar="CONFIG", help=CONFIG_HELP
    )


def started_with_option(function: F) -> F:
    """Add --set of a command that looks for a daemon."""
    return click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE",
        help="Override a config key, as the daemon was started with.",
    )(function)  # fmt: skip


def override_options(function: F) -> F:
    """Add the options that change a config for one call."""
    for option in (
        click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a config key, "
                     "e.g. --set filter.cutoff_hz=1.5; may be repeated."),
        click.option("--initial-mass", type=float, metavar="KG", help="Start value of the mass."),
        click.option("--estimator", metavar="NAME", help="Estimator to use instead of the config's."),
    ):  # fmt: skip
        function = option(function)
    return function


class _Budget(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """time=SECONDS,unpacked=TIMES,memory=MB: some of them or all, or none for no limit."""

    name = "budget"
    _KEYS = {"time": "time_s", "unpacked": "unpacked", "memory": "memory_mb"}  # noqa: RUF012

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> LogBudget:
        """Return the budget; anything else is a usage error."""
        from canest.logs.budget import NO_BUDGET, LogBudget

        if isinstance(value, LogBudget):
            return value
        if value == "none":
            return NO_BUDGET
        limits: dict[str, float] = {}
        for part in value.split(","):
            key, _, number = part.strip().partition("=")
            if key not in self._KEYS:
                self.fail(
                    f"found {part.strip()!r}, expected time=SECONDS, unpacked=TIMES or memory=MB.", param, ctx
                )
            try:
                limit = math.inf if number == "none" else float(number)
            except ValueError:
                limit = math.nan
            if not limit > 0:
                self.fail(f"{key}: found {number!r}, expected a number above 0 or none.", param, ctx)
            limits[self._KEYS[key]] = limit
        return LogBudget(**limits)


def log_budget_option(function: F) -> F:
    """Add the option that bounds what reading one log may cost, for every log that the command opens."""

    def enter(ctx: click.Context, param: click.Parameter, value: LogBudget | None) -> None:
        if value is not None:
            from canest.logs.budget import log_budget

            ctx.with_resource(log_budget(value))

    return click.option(
        "--log-budget", type=_Budget(), expose_value=False, callback=enter, metavar="LIMITS",
        help="What reading one log may cost: time=SECONDS of computing (default 60, and 60 more per 100 MB), "
             "unpacked=TIMES its size (200), memory=MB (2000); or none.",
    )(function)  # fmt: skip


def truth_options(function: F) -> F:
    """Add the options that give the right answer."""
    for option in (
        click.option("--after", "after_s", type=Number(0), default=60.0, show_default=True, metavar="S",
                     help="Count errors from this many seconds after the first sample on."),
        click.option("--mass", "mass_kg", type=MASS, metavar="KG", help="The true mass, if constant."),
        click.option("--truth", metavar="CSV", help="Table with t_s and grade or mass_kg or both; "
                     "'auto' takes NAME.truth.csv beside each log."),
    ):  # fmt: skip
        function = option(function)
    return function


def load(
    config_name: str,
    overrides: tuple[str, ...] = (),
    estimator: str | None = None,
    initial_mass: float | None = None,
    *,
    databases: bool = True,
) -> Config:
    """Load a config with what the command line changes in it. Errors: ConfigError.

    databases: read the DBC files too, which commands that decode nothing can do without.
    """
    from canest.config import load_config

    changed, options = changes(config_name, overrides, estimator, initial_mass)
    return load_config(config_name, changed, options, databases=databases)


def changes(
    config_name: str, overrides: tuple[str, ...], estimator: str | None, initial_mass: float | None
) -> tuple[list[str], dict[str, str]]:
    """Return all overrides of a config, and the keys among them that have an option of their own."""
    from canest.config import load_config

    changed, options = list(overrides), {}
    if estimator is not None:
        # the config's options belong to the config's estimator; --set still reaches the new one's
        if load_config(config_name, databases=False).estimator.name != estimator:
            changed.insert(0, "estimator.options={}")
        changed.append(f"estimator.name={estimator}")
        options["estimator.name"] = "--estimator"
    if initial_mass is not None:
        changed.append(f"estimator.initial_mass_kg={initial_mass!r}")
        options["estimator.initial_mass_kg"] = "--initial-mass"
    return changed, options
