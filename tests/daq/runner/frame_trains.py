"""What an unkind camera sends for a train of pulses, and which pulse each frame truly shows.

Time, ids and marker are worked out here from the pulses alone; the finder under test sees only the metas.
"""

import random
from dataclasses import dataclass, replace

from daq.bench.pairs_section import PairsSection
from daq.cameras.frame import FrameMeta

RATE_HZ, EXPOSURE_US = 10.0, 4000.0
PERIOD_NS = 100_000_000
EVEN_DEAD_US = 46_000.0  # with the exposure half a period
META = FrameMeta(0, 0, 1, 0, EXPOSURE_US, "Mono12p", 12)


@dataclass(frozen=True)
class Faults:
    """Chances, a frame or an arm."""

    first: int = 3  # exposures skipped at most when the camera was armed
    skipped: float = 0.01  # not exposed; no id
    lost: float = 0.01  # exposed and never sent; the id is used up
    doubled: float = 0.005  # sent twice, the second time with an id of its own
    again: float = 0.002  # sent twice with one id
    late: float = 0.005  # comes behind the next one
    bounced: float = 0.003  # the trigger bounces: one more exposure soon after
    unmarked: float = 0.0


SECTIONS = {
    "double_height": PairsSection(shape="double_height", dead_us=1.0),
    "two_blocks, line": PairsSection(shape="two_blocks", marker="line_status", line=2, dead_us=1.0),
    "two_blocks, spacing": PairsSection(shape="two_blocks", marker="spacing", dead_us=1.0),
    "straddling, line": PairsSection(shape="straddling", marker="line_status", line=0, dead_us=EVEN_DEAD_US),
    "straddling, counter": PairsSection(
        shape="straddling", marker="counter", counter="CounterValue", dead_us=EVEN_DEAD_US
    ),
    "straddling, spacing": PairsSection(shape="straddling", marker="spacing", dead_us=40_000.0),
    "burst, counter": PairsSection(
        shape="burst", marker="counter", counter="FramesPerTriggerCounter", dead_us=5000.0
    ),
    "burst, spacing": PairsSection(shape="burst", marker="spacing", dead_us=5000.0),
}


def gap_us(section):
    return EXPOSURE_US + section.dead_us


def train(section, pairs, faults, chance, start_ns=10**9):
    """Yield (meta, (pulse, "A" or "B")) of one arm, in the order of arrival."""
    skip, exposures = chance.randint(0, faults.first), []
    one_buffer = section.shape == "double_height"
    for pulse in range(pairs):
        begun_ns = start_ns + pulse * PERIOD_NS + chance.randint(-2000, 2000)
        second_ns = begun_ns + (0 if one_buffer else round(1e3 * gap_us(section)))
        taken = 0
        for letter, at_ns in (("A", begun_ns), ("B", second_ns)):
            if one_buffer and letter == "B":
                continue
            if skip or chance.random() < faults.skipped:
                skip -= skip > 0
                continue
            taken += 1
            exposures.append((at_ns, pulse, letter, taken))
            if chance.random() < faults.bounced:
                taken += 1
                exposures.append((at_ns + chance.randint(100_000, 30_000_000), pulse, letter, taken))
    exposures.sort()
    sent, frame_id = [], chance.randint(1, 60_000)
    for at_ns, pulse, letter, count in exposures:
        meta = replace(META, frame_id=frame_id, timestamp_ns=at_ns, chunks=chunks(section, letter, count))
        frame_id += 1
        if chance.random() < faults.unmarked:
            meta = replace(meta, chunks={})
        if chance.random() < faults.lost:
            continue
        sent.append((meta, (pulse, letter)))
        if chance.random() < faults.doubled:
            sent.append((replace(meta, frame_id=frame_id), (pulse, letter)))
            frame_id += 1
        elif chance.random() < faults.again:
            sent.append((meta, (pulse, letter)))
    for place in range(len(sent) - 1):
        if chance.random() < faults.late:
            sent[place], sent[place + 1] = sent[place + 1], sent[place]
    yield from numbered(sent, one_buffer)


def chunks(section, letter, count):
    """What the marker says of an exposure; a counter counts the exposures since T0 reset it."""
    if section.effective_marker == "line_status":
        return {"LineStatusAll": (1 << section.line if letter == "A" else 0) | 0b1000_0000}
    return {section.counter: count} if section.effective_marker == "counter" else {}


def numbered(sent, one_buffer):
    """Give sequences as the backends do, and cut buffers in two."""
    from daq.cameras.ids import IdTracker

    ids = IdTracker()
    for meta, (pulse, letter) in sent:
        sequence = ids.note(meta.frame_id)
        if not one_buffer:
            yield replace(meta, sequence=sequence), (pulse, letter)
            continue
        for half, name in enumerate("AB"):
            yield replace(meta, sequence=2 * sequence + half), (pulse, name)


def arms(section, pairs, faults, seed, chunk=50):
    """Trains of many arms, until that many pairs of pulses were fired."""
    chance = random.Random(seed)
    for fired in range(0, pairs, chunk):
        yield min(chunk, pairs - fired), list(train(section, min(chunk, pairs - fired), faults, chance))
