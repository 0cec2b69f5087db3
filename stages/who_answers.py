"""Recognise another device by its answer where a certain one was expected.

A wrong rate, a wrong protocol and a swapped cable all begin with an answer that is none. Its first characters
mostly tell which kind of box gave it; where they tell nothing, the rate is the likelier mistake.
"""

import re
from collections.abc import Iterable

HANDS = (
    (rb"Grbl|GrblHAL|\[VER:|\bok\r\n|error:\d|<(Idle|Alarm|Hold|Run|Jog)", "a Grbl board (driver: grbl)"),
    (rb"[@!#]\d\d \d .*(IDLE|BUSY|OK|RJ)", "a Zaber device (driver: zaber_ascii)"),
    (rb"Physik Instrumente|PI_GCS|\bC-\d{3}\b", "a PI controller (driver: pi_gcs2)"),
    (rb"\x06\x00\x54\x00\x81|\x2a\x04\x06\x00\x81", "a Thorlabs box (driver: thorlabs_apt)"),
    (rb"iMC|[iI]sel", "an isel controller (driver: isel_dnc)"),
    (rb"(^|\n)\?[1-9]\r\n|QC,\d|BNC,\d", "a QC or BNC pulse generator (box: qc9520, bnc575, ..)"),
    (rb",DG645,", "a DG645 (box: srs_dg645)"),
    (rb"oltSync|Laser:(en|dis)able|Sequence:(OK|Error)", "a PIVlab synchroniser (box: pivlab_oltsync)"),
)
OLD_GRBL = rb"Grbl 0\.\d|\[0\.\d[a-z]?\.\d{8}:"  # banner, or answer to $I
SHOWN = 12  # bytes
LEAST_ECHO = 3  # bytes; a box may say one or two that it was sent


def kind_of_box(said: bytes) -> str | None:
    """Name the kind of box that says something like this, with the word of a bench file; None if nothing tells."""
    return next((kind for pattern, kind in HANDS if re.search(pattern, said)), None)


def describe_reply(said: bytes, sent: Iterable[bytes] = (), own: str = "") -> str:
    """Describe an unexpected reply and the cure, as the end of a sentence that begins with the device asked.

    Parameters
    ----------
    said : bytes
        All that came.
    sent : iterable of bytes
        What it was sent.
    own : str
        The driver that asked.
    """
    if any(len(data) >= LEAST_ECHO and data in said for data in sent):
        return "gives back what it is sent; switch the echo of the box or of its adapter off, or free RX from TX"
    if not said:
        return "says nothing; is it switched on, is its cable in this socket, is the rate its own?"
    if re.search(OLD_GRBL, said):
        return "has Grbl 0.9 or older, and Grbl 1.1 is needed; write the newer firmware to the board"
    if (kind := kind_of_box(said)) is not None and own and f"driver: {own})" in kind:
        return f"gives answers of {kind}, but none that is whole; is the cable good, is its firmware another one?"
    if kind is not None:
        return f"gives the answers of {kind}; are two cables swapped, or is it the wrong driver?"
    shown = said[:SHOWN].hex(" ") + (" .." if len(said) > SHOWN else "")
    return f"gives {len(said)} bytes that are no answer ({shown}); is the rate another one, or the box?"
