"""docs/devices.md names a foreign client beside a word only if that client was heard to say it to our emulator."""

import json
import re

from tests.loops import loop_over
from tests.sim.emulators.foreign_words import FILE, pulse_generator_word
from tests.stages.test_devices_page import rows

HEARD = json.loads(FILE.read_text())
CLAIMS = [
    (section, word, claim[1])
    for section, word, _, _, _, state in rows()
    if (claim := re.match("foreign client: ([^;]+)", state))
]


@loop_over("section, word, client", CLAIMS)
def test_a_foreign_client_is_named_for_words_that_it_has_said(section, word, client):
    (said,) = [words[section] for name, words in HEARD.items() if name.startswith(client)]
    if section == "qc9510":
        word = pulse_generator_word(word.removesuffix("?"), word.endswith("?"))
    assert word in said


def test_every_client_that_was_heard_is_named_on_the_page():
    named = {client for _, _, client in CLAIMS}
    assert len(CLAIMS) > 50
    assert {name for name in HEARD if not any(name.startswith(client) for client in named)} == set()
