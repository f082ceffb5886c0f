"""From SOURCE and manifest to jobs; what fits no rule is listed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from canest.core.errors import CanestError
from canest.fleet.bundle import Bundle, bundle_of
from canest.fleet.job import FleetJob, Outcome
from canest.fleet.lake import Lake
from canest.fleet.manifest import Manifest
from canest.fleet.source import Listing


@dataclass(slots=True)
class Plan:
    """What is to be done. bundles: digest -> config. unmatched: logs that no rule fits."""

    jobs: list[FleetJob] = field(default_factory=list)
    bundles: dict[str, Bundle] = field(default_factory=dict)
    unmatched: list[Outcome] = field(default_factory=list)


def bundles_of_rules(manifest: Manifest) -> dict[str, Bundle]:
    """Return the configs of a manifest, by the names that its rules have for them.

    Errors: ConfigError for a config that is wrong, with its line in the manifest.
    """
    found: dict[str, Bundle] = {}
    for rule in manifest.rules:
        if rule.config not in found:
            try:
                found[rule.config] = bundle_of(rule.config)
            except CanestError as error:
                if not rule.where:
                    raise
                raise type(error)(f"{rule.where}: {error}") from error
    return found


def make_plan(
    listing: Listing,
    manifest: Manifest,
    configs: Mapping[str, Bundle],
    lake: Lake,
    *,
    resume: bool,
    with_samples: bool,
) -> Plan:
    """Return the jobs of all logs.

    configs: of the rules. resume: what the lake has need not be made again; with_samples: if it has samples.
    """
    plan = Plan(bundles={bundle.digest: bundle for bundle in configs.values()})
    for log in listing.logs:
        rules = manifest.rules_for(log.name)
        if not rules:
            plan.unmatched.append(Outcome(log.name, unmatched="no rule of the manifest fits its path"))
            continue
        keys = lake.keys(log.name, with_samples=with_samples) if resume else frozenset()
        old = lake.vehicles(log.name)
        digests = tuple((rule, configs[rule.config].digest) for rule in rules)
        plan.jobs.append(FleetJob(log, digests, keys, old))
    return plan
