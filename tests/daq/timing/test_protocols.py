"""The grammars of timing units against what vendors and devices wrote, not against each other."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.timing.protocols import pivlab_synchroniser, pulse_box, quantum_composers, srs_dg645
from stages.errors import ProtocolViolation
from tests.documented import examples_of
from tests.loops import loop_over
from tests.stages.test_protocols import decode

GRAMMARS = (quantum_composers, pivlab_synchroniser, pulse_box, srs_dg645)
CLASSES = [(grammar, cls) for grammar in GRAMMARS for cls in (*grammar.COMMANDS, *grammar.ANSWERS)]


@loop_over("grammar, cls", CLASSES)
def test_every_message_is_read_and_written_as_documented(grammar, cls):
    assert examples_of(cls)
    for example in examples_of(cls):
        assert decode(grammar, cls, example.raw) == example.message
        assert example.message.to_bytes() == example.raw
        assert example.source


def mutants(value):
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int | float):
        return [value + 1]
    if isinstance(value, tuple):
        return [value[1:]] if value else [(1,)]
    return [value + "1"] if isinstance(value, str) else ["1"]


@loop_over("grammar, cls", CLASSES)
def test_every_field_counts(grammar, cls):
    for example in examples_of(cls):
        for field in dataclasses.fields(cls):
            for other in mutants(getattr(example.message, field.name)):
                changed = dataclasses.replace(example.message, **{field.name: other})
                assert changed.to_bytes() != example.raw


@pytest.mark.parametrize("grammar", GRAMMARS)
@given(chunks=st.lists(st.binary(max_size=40), max_size=12))
def test_anything_may_come_over_the_wire(grammar, chunks):
    for make in (grammar.CommandStream, grammar.AnswerStream):
        stream = make()
        for chunk in chunks:
            stream.feed(chunk)
        assert len(stream.rest) <= 512


@pytest.mark.parametrize("line", [b"?", b"?0", b"?10", b"?100", b"?x", b"\x01\xff"])
def test_what_is_no_answer_of_a_pulse_generator(line):
    with pytest.raises(ProtocolViolation):
        quantum_composers.parse_answer(line)


@pytest.mark.parametrize(
    ("text", "short"),
    [
        (":Pulse2:State", ("PULS", "2", "STAT")),
        (":PULSE0:TRIGger:MODe", ("PULS", "0", "TRIG", "MOD")),
        (":SPULSE:PERIOD", ("SPUL", "PER")),
        (":PULSE:STAT", ("PULS", "STAT")),
        (":PULS0:MOD", ("PULS", "0", "MOD")),
    ],
)
def test_keywords_have_two_forms(text, short):
    assert quantum_composers.short_forms(text) == short


@pytest.mark.parametrize("text", [":PULSE1:POLAR", ":PULSE1:STA", ":PUL1:STAT", ":"])
def test_and_nothing_between(text):
    with pytest.raises(KeyError):
        quantum_composers.short_forms(text)
