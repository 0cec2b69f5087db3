"""Some hundred damaged files every time: read, or refused in one sentence, in two seconds and 500 MB each.

`make fuzz CASES=100000` plays a hundred thousand, and any number again by itself.
"""

import pytest

from tests.fuzz.amount import PATIENCE_S, cases, seed
from tests.fuzz.files.damaged_files import LONGEST_S, MOST_MB, Playground, fuzz
from tests.fuzz.files.originals import ORIGINALS

pytestmark = pytest.mark.timeout(900)  # the first time kernels are compiled


@pytest.fixture(scope="module")
def playground(tmp_path_factory):
    return Playground(tmp_path_factory.mktemp("readers"))


def quiet(text):
    return


def test_thousands_of_damaged_files(playground):
    tally = fuzz("fast", range(220), playground)
    assert not tally.findings
    assert tally.longest_s <= LONGEST_S
    assert tally.most_mb <= MOST_MB
    assert tally.refused > 110
    assert set(tally.by_file) == {each.path for each in ORIGINALS}


@pytest.mark.slow
@pytest.mark.timeout(PATIENCE_S)
def test_a_hundred_thousand_damaged_files(playground):
    tally = fuzz(seed("slow"), range(cases(100_000)), playground)
    assert not tally.findings


@pytest.mark.parametrize("error", [KeyError("a"), RecursionError("deep"), TypeError("None")])
def test_what_nobody_raised_on_purpose_is_found(playground, monkeypatch, error):
    """The judge itself: a reader that lets one of these through is told, with file and line."""

    def careless(path, kind):
        raise error

    monkeypatch.setattr("correction.fitted.scene_sigma.load_arrays", careless)
    tally = fuzz("judge", range(200), playground, enough=1, tell=quiet)
    assert type(error).__name__ in tally.findings[0]
    assert "fit.npz" in tally.findings[0]


def test_a_reader_that_takes_too_much_is_found(playground, monkeypatch):
    def greedy(path, kind):
        return bytes(600_000_000).count(1)

    monkeypatch.setattr("correction.fitted.scene_sigma.load_arrays", greedy)
    tally = fuzz("judge", range(200), playground, enough=1, tell=quiet)
    assert "fit.npz" in tally.findings[0]
