"""The grammars against what the vendors wrote, not against each other."""

import dataclasses
import struct
from importlib import import_module

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.drivers_by_name import DRIVERS
from stages.errors import ProtocolViolation
from stages.protocols import isel_dnc, pi_gcs2, thorlabs_apt, zaber_ascii
from stages.protocols.framing import Lines
from tests.documented import examples_of
from tests.loops import loop_over

GRAMMARS = {name: import_module(f"stages.protocols.{name}") for name in DRIVERS}
CLASSES = [(grammar, cls) for grammar in GRAMMARS.values() for cls in (*grammar.COMMANDS, *grammar.ANSWERS)]


def decode(grammar, cls, raw):
    """Message in `raw`, through the public streams and parsers."""
    if cls is isel_dnc.Ack:
        return isel_dnc.parse_ack(raw)
    if cls is isel_dnc.Position:
        return isel_dnc.parse_position(raw)
    if cls is isel_dnc.Identity:
        return isel_dnc.parse_identity(raw)
    stream = grammar.CommandStream() if cls in grammar.COMMANDS else grammar.AnswerStream()
    messages = stream.feed(raw)
    assert len(messages) == 1
    return messages[0]


def documented(grammar, cls, encode=lambda message: message.to_bytes(), undo=lambda message: message):
    """True if the grammar reads and writes every documented example of a class."""
    try:
        for example in examples_of(cls):
            if undo(decode(grammar, cls, example.raw)) != example.message:
                return False
            written = encode(example.message)
            if undo(decode(grammar, cls, written)) != example.message:
                return False
    except (ProtocolViolation, AssertionError, ValueError, OverflowError, struct.error):
        return False
    return True


@loop_over("grammar, cls", CLASSES)
def test_every_message_has_documented_examples_and_meets_them(grammar, cls):
    assert examples_of(cls)
    assert all(example.source for example in examples_of(cls))
    assert documented(grammar, cls)


SHORTER = {b"/\n", b"/home\n", b"/1 move abs 10000\n", b"/01 1 get pos\n", b"/1 system reset\n"}


@loop_over("example", [each for _, cls in CLASSES for each in examples_of(cls) if each.raw not in SHORTER])
def test_written_exactly_as_documented(example):
    """Byte for byte, but for abbreviations we never use."""
    assert example.message.to_bytes() == example.raw


