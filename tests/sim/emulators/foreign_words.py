"""Which words each foreign client was heard to say to an emulator: foreign_words.json, for docs/devices.md.

    python -m pytest -n0 -p tests.sim.emulators.foreign_words -m "slow or not slow" tests/sim/emulators

With the clients installed this runs their tests and writes what was heard of each into the file; of a client that
is not there the file keeps what it has, as of python-microscope and thorlabs-apt-device.  The demos of
bnc575_delay_generator and MSmarra/ISEL, which are no packages, were played by hand, with `heard_by` around them.
"""

import json
import os
from collections import defaultdict
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from daq.timing.protocols import quantum_composers as qc
from sim.emulators.device import Emulator
from tests.stages.test_devices_page import SPOKEN

FILE = Path(__file__).with_name("foreign_words.json")
CLIENTS = {  # by how the names of their tests begin: package, and what the page calls it
    "test_zaber": ("zaber-motion", "zaber-motion"),
    "test_pi_official": ("pipython", "pipython"), "test_pylablib": ("pylablib", "pylablib"),
    "test_qmi": ("qmi", "QMI"),
}  # fmt: skip
SECTIONS = {
    "ZaberEmulator": "zaber_ascii", "PiEmulator": "pi_gcs2", "AptEmulator": "thorlabs_apt",
    "IselEmulator": "isel_dnc", "QuantumComposersEmulator": "qc9510",
}  # fmt: skip


def pulse_generator_word(keyword, asks):
    """A word in its short form, whichever form was written."""
    try:
        parts = ["n" if part.isdecimal() else part for part in qc.short_forms(keyword.replace("PULSEn", "PULSE1"))]
    except KeyError:
        parts = [keyword]
    if parts[0] == "PULS" and parts[1] != "n":
        parts.insert(1, "n")
    return " ".join(parts) + ("?" if asks else "")


def words_in(section, data):
    """The words in what one emulator has heard, as the page writes them."""
    if section == "qc9510":
        stream, word = qc.CommandStream, lambda command: pulse_generator_word(command.keyword, command.asks)
    else:
        stream, word = SPOKEN[section]
    return {word(message) for message in stream().feed(data) if not isinstance(message, Exception)}


@contextmanager
def heard_by(told):
    """Collect bytes by emulator while the block runs, in a mapping of (class, number) to bytes."""
    feed = Emulator.feed

    def listen(emulator, data):
        told[type(emulator).__name__, id(emulator)] += data
        return feed(emulator, data)

    Emulator.feed = listen
    try:
        yield
    finally:
        Emulator.feed = feed


def keep(client, told):
    """Put what a client has said into the file, with its version."""
    words = defaultdict(set)
    for (name, _), data in told.items():
        words[SECTIONS[name]] |= words_in(SECTIONS[name], data)
    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    known[client] = {section: sorted(said) for section, said in sorted(words.items())}
    FILE.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n")


class Listener:
    """Hears every test of a client; one ear for each client."""

    def __init__(self):
        self.told = defaultdict(lambda: defaultdict(bytes))

    def client_of(self, test):
        found = [names for begins, names in CLIENTS.items() if test.startswith(begins)]
        return f"{found[0][1]} {metadata.version(found[0][0])}" if found else None


EAR = Listener()


def pytest_runtest_setup(item):
    """Listen to what this test says."""
    try:
        client = EAR.client_of(item.name)
    except metadata.PackageNotFoundError:
        return
    if client is not None:
        item.ear = heard_by(EAR.told[client])
        item.ear.__enter__()


def pytest_runtest_teardown(item):
    """Listen no more."""
    if hasattr(item, "ear"):
        item.ear.__exit__(None, None, None)


def pytest_sessionfinish():
    """Keep what was heard."""
    if os.environ.get("PYTEST_XDIST_WORKER") is None:
        for client, told in EAR.told.items():
            keep(client, told)
