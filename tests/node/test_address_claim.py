"""Address claim by scenario: each test is a short conversation on a bus."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.config.bus import Name
from canest.decode import j1939
from canest.node.address_claim import (
    BURST,
    CLAIM_PGN,
    FIRST_RETRY_US,
    NULL_ADDRESS,
    REFILL_US,
    RETRY_US,
    SPREAD_US,
    VETO_US,
    AddressClaim,
    State,
    encode_name,
)

OURS = encode_name(Name(identity=1000))
STRONGER, WEAKER = OURS - 1, OURS + 1
FIXED = OURS & ~(1 << 63)
TICK_US = 20_000


class Conversation:
    """Runs a claim in ticks of 20 ms and keeps what it sends."""

    def __init__(self, name=OURS, preferred=158, uniform=lambda: 0.5):
        self.claim = AddressClaim(name, preferred, uniform)
        self.now_us = 1_000_000
        self.sent, self.sent_us = [], []
        self.claim.start(self.now_us)

    def run(self, us):
        end = self.now_us + us
        while self.now_us < end:
            frames = self.claim.poll(self.now_us)
            self.sent += frames
            self.sent_us += [self.now_us] * len(frames)
            self.now_us += TICK_US
        return self

    def other(self, source, name):
        self.claim.on_claim(source, name, self.now_us)

    @property
    def sources(self):
        return [j1939.source_of(can_id) for can_id, _ in self.sent]


def test_an_unopposed_claim_owns_the_address_after_250_ms_and_not_before():
    talk = Conversation()
    talk.run(VETO_US - TICK_US)
    assert talk.claim.address is None
    talk.run(3 * TICK_US)
    assert talk.claim.address == 158
    [(can_id, payload)] = talk.sent
    assert j1939.pgn_of(can_id) == CLAIM_PGN
    assert j1939.destination_of(can_id) == j1939.GLOBAL_ADDRESS
    assert can_id & 0x1FFFFFFF == 0x18EEFF9E
    assert int.from_bytes(payload, "little") == OURS


def test_the_name_has_its_fields_where_the_standard_puts_them():
    name = encode_name(
        Name(
            identity=0x1ABCDE, manufacturer=0x5A5, ecu_instance=5, function_instance=0x15, function=33,
            vehicle_system=0x55, vehicle_system_instance=9, industry_group=1,
        )
    )  # fmt: skip
    assert name & 0x1FFFFF == 0x1ABCDE
    assert name >> 21 & 0x7FF == 0x5A5
    assert name >> 32 & 7 == 5
    assert name >> 35 & 0x1F == 0x15
    assert name >> 40 & 0xFF == 33
    assert name >> 48 & 1 == 0
    assert name >> 49 & 0x7F == 0x55
    assert name >> 56 & 0xF == 9
    assert name >> 60 & 7 == 1
    assert name >> 63 == 1


def test_a_weaker_contender_is_answered_and_we_keep_the_address():
    talk = Conversation().run(400_000)
    talk.other(158, WEAKER)
    talk.run(100_000)
    assert talk.claim.address == 158
    assert talk.sources == [158, 158]


def test_a_stronger_contender_takes_the_address_and_we_claim_the_next_one():
    talk = Conversation().run(400_000)
    talk.other(158, STRONGER)
    assert talk.claim.address is None
    talk.run(400_000)
    assert talk.claim.address == 159
    assert talk.sources == [158, 159]


def test_the_walk_skips_addresses_known_to_be_taken_and_wraps_around():
    talk = Conversation(preferred=246)
    for taken in (247, 128, 129):
        talk.other(taken, STRONGER - taken)
    talk.run(100_000)
    talk.other(246, STRONGER)
    talk.run(400_000)
    assert talk.claim.address == 130


def test_a_node_that_moved_frees_its_old_address():
    talk = Conversation()
    talk.other(159, 12345)
    talk.other(160, 12345)
    talk.run(100_000)
    talk.other(158, STRONGER)
    talk.run(400_000)
    assert talk.claim.address == 159


def test_a_fixed_address_lost_means_cannot_claim_and_silence():
    talk = Conversation(name=FIXED).run(400_000)
    talk.other(158, FIXED - 1)
    talk.run(1_000_000)
    assert talk.claim.state is State.CANNOT_CLAIM and talk.claim.address is None
    assert talk.sources == [158, NULL_ADDRESS]


def test_cannot_claim_waits_its_pseudo_random_delay():
    talk = Conversation(name=FIXED).run(400_000)
    talk.other(158, FIXED - 1)
    begin = talk.now_us
    while NULL_ADDRESS not in talk.sources:
        talk.run(TICK_US)
    assert talk.now_us - begin <= 153_000 + 2 * TICK_US


def test_when_every_address_is_taken_we_are_silent_and_try_again_later():
    talk = Conversation()
    for address in range(128, 248):
        if address != 158:
            talk.other(address, 5000 + address)
    talk.run(100_000)
    talk.other(158, STRONGER)
    talk.run(1_000_000)
    assert talk.claim.state is State.CANNOT_CLAIM
    talk.run(RETRY_US + 1_000_000)
    assert talk.claim.address == 158


def test_our_own_name_from_elsewhere_makes_us_silent_instead_of_walking_in_step_with_it():
    talk = Conversation().run(TICK_US)
    talk.other(158, OURS)
    talk.run(1_000_000)
    assert talk.claim.address is None
    assert "our NAME" in talk.claim.reason


def together(us, *talks):
    """Let conversations receive each other; return the addresses owned at every tick."""
    owned = []
    for _ in range(us // TICK_US):
        for talk in talks:
            talk.sent.clear()
            talk.run(TICK_US)
            for other in talks:
                for can_id, payload in talk.sent if other is not talk else ():
                    other.other(j1939.source_of(can_id), int.from_bytes(payload, "little"))
        owned.append([talk.claim.address for talk in talks])
    return owned


def test_of_two_nodes_with_one_name_the_second_is_silent_for_good():
    first, second = Conversation().run(400_000), Conversation()
    owned = together(3 * RETRY_US, first, second)
    assert {b for _, b in owned} == {None}
    assert sum(a == 158 for a, _ in owned) > 0.98 * len(owned)


@pytest.mark.parametrize(("early", "late"), [(0.0, 0.1), (0.3, 0.9)])
def test_of_two_nodes_with_one_name_that_start_at_once_one_has_the_address_within_seconds(early, late):
    first, second = Conversation(uniform=lambda: early), Conversation(uniform=lambda: late)
    for talk in (first, second):  # both claims are on the bus before either is received
        talk.run(TICK_US)
    first.other(158, OURS)
    second.other(158, OURS)
    assert {first.claim.state, second.claim.state} == {State.CANNOT_CLAIM}
    owned = together(FIRST_RETRY_US + SPREAD_US, first, second)
    assert owned[-1] == [158, None]
    owned = together(3 * RETRY_US, first, second)
    assert {b for _, b in owned} == {None}
    assert sum(a == 158 for a, _ in owned) > 0.98 * len(owned)


def test_of_two_owners_with_one_name_one_stays_when_their_buses_are_joined():
    first, second = Conversation().run(400_000), Conversation().run(400_000)
    first.claim.on_request(first.now_us)
    owned = together(3 * RETRY_US, first, second)
    assert {158, None} == set(owned[-1])
    assert not any(a and b for a, b in owned[1:])


def test_a_request_for_claims_is_answered_with_the_claim():
    talk = Conversation().run(400_000)
    talk.claim.on_request(talk.now_us)
    talk.run(100_000)
    assert talk.sources == [158, 158]


def test_a_request_after_we_could_not_claim_is_answered_from_the_null_address():
    talk = Conversation(name=FIXED).run(400_000)
    talk.other(158, FIXED - 1)
    talk.run(1_000_000)
    talk.claim.on_request(talk.now_us)
    talk.run(300_000)
    assert talk.sources == [158, NULL_ADDRESS, NULL_ADDRESS]


def test_a_request_after_we_could_not_claim_is_answered_after_our_own_delay():
    talk = Conversation(name=FIXED).run(400_000)
    talk.other(158, FIXED - 1)
    lost_us = talk.now_us
    talk.run(1_000_000)
    delay_us = talk.sent_us[-1] - lost_us
    talk.claim.on_request(asked_us := talk.now_us)
    talk.run(300_000)
    assert talk.sent_us[-1] - asked_us == delay_us > 0


def test_a_spoofer_contesting_every_claim_cannot_make_us_flood():
    talk = Conversation()
    seconds = 60
    for _ in range(seconds * 50):
        for address in range(128, 248):
            talk.other(address, 1)
        talk.claim.on_request(talk.now_us)
        talk.run(TICK_US)
    assert len(talk.sent) <= BURST + seconds * 1_000_000 / REFILL_US + 1
    assert talk.claim.address is None


def test_a_claim_the_bus_did_not_take_is_sent_again_and_does_not_count():
    talk = Conversation()
    frames = talk.claim.poll(talk.now_us)
    assert frames
    talk.claim.not_sent(talk.now_us)
    talk.now_us += VETO_US + TICK_US
    talk.claim.poll(talk.now_us)
    assert talk.claim.address is None  # it has only now been sent
    talk.run(VETO_US + 2 * TICK_US)
    assert talk.claim.address == 158


def test_after_a_long_sleep_the_address_is_claimed_again_before_it_is_used():
    talk = Conversation().run(400_000)
    talk.now_us += 60_000_000
    talk.sent += talk.claim.poll(talk.now_us)
    assert talk.claim.address is None
    talk.run(400_000)
    assert talk.claim.address == 158


events = st.one_of(
    st.tuples(st.just("claim"), st.integers(0, 255), st.integers(0, 2**64 - 1)),
    st.tuples(st.just("claim"), st.integers(150, 165), st.sampled_from([OURS, STRONGER, WEAKER])),
    st.tuples(st.just("request"), st.just(0), st.just(0)),
    st.tuples(st.just("lost"), st.just(0), st.just(0)),
    st.tuples(st.just("wait"), st.integers(0, 3_000_000), st.just(0)),
)


@given(st.lists(events, max_size=60))
@settings(max_examples=200, deadline=None)
def test_whatever_happens_an_owned_address_is_in_range_and_uncontested(happenings):
    talk = Conversation()
    for what, a, b in happenings:
        if what == "claim":
            talk.other(a, b)
            if a == talk.claim.address:
                assert b > OURS  # whoever is stronger takes it at once
        elif what == "request":
            talk.claim.on_request(talk.now_us)
        elif what == "lost":
            talk.claim.not_sent(talk.now_us)
        else:
            talk.now_us += a
        talk.run(TICK_US)
        assert talk.claim.address is None or 128 <= talk.claim.address <= 247
