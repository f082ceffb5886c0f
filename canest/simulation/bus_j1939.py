"""The truck's bus: which controller sends what, and how often."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FrameBlock
from canest.simulation.effects import SwitchedLoad
from canest.simulation.j1587_gateway import gateway_schedule
from canest.simulation.j1939_messages import Truck
from canest.simulation.packing import Cyclic, constant, random_payloads, send
from canest.simulation.positions import Receiver
from canest.simulation.scenario import Scenario
from canest.simulation.sensors import Signals

BAM_PERIOD_S, BAM_PHASE_S, BAM_GAP_S = 5.0, 0.5, 0.055  #: broadcast announce message (J1939-21), gap chosen
AMBIENT = "CBFFFF4025FFFFFF"  #: AMB: 101.5 kPa, 25 degC
#: EC1 by J1939-21: 39 bytes in 6 packets of 7; SPN 544, the reference torque, in bytes 20 and 21
EC1_ANNOUNCED, EC1_PACKETS, PACKET_BYTES = "20270006FFE3FE00", 6, 7
REFERENCE_TORQUE = slice(19, 21)
#: frames that concern nobody: proprietary groups from source address 0x27
PROPRIETARY_ID, PROPRIETARY_COUNT, PROPRIETARY_PERIOD_S, NEXT_PGN = 0x18FF2027, 11, 0.02, 0x100
PROPRIETARY_PHASE_S, PROPRIETARY_SPACING_S, PROPRIETARY_FIRST = 0.016, 0.002, 0x20
#: random bytes in wanted groups from source address 0x31: identifier, period (s)
CAB_CONTROLLER = (
    (0x0C000031, 0.02),
    (0x18F00131, 0.1),
    (0x18FE6C31, 0.05),
    (0x18FEEE31, 1.0),
    (0x18FEEF31, 0.5),
    (0x18FEF131, 0.1),
    (0x18FEF231, 0.1),
)
CAB_SPACING_S, CAB_PHASE_S = 0.002, 0.001
POSITION_ID, POSITION_PHASE_S = 0x18FEF31C, 0.4  #: VP1 of the navigation unit, phase chosen
ANY_PAYLOAD = 2**64 - 1


def j1939_frames(
    signals: Signals, scenario: Scenario, load: SwitchedLoad | None, rng: np.random.Generator
) -> FrameBlock:
    """Return everything that is on the truck's bus during a drive."""
    bus = scenario.bus
    truck = Truck(signals, load, bus.j1587_gateway)
    messages = [
        *_engine_and_transmission(truck),
        *_engine_configuration(scenario),
        *(gateway_schedule(signals) if bus.j1587_gateway else _gear_speed_and_brake(truck)),
    ]
    if bus.traffic:
        messages += _traffic(rng)
    if bus.cab_controller:
        messages += _cab_controller(rng)
    return send(messages, scenario.duration_s, bus, rng)


def with_positions(
    frames: FrameBlock, signals: Signals, scenario: Scenario, rng: np.random.Generator
) -> FrameBlock:
    """Return the frames with those of a satellite receiver among them."""
    assert scenario.positions is not None
    receiver = Receiver(signals, scenario.positions, rng)
    message = Cyclic(POSITION_ID, scenario.positions.period_s, POSITION_PHASE_S, receiver.frames)
    both = FrameBlock.concatenate([frames, send([message], scenario.duration_s, scenario.bus, rng)])
    return both[np.argsort(both.t_us, kind="stable")]


def _engine_and_transmission(truck: Truck) -> list[Cyclic]:
    """Return what is on the bus of every truck: identifier, period and phase in s (chosen), content."""
    return [
        Cyclic(0x0CF00400, 0.02, 0.001, truck.eec1),
        Cyclic(0x0CF00300, 0.05, 0.007, truck.eec2),
        Cyclic(0x18FEDF00, 0.25, 0.041, truck.eec3),
        Cyclic(0x18FEF500, 1.0, 0.051, constant(AMBIENT)),
        Cyclic(0x18FEBD00, 1.0, 0.071, truck.fan),
        Cyclic(0x0CF00203, 0.01, 0.003, truck.etc1),
        Cyclic(0x18F0090B, 0.01, 0.006, truck.vdc2),
        Cyclic(0x18F0000F, 0.1, 0.031, truck.erc1),
        Cyclic(0x18FEE81C, 1.0, 0.061, truck.vds),
    ]


def _gear_speed_and_brake(truck: Truck) -> list[Cyclic]:
    """Return what a gateway to J1587 replaces."""
    return [
        Cyclic(0x18FEF100, 0.1, 0.017, truck.ccvs),
        Cyclic(0x18F00503, 0.1, 0.011, truck.etc2),
        Cyclic(0x18F0010B, 0.1, 0.023, truck.ebc1),
        Cyclic(0x18FEBF0B, 0.1, 0.029, truck.ebc2),
    ]


def _engine_configuration(scenario: Scenario) -> list[Cyclic]:
    """Return EC1 as a broadcast announce message; all but the reference torque is not available."""
    body = bytearray(b"\xff" * (EC1_PACKETS * PACKET_BYTES))
    body[REFERENCE_TORQUE] = round(scenario.vehicle.reference_torque_Nm).to_bytes(2, "little")
    packets = [
        bytes([k + 1]) + bytes(body[PACKET_BYTES * k : PACKET_BYTES * (k + 1)]) for k in range(EC1_PACKETS)
    ]
    return [Cyclic(0x18ECFF00, BAM_PERIOD_S, BAM_PHASE_S, constant(EC1_ANNOUNCED))] + [
        Cyclic(0x18EBFF00, BAM_PERIOD_S, BAM_PHASE_S + BAM_GAP_S * (k + 1), constant(packet.hex()))
        for k, packet in enumerate(packets)
    ]


def _traffic(rng: np.random.Generator) -> list[Cyclic]:
    """Return frames that concern nobody."""
    messages = [
        Cyclic(
            PROPRIETARY_ID + NEXT_PGN * k,
            PROPRIETARY_PERIOD_S,
            PROPRIETARY_PHASE_S + PROPRIETARY_SPACING_S * k,
            constant(f"{PROPRIETARY_FIRST + k:02X}102700FFFFFFFF"),
        )
        for k in range(PROPRIETARY_COUNT)
    ]
    hours = Cyclic(0x18FEC1EE, 1.0, 0.014, random_payloads(rng, ANY_PAYLOAD, endpoint=True))
    return [*messages, hours]


def _cab_controller(rng: np.random.Generator) -> list[Cyclic]:
    """Return random bytes in wanted groups, from another source address."""
    return [
        Cyclic(
            can_id, period, CAB_SPACING_S * k + CAB_PHASE_S, random_payloads(rng, ANY_PAYLOAD, endpoint=True)
        )
        for k, (can_id, period) in enumerate(CAB_CONTROLLER)
    ]