def mutants(value):
    """Scaled, negated, shifted, swapped."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int | float):
        return [value + 1, -value, value * 10]
    if isinstance(value, str):
        return [value + "1", value[::-1]]
    if isinstance(value, bytes):
        return [value[::-1], bytes([value[0] ^ 1]) + value[1:]]
    if isinstance(value, tuple):
        return [value[::-1], value[1:]]
    return [1]


@loop_over(
    "grammar, cls, name", [(*each, field.name) for each in CLASSES for field in dataclasses.fields(each[1])]
)
def test_a_mutated_field_is_noticed(grammar, cls, name):
    """The same bug in both directions cancels itself between driver and emulator; examples still see it."""
    for index in range(3):

        def mutate(message, index=index):
            if not isinstance(message, cls):
                return message
            options = mutants(getattr(message, name))
            return dataclasses.replace(message, **{name: options[index % len(options)]})

        changed = any(mutate(example.message) != example.message for example in examples_of(cls))
        if changed:
            assert not documented(grammar, cls, undo=mutate), f"{name} changed on reading goes unnoticed"
            assert not documented(grammar, cls, encode=lambda message: mutate(message).to_bytes()), (
                f"{name} changed on writing goes unnoticed"
            )


@pytest.mark.parametrize("grammar", GRAMMARS.values(), ids=GRAMMARS)
@pytest.mark.parametrize("side", ["CommandStream", "AnswerStream"])
@settings(max_examples=40)
@given(data=st.data())
def test_chunk_boundaries_mean_nothing(grammar, side, data):
    host = side == "CommandStream"
    if grammar is isel_dnc and not host:
        messages = data.draw(st.lists(st.tuples(st.integers(-(2**23), 2**23 - 1)), max_size=8))
        raw = b"".join(isel_dnc.Position(steps).to_bytes() for steps in messages)
        make = lambda: isel_dnc.PositionStream(1)  # noqa: E731
    else:
        classes = grammar.COMMANDS if host else grammar.ANSWERS
        pool = [example for cls in classes for example in examples_of(cls)]
        raw = b"".join(e.raw for e in data.draw(st.lists(st.sampled_from(pool), max_size=8)))
        make = getattr(grammar, side)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(raw)), max_size=6)))
    whole, pieces = make().feed(raw), make()
    chunked = [m for a, b in zip([0, *cuts], [*cuts, len(raw)], strict=True) for m in pieces.feed(raw[a:b])]
    assert chunked == whole


@given(st.integers(-(2**23), 2**23 - 1))
def test_isel_positions_are_24_bit_twos_complement(steps):
    raw = isel_dnc.Position((steps,)).to_bytes()
    assert int.from_bytes(bytes.fromhex(raw[1:].decode()), "big", signed=True) == steps
    assert isel_dnc.parse_position(raw).steps == (steps,)


def test_zaber_checksum_brings_the_sum_to_zero():
    raw = zaber_ascii.Command("move abs 10000", 1, 1, 5).to_bytes()
    body, check = raw[1:-1].rsplit(b":", 1)
    assert (sum(body) + int(check, 16)) % 256 == 0
    with pytest.raises(ProtocolViolation, match="checksum"):
        zaber_ascii.parse_command(raw[:-1].replace(b"10000", b"10001"))


@pytest.mark.parametrize("raw", [b"1=12.5\n2=3\n", b"1=\n", b"1=12.5 \n1=3\n", b"12.5\n"])
def test_pi_values_take_nothing_doubtful(raw):
    answers = pi_gcs2.AnswerStream().feed(raw)
    if len(answers) == 1:
        with pytest.raises(ProtocolViolation):
            answers[0].values()


@pytest.mark.parametrize("text", ["nan", "inf", "1_000", "0x10", " 1", "", "1e999", "--1", "1.2.3"])
def test_pi_numbers_are_plain(text):
    with pytest.raises(ProtocolViolation):
        pi_gcs2.number(text)


APT_POSITION = thorlabs_apt.Value(0x0412, 1, 77).to_bytes()
APT_MOVED = thorlabs_apt.Unasked(0x0464, bytes(14)).to_bytes()


@pytest.mark.parametrize(
    "raw",
    [
        APT_POSITION[:5] + b"\x01" + APT_POSITION[6:],  # from a host
        APT_POSITION[:5] + b"\x00" + APT_POSITION[6:],  # from nobody, and asked for
        APT_POSITION[:4] + b"\xd0" + APT_POSITION[5:],  # to a box
        APT_POSITION[:4] + b"\x01" + APT_POSITION[5:],  # without its data
        APT_POSITION[:2] + b"\x07\x00" + APT_POSITION[4:],  # of another length
        b"\x53" + APT_POSITION[1:],  # what only a host says
        b"\x12\x02" + APT_POSITION[2:],  # data where there are none
    ],
)
def test_apt_takes_nothing_that_is_not_exactly_an_answer(raw):
    stream = thorlabs_apt.AnswerStream()
    assert [type(answer) for answer in stream.feed(raw)] == [ProtocolViolation]
    assert stream.rest == b""


def test_apt_lets_nobody_tell_the_end_of_a_motion():
    (answer,) = thorlabs_apt.AnswerStream().feed(APT_MOVED[:5] + b"\x00" + APT_MOVED[6:])
    assert isinstance(answer, thorlabs_apt.Unasked)


@loop_over("cut", range(0, 103, 7))
def test_apt_an_identity_is_found_behind_the_rest_of_a_message(cut):
    example, *_ = examples_of(thorlabs_apt.Info)
    raw, stream = APT_POSITION[3:] + example.raw + APT_MOVED, thorlabs_apt.IdentityStream(0x50)
    found = stream.feed(raw[:cut]) + stream.feed(raw[cut:])
    assert found[0] == example.message
    assert isinstance(found[1], thorlabs_apt.Unasked)
    assert stream.rest == b""
    assert thorlabs_apt.IdentityStream(0x11).feed(raw) == []


def test_a_line_without_end_is_dropped():
    lines = Lines(b"\n", longest=100)
    lines.feed(b"x" * 100)
    with pytest.raises(ProtocolViolation, match="no end"):
        lines.feed(b"x")
    assert lines.feed(b"ok\n") == [b"ok"]
