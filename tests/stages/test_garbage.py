"""Garbage on the wire: no crash anywhere, and no position out of it."""

import random

import pytest

from sim.emulators.device import Emulator
from stages.errors import NoReply, ProtocolViolation, WrongDevice
from stages.protocols import grbl, isel_dnc, pi_gcs2, thorlabs_apt, zaber_ascii
from stages.protocols.apt_words import Kind

POSITION = {
    "zaber_ascii": (
        zaber_ascii.AnswerStream,
        zaber_ascii.Reply(1, 1, True, False, "--", "12345", 7, True).to_bytes(),
    ),
    "isel_dnc": (lambda: isel_dnc.PositionStream(3), isel_dnc.Position((1000, -20, 7)).to_bytes()),
    "pi_gcs2": (pi_gcs2.AnswerStream, pi_gcs2.Answer(("1=12.3450000",)).to_bytes()),
    "thorlabs_apt": (
        thorlabs_apt.AnswerStream,
        thorlabs_apt.Value(Kind.MOT_GET_POSCOUNTER, 1, 123_456).to_bytes(),
    ),
    "grbl": (grbl.AnswerStream, grbl.Status("Idle", (-1.0, 2.5, 3.25), extras=(("FS", "0,0"),)).to_bytes()),
}


def garbage(rng, valid):
    """Noise, or a valid answer with bytes changed, dropped, added or moved."""
    if rng.random() < 0.3:
        return rng.randbytes(rng.randrange(1, 60))
    raw = bytearray(valid)
    for _ in range(rng.randrange(1, 6)):
        place = rng.randrange(len(raw) + 1)
        match rng.randrange(4):
            case 0:
                raw[place : place + 1] = rng.randbytes(1)
            case 1:
                del raw[place : place + rng.randrange(4)]
            case 2:
                raw[place:place] = rng.randbytes(rng.randrange(3))
            case _:
                raw = raw[place:] + raw[:place]
    return bytes(raw)


@pytest.mark.parametrize("protocol", POSITION)
def test_thousands_of_pieces_of_garbage_per_parser(protocol):
    make, valid = POSITION[protocol]
    rng, stream, messages = random.Random(protocol), make(), 0
    for _ in range(3000):
        for answer in stream.feed(garbage(rng, valid)):
            messages += 1
            if not isinstance(answer, ProtocolViolation):
                assert answer.to_bytes()  # whatever was recognised can be said again
        assert len(stream.rest) <= 5000
    assert messages > 300


@pytest.mark.parametrize("stream", [m.CommandStream for m in (zaber_ascii, isel_dnc, pi_gcs2, grbl, thorlabs_apt)])
def test_emulators_survive_garbage_too(stream):
    rng, stream = random.Random(3), stream()
    for _ in range(500):
        stream.feed(rng.randbytes(rng.randrange(1, 80)))


def test_a_checksum_lets_no_damaged_position_through():
    """Zaber: whatever is done to a checksummed answer, it is refused or unchanged in meaning."""
    make, valid = POSITION["zaber_ascii"]
    original, rng = make().feed(valid)[0], random.Random(8)
    for _ in range(3000):
        place, byte = rng.randrange(1, len(valid) - 6), rng.randrange(33, 127)
        damaged = valid[:place] + bytes([byte]) + valid[place + 1 :]
        for answer in make().feed(damaged):
            assert isinstance(answer, ProtocolViolation) or answer == original


class Noisy:
    """Stands before an emulator and damages every answer."""

    def __init__(self, emulator: Emulator, rng: random.Random) -> None:
        self._emulator, self._rng = emulator, rng

    def __getattr__(self, name):
        return getattr(self._emulator, name)

    def take_answers(self):
        return [said._replace(data=garbage(self._rng, said.data)) for said in self._emulator.take_answers()]


@pytest.mark.slow
def test_no_position_from_a_corrupt_answer(bench, driver):
    """Every answer damaged: the driver gives up; it never reports a place where the axis is not."""
    made = bench(driver).homed({"a": 40.0, "b": 70.0})
    axis, truth_mm = made.stage.axis("a"), made.stage.where_mm()["a"]
    made.line.emulator = Noisy(made.line.emulator, random.Random(driver))
    refused = 0
    for _ in range(30):
        try:
            told_mm = axis.position_mm
        except (NoReply, ProtocolViolation, WrongDevice):  # a damaged identity looks like another device
            refused += 1
        else:
            assert told_mm == pytest.approx(truth_mm, abs=0.002)
    assert refused > 20
