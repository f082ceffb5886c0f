"""What every key of a config means, in one line: for docs/config.md and for the JSON Schema of editors."""

from __future__ import annotations

from canest.estimators.registry import BUILT_IN

ACCURACY = "two standard deviations, %; default: "
RECOVERY = "stays closed this long after its cause has cleared, s"
ENABLED = "false: this gate never closes"
RELATIVE = "a relative path is below {} of systemd, else below the daemon's working directory"
IN_STATE, IN_RUNTIME = RELATIVE.format("$STATE_DIRECTORY"), RELATIVE.format("$RUNTIME_DIRECTORY")

MEANINGS: dict[str, str] = {
    "road_map": "grade that earlier drives found, a file of `canest map build`; needs a position on the bus",
    "vehicle.name": "a name for people",
    "vehicle.key": "what a learned mass belongs to: VIN or fleet number; empty: the name",
    "vehicle.mass_min_kg": "lightest the vehicle can be, kg; bounds every estimate",
    "vehicle.mass_max_kg": "heaviest the vehicle can be, kg",
    "vehicle.wheel_radius_m": "dynamic rolling radius of the driven wheels, m",
    "vehicle.wheel_radius_accuracy_pct": f"accuracy of the radius, {ACCURACY}chosen, tread from new to worn",
    "vehicle.wheel_inertia_kgm2": "moment of inertia of all wheels together, kg m²",
    "vehicle.final_drive": "ratio of the driven axle",
    "vehicle.gear_ratios": "gear number: transmission ratio; needed unless the bus sends the ratio",
    "vehicle.driveline_efficiency": "efficiency from crank to wheels, where `gear_efficiency` has no entry",
    "vehicle.gear_efficiency": "gear number: efficiency, where a gear differs (a direct gear)",
    "vehicle.engine_inertia_kgm2": "moment of inertia at the crank, with flywheel, kg m²",
    "vehicle.reference_torque_Nm": "100 % of the engine's torques, N m; SPN 544 replaces it once received",
    "vehicle.friction_torque_pct": "engine friction where SPN 514 is not sent, % of reference",
    "vehicle.torque_accuracy_pct": f"accuracy of the reported torque, {ACCURACY}40 CFR 1065.915, table 1",
    "vehicle.unreported_torque_Nm": "what accessories and the gearbox take at most of the reported crank "
    "torque, N m; null: 6, and with gears between torque and wheels 3 more for every tonne of mass_max_kg",
    "vehicle.retarder": "leave out when there is none, or when its torque is not reported",
    "vehicle.retarder.reference_torque_Nm": "100 % of the retarder's percent torque, N m",
    "vehicle.retarder.location": "where its torque acts",
    "vehicle.drag_area_m2": "drag coefficient times frontal area, m²",
    "vehicle.drag_area_accuracy_pct": f"accuracy of the area, {ACCURACY}chosen, after Vahidi et al. (2005)",
    "vehicle.air_density_kgpm3": "used until ambient pressure and temperature are received, kg/m³",
    "vehicle.rolling_resistance": "rolling resistance coefficient, N per N",
    "vehicle.rolling_resistance_accuracy_pct": f"accuracy of the coefficient, {ACCURACY}chosen, from "
    "UN Regulation 117 and Vahidi et al. (2005)",
    "vehicle.accelerometer.pitch_rad_per_mps2": "body pitch (squat), rad per m/s²; null: not "
    "known, and learned where torque and speed come at least five times a second",
    "dbc": "files, beside the config or among the shipped ones; an empty list for tables",
    "signals": "role: where it comes from; see below",
    "sampling.hold_s": "ticks go on this long after the last wanted frame, at least 2.5 `period_s` of the "
    "rarest, then they stop, s",
    "sampling.max_backward_s": "a clock set back further starts a new stretch; less is counted, s",
    "sampling.time_column": "column of decoded tables that holds the time: seconds, or ISO 8601",
    "filter.order": "order of the Butterworth low-pass for the whole regression",
    "filter.cutoff_hz": "-3 dB frequency of that filter, below 25 Hz (half the sampling rate)",
    "gates.*.enabled": ENABLED,
    "gates.*.recovery_s": RECOVERY,
    "gates.driveline.clutch_slip_pct": "closes beyond this slip, %",
    "gates.driveline.ratio_mismatch": "closes when the ratio of engine and shaft speed is off by this share",
    "gates.brake.pedal_pct": "closes beyond this pedal position, %",
    "gates.brake.assume_when_pedal_released": "a released accelerator counts as possible braking",
    "gates.possible_brake.propulsion_mps2": "without a brake role: closes where the accelerator, "
    "if any, is released and the traction gives the lightest vehicle less than this, m/s²",
    "gates.possible_brake.steepest_grade": "without a brake role: closes where the "
    "vehicle, whatever its mass, would have to climb steeper",
    "gates.retarder.torque_pct": "closes beyond this torque, % of the retarder's reference",
    "gates.low_speed.min_mps": "closes below this speed, m/s",
    "gates.turning.lateral_mps2": "closes beyond this lateral acceleration, m/s²",
    "gates.low_excitation.enabled": "null: on for the estimators that wind up without excitation",
    "gates.low_excitation.window_s": "how far back variation counts, s",
    "gates.low_excitation.force_share": "least standard deviation of the force, as share of the weight",
    "estimator.name": "one of " + ", ".join(BUILT_IN),
    "estimator.initial_mass_kg": "start value, kg; null: the estimator chooses",
    "estimator.initial_grade": "start value, ratio",
    "estimator.valid_std_pct": "`valid` needs a standard deviation below this, % of the mass; the papers' "
    "methods keep 10",
    "estimator.options": "the estimator's own options; see estimators.md",
    "effects": "what the plain model lacks; see Effects below",
    "bus.interface": "as python-can names it: socketcan, udp_multicast, virtual, slcan, pcan, ...",
    "bus.channel": "as python-can names it: can0, vcan0, ...",
    "bus.bitrate": "bit/s, for the interfaces that set it themselves",
    "bus.options": "further arguments for python-can",
    "broadcast.enabled": "null: only on a virtual bus; a physical bus needs true",
    "broadcast.listen_only": "no transmission at all, not even an address claim",
    "broadcast.pgn": "proprietary-B group of `CanestEstimate`",
    "broadcast.priority": "J1939 priority",
    "broadcast.rate_hz": "frames per second",
    "broadcast.preferred_address": "claimed first; another free one is taken on conflict",
    "broadcast.name.identity": "identity number of the J1939 NAME",
    "broadcast.name.manufacturer": "manufacturer code",
    "broadcast.name.ecu_instance": "ECU instance",
    "broadcast.name.function_instance": "function instance",
    "broadcast.name.function": "function code",
    "broadcast.name.vehicle_system": "vehicle system",
    "broadcast.name.vehicle_system_instance": "vehicle system instance",
    "broadcast.name.industry_group": "industry group",
    "broadcast.name.arbitrary_address_capable": "may take another address on conflict",
    "broadcast.cvw": "send the mass as SPN 1760 in PGN 65136 too, only while valid",
    "broadcast.pcc1": "send the grade as SPN 7432 in PGN 61651 too: map-based controllers may act on it",
    "service.learn": "off: neither restore nor save what was learned; on: restore; on+save: both",
    "service.state_dir": "null: systemd's $STATE_DIRECTORY, else ~/.local/state/canest",
    "service.save_every_s": "how often what was learned is saved, s",
    "service.restore_std": "least relative standard deviation of a restored mass",
    "service.metrics_file": "Prometheus text file for node_exporter; null: canest.prom in the runtime "
    f"directory under systemd, else none; {IN_RUNTIME}",
    "service.metrics_port": "port on which the same is served over HTTP",
    "service.record": f"candump log of everything received; {IN_STATE}",
    "service.log_estimates": f"est.csv of every estimate, 50 Hz; {IN_STATE}",
    "service.residual_dir": "bounded recording for `canest diagnose --recorded`; null: in the state "
    f"directory under systemd, else none; {IN_STATE}",
    "service.residual_max_mb": "bound of that recording, MB",
}

