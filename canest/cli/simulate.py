"""`canest simulate`: a log with known truth."""

from __future__ import annotations

import click

EPILOG = """\b
Examples:
  canest simulate --list                          the scenarios that ship
  canest simulate pulse-21t -o drives/            pulse-21t.log, .truth.csv and .yaml
  canest simulate my-scenario.yaml -o drives/ --seed 7 --compress
  canest replay drives/pulse-21t.log -c drives/pulse-21t.yaml --truth auto

The simulator shares no equation with the estimator. NAME.yaml is the config that an engineer would know:
what a scenario lists under `undeclared:` is in the drive and not in the config. For one of your own copy
a file of canest/simulation/scenarios/; a mistake in it is reported with its line and key.

Files of an earlier simulation are overwritten; those that somebody edited since then are not, without
--force. NAME.yaml begins with the checksums of all three.
"""


@click.command(epilog=EPILOG)
@click.argument("scenario", required=False, metavar="SCENARIO")
@click.option("-o", "--output", metavar="DIR", help="Where NAME.log, NAME.truth.csv and NAME.yaml go.")
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Another drive of the same kind.")
@click.option("--compress", is_flag=True, help="Write NAME.log.xz instead of NAME.log.")
@click.option("--force", is_flag=True, help="Overwrite files that were edited, or made by something else.")
@click.option("--list", "listing", is_flag=True, help="List the shipped scenarios.")
def command(
    scenario: str | None, output: str | None, seed: int | None, compress: bool, force: bool, listing: bool
) -> int:
    """Make a log with known truth from a scenario (a file, or the name of a shipped one)."""
    if listing:
        from canest.simulation.reading import load_scenario, shipped_scenarios

        for name in shipped_scenarios():
            spec = load_scenario(name)
            print(f"{name:<26} {spec.duration_s:5.0f} s  {spec.title}")
        return 0
    if scenario is None or output is None:
        raise click.UsageError("give a SCENARIO and -o DIR, or --list", click.get_current_context())
    from canest.cli.progress import Share
    from canest.simulation.files import drive_paths
    from canest.simulation.reading import name_of, scenario_file
    from canest.simulation.run import simulate_to_directory
    from canest.system.output_conflicts import keep_apart

    files = drive_paths(name_of(scenario), output, compress)
    keep_apart([("the scenario", scenario_file(scenario))], [("-o", path) for path in files])
    with Share(f"simulating {scenario}") as share:
        paths = simulate_to_directory(
            scenario, output, share.update, seed=seed, compress=compress, force=force
        )
    for path in paths:
        print(f"written {path}")
    return 0
