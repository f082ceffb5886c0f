"""All estimators by name: those of canest, and those that other packages add."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from canest.core.errors import ConfigError
from canest.core.nearest_name import expected_name
from canest.core.plugins import usable_plugins
from canest.core.samples import VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.contract import make
from canest.estimators.description import Description

#: entry point group of other packages: an estimator's name = "module:Class"
GROUP = "canest.estimators"

_PAPERS = "canest.estimators.papers."
#: name -> where its class is, in the form of an entry point; a module is imported when it is wanted.
#: Everything else about an estimator is described at its class, and a test holds both together.
BUILT_IN: dict[str, str] = {
    "batch-ls": _PAPERS + "vahidi2005.batch:BatchLs",
    "rls": _PAPERS + "vahidi2005.rls:Rls",
    "rls-vector": _PAPERS + "vahidi2005.rls:RlsVector",
    "rlsmf": _PAPERS + "vahidi2005.rlsmf:Rlsmf",
    "rlsmf-n": _PAPERS + "vahidi2005.rlsmf:Rlsmf",
    "resistance4": _PAPERS + "rhode2013.resistance4:Resistance4",
    "tls": _PAPERS + "rhode2013.tls:Tls",
    "gtls": _PAPERS + "rhode2013.tls:Tls",
    "rtls": _PAPERS + "rhode2013.rtls:Rtls",
    "rgtls": _PAPERS + "rhode2013.rtls:Rtls",
    "ekf": _PAPERS + "kidambi2014.ekf:Ekf",
    "ekf-select": _PAPERS + "kidambi2014.ekf_select:EkfSelect",
    "dgo": _PAPERS + "kidambi2014.dgo:Dgo",
    "pmg": _PAPERS + "kidambi2014.pmg:Pmg",
    "canest": "canest.estimators.default.estimator:GaussianSum",
    "canest-0.1": "canest.estimators.canest_0_1.estimator:Canest",
}


def names() -> list[str]:
    """Return the name of every estimator, those of other packages last (reads the packages' metadata)."""
    return [*BUILT_IN, *_added()[0]]


def skipped() -> dict[str, str]:
    """Return the estimators of other packages that cannot be used: name -> why."""
    return _added()[1]


def describe(name: str) -> Description:
    """Return the metadata of an estimator. Errors: ConfigError for an unknown name."""
    found = _described(estimator_class(name), name)
    if found is None:
        raise ConfigError("estimator has no description", where="estimator.name", found=name)
    return found


def require_known(name: str, where: str = "estimator.name") -> None:
    """Refuse a name that no estimator has. Errors: ConfigError."""
    if name in BUILT_IN:
        return
    added, left_out = _added()
    if name in left_out:
        raise ConfigError(
            "estimator cannot be used", where=where, found=name, expected=f"a working one: {left_out[name]}"
        )
    if name not in added:
        expected = expected_name(name, [*BUILT_IN, *added], "an estimator")
        raise ConfigError("unknown estimator", where=where, found=name, expected=expected)


def estimator_class(name: str) -> type[Estimator]:
    """Return the class that serves a name. Errors: ConfigError for an unknown one."""
    require_known(name)
    if name not in BUILT_IN:
        return _added()[0][name]
    module, _, attribute = BUILT_IN[name].partition(":")
    found: type[Estimator] = getattr(import_module(module), attribute)
    return found


def create(name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> Estimator:
    """Build the estimator ``name``.

    Errors: ConfigError for an unknown name or option, PluginError for one of another package that fails.
    """
    return make(estimator_class(name), name, facts, options)


def _added() -> tuple[dict[str, type[Estimator]], dict[str, str]]:
    """Return the usable estimators of other packages, and why the rest is not."""
    return usable_plugins(GROUP, _unusable)


def _unusable(name: str, value: object) -> str:
    if name in BUILT_IN:
        return "canest has an estimator of this name"
    if not (isinstance(value, type) and issubclass(value, Estimator)):
        return f"its entry point gives {value!r}, not a subclass of canest.estimators.base.Estimator"
    if inspect.isabstract(value):
        return f"{value.__name__} does not define {', '.join(sorted(value.__abstractmethods__))}"
    if _described(value, name) is None:
        return f"{value.__name__}.descriptions has no entry of this name"
    return ""


def _described(estimator: type[Estimator], name: str) -> Description | None:
    return next((d for d in estimator.descriptions if d.name == name), None)
