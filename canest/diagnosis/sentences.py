"""What a diagnosis says in words: one sentence an engineer can act on."""

from __future__ import annotations

from collections.abc import Sequence

from canest.diagnosis.search.choice import Chosen

#: what would separate effects that a drive could not
SEPARATED_BY = {
    "headwind": "the same road in the other direction",
    "drag_area": "a drive with long stretches at very different speeds",
    "rolling_resistance": "the same road with another load",
    "rolling_resistance_speed": "the same road in the other direction (wind turns round, tyres do not)",
    "rolling_resistance_temperature": "drives in summer and in winter",
    "rolling_warmup": "a drive that starts warm",
    "brake_drag": "the same road with another load",
    "torque_gain": "a drive with much overrun, or a coast-down",
    "driveline_loss": "a drive with much overrun, or a coast-down",
    "torque_offset": "the same speeds in other gears",
    "wheel_radius": "a look at a navigation or undriven-axle speed",
    "rotating_inertia": "hard acceleration in low gears",
    "wheel_slip": "an undriven-axle speed",
    "torque_delay": "throttle steps at very different speeds",
    "retarder_unreported": "overrun with the retarder switched off",
    "cornering_drag": "a drive with more curves",
    "switched_load": "longer on and off times of its signal",
}


def said(chosen: Chosen) -> str:
    """Return an effect with its value in words, e.g. "a headwind of 6.5 +- 0.1 m/s"."""
    c = chosen.candidate
    info = c.info
    value = info.neutral + chosen.deviation
    number = f"{value:.3g} ± {chosen.std:.1g} {info.unit}".strip()
    shape = dict(c.shape)
    texts = {
        "headwind": f"a headwind of {number}"
        if value >= 0
        else f"a tailwind of {-value:.3g} ± {chosen.std:.1g} m/s",
        "drag_area": f"a drag area {number} {'larger' if value > 0 else 'away from'} than declared".replace(
            "away from than declared", "beside the declared one"
        ),
        "rolling_resistance": f"a rolling resistance coefficient {value:+.2g} ± {chosen.std:.1g} "
        "beside the declared",
        "rolling_resistance_speed": f"rolling resistance that grows by {number} with speed",
        "rolling_resistance_temperature": f"rolling resistance that grows by {value:.2g} ± "
        f"{chosen.std:.1g} per kelvin below 20 °C",
        "rolling_warmup": f"cold tyres: {value:.2g} ± {chosen.std:.1g} more rolling resistance at the start, "
        f"gone with {float(str(shape.get('tau_s', 0))):.0f} s",
        "torque_gain": f"true torque {value:.3f} ± {chosen.std:.1g} of the reported",
        "torque_offset": f"{number} lost at the crank",
        "torque_delay": f"torque reported {1000 * value:.0f} ± {1000 * chosen.std:.0f} ms late",
        "driveline_loss": f"{100 * value:.1f} ± {100 * chosen.std:.1g} % of traction lost"
        + (f" in gear {shape['gear']}" if shape.get("gear") else " in the driveline"),
        "wheel_radius": f"a rolling radius {value:.3f} ± {chosen.std:.1g} of the declared",
        "rotating_inertia": f"{number} more rotating inertia at the crank",
        "brake_drag": f"a dragging brake of {number}",
        "retarder_unreported": f"an unreported retarder of {number} at the crank with the pedal up",
        "cornering_drag": f"cornering drag of {number}",
        "wheel_slip": f"driven-wheel slip of {number}",
        "switched_load": f"{value:.3g} ± {chosen.std:.1g} kW taken while {shape.get('signal')} is on",
        "payload_change": f"{abs(value):,.0f} ± {chosen.std:,.0f} kg {'loaded' if value > 0 else 'unloaded'} "
        f"in the stop around t_s {float(str(shape.get('t_s', 0))):.0f}",
    }
    return texts.get(c.effect, f"{c.effect} of {number}")


def equivalents_said(chosen: Chosen) -> str:
    """Return which other effects would do as well, and what would separate them ('' when none)."""
    names = list(dict.fromkeys(e.effect for e in chosen.equivalent if e.effect != chosen.candidate.effect))
    if not names:
        return ""
    listed = ", ".join(n.replace("_", " ") for n in names)
    way = SEPARATED_BY.get(names[0], "")
    return f"this data cannot tell it from {listed}" + (f"; {way} would" if way else "")


def finding_of(
    verdict: str,
    chosen: Sequence[Chosen],
    before_N: float,
    after_N: float,
    hints: Sequence[str],
    hidden_N: float | None = None,
) -> str:
    """Return the one sentence of the report. hidden_N: what no effect alone removes more of, where so."""
    change = f"held-out residual {before_N:.0f} N before, {after_N:.0f} N after"
    if verdict == "nothing-to-explain":
        return f"The model fits this data as well as its noise allows ({before_N:.0f} N): nothing to add."
    hint = f" The remainder goes with {hints[0]}." if hints else ""
    if not chosen and hidden_N is not None:
        return (
            f"Something is missing from the model ({before_N:.0f} N of residual), and what any known effect "
            f"would remove of it is below {hidden_N:.0f} N, too little to be told: half a step of the "
            f"reported torque, or a slope of 0.02 %.{hint}"
        )
    if not chosen:
        return (
            f"Something is missing from the model ({before_N:.0f} N of residual), and none of the known "
            f"effects explains it.{hint}"
        )
    first = chosen[0]
    others = f", with {' and '.join(said(c) for c in chosen[1:])}" if chosen[1:] else ""
    same = equivalents_said(first)
    text = f"{said(first)[0].upper()}{said(first)[1:]}{others}: {change}"
    text += f"; {same}." if same else "."
    if verdict == "partly":
        text += f" A part stays unexplained.{hint}"
    if verdict == "unexplained":
        text = (
            f"Most of the residual stays unexplained ({change}); {said(first)} is all that was found.{hint}"
        )
    return text


def too_short(seconds: float, needed_s: float, residual_N: float) -> str:
    """Return what a log tells that is too short to tell effects apart."""
    return (
        f"{seconds:.0f} s with open gates tell how large the residual is ({residual_N:.0f} N), not where it "
        f"comes from: {needed_s:.0f} s are the least, some minutes at different speeds and loads are better."
    )
