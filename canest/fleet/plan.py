"""From SOURCE and manifest to jobs; what fits no rule is listed."""

from __future__ import annotations

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


def make_plan(listing: Listing, manifest: Manifest, lake: Lake, resume: bool) -> Plan:
    """Return the jobs of all logs. Errors: ConfigError for a config of the manifest, with its line."""
    plan = Plan()
    digests: dict[str, str] = {}
    for rule in manifest.rules:
        if rule.config not in digests:
            try:
                bundle = bundle_of(rule.config)
            except CanestError as error:
                if not rule.where:
                    raise
                raise type(error)(f"{rule.where}: {error}") from error
            plan.bundles[bundle.digest] = bundle
            digests[rule.config] = bundle.digest
    for log in listing.logs:
        rules = manifest.rules_for(log.name)
        if not rules:
            plan.unmatched.append(Outcome(log.name, unmatched="no rule of the manifest fits its path"))
            continue
        keys = lake.keys(log.name) if resume else frozenset()
        plan.jobs.append(FleetJob(log, tuple((rule, digests[rule.config]) for rule in rules), keys))
    return plan
