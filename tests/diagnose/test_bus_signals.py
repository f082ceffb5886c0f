"""What the bus offers beside the signal map, whatever kind of bus it is."""

from canest.config import parse_config
from canest.decode.signal_map import decoder_for
from canest.diagnose.bus import _signals
from canest.resources import shipped

OWN_DBC = """VERSION ""

BU_: X

BO_ 259 Aux: 8 X
 SG_ AcOn : 8|1@1+ (1,0) [0|1] "" X

BO_ 260 Odd: 8 X
 SG_ Half : 0|16@1- (1,0) [0|0] "" X

BO_ 2566844926 Wide: 8 X
 SG_ Lamp : 0|2@1+ (1,0) [0|3] "" X

SIG_VALTYPE_ 260 Half : 1;
"""


def test_messages_that_are_no_j1939_come_under_their_own_identifier(tmp_path):
    """Such a signal may become a switch of the revised config, which then must not name an address."""
    (tmp_path / "own.dbc").write_text(OWN_DBC)
    log = tmp_path / "car.log"
    frames = ("103#0001000000000000", "203#0000000000000000", "104#00", "18FEF1FE#01", "18FEF117#01",
              "0CF00400#F1CD86451400FFFF")  # fmt: skip
    log.write_text("".join(f"({0.1 * i:.6f}) can0 {frame}\n" for i in range(9) for frame in frames))
    text = (shipped("configs") / "class8.yaml").read_text()
    config = parse_config(text.replace("[j1939.dbc]", f"[{tmp_path / 'own.dbc'}, j1939.dbc]"))
    found = _signals(log, config)
    assert {"Aux.AcOn", "EEC1.EngSpeed from 0x00"} <= set(found)
    assert not {name for name in found if name.startswith(("Odd", "Aux.AcOn ")) or name.endswith("0xfe")}
    source, stamps, values = found["Aux.AcOn"]
    assert (source.source, len(stamps), set(values.tolist())) == (None, 9, {1.0})
    decoder_for(config.model_copy(update={"signals": config.signals | {"acon": source}}))


def test_a_table_has_columns_whatever_dbc_its_config_lists(tmp_path):
    log = tmp_path / "trip.csv"
    log.write_text("seconds,v,lamp\n" + "".join(f"{0.1 * i},10,{i % 2}\n" for i in range(9)))
    text = (shipped("configs") / "bmw-i3.yaml").read_text().replace("dbc: []", "dbc: [j1939.dbc]")
    found = _signals(log, parse_config(text, overrides=["sampling.time_column=seconds"]))
    assert set(found) == {"v", "lamp"}
    assert found["lamp"][0].column == "lamp"