SOURCE_MEANINGS: dict[str, str] = {
    "message": "DBC message",
    "signal": "DBC signal of that message",
    "source": "J1939 source address that counts; null: the first one with valid values",
    "column": "instead of message and signal: column of a decoded table",
    "unit": "unit of the source, where no DBC gives it (tables) or the DBC's is wrong; null: the DBC's, else "
    "the role's",
    "delay_s": "the value describes the vehicle this much earlier than it is stamped, s",
    "period_s": "time between two reports of a slow signal, s, which are then joined "
    "([slow signals](#slow-signals)); null: the last one is held",
    "stale_s": "a sample older than this counts as missing, s; null: the role's limit (table below)",
    "validity": "which raw values count; see below",
    "optional": "false: the stale gate closes when this role is missing",
    "scale": "factor on top of everything, e.g. -1 for a sensor mounted backwards",
    "offset": "added after `scale`, in the role's unit (table below)",
    "map": "label or raw number: number; see below",
    "invert": "true: 0 is taken for 1 and 1 for 0; for roles of two states only",
}


def meaning(key: str) -> str:
    """Return what a key means. Errors: KeyError for a key that nobody has described."""
    if key in MEANINGS:
        return MEANINGS[key]
    head, _, last = key.rpartition(".")
    return MEANINGS[f"{head.split('.')[0]}.*.{last}"]
