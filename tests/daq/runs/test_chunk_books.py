"""What became of the pairs of a flow, in words."""

from daq.runs.frame_accounting import LEFT, SURPLUS, chunk_sentences

CHUNK = {"kind": "chunk", "fired": 10, "pairs": 8, "surplus": 1, "lost": 1, "never_came": 2}


def test_a_run_without_chunks_says_nothing():
    assert chunk_sentences([{"kind": "frame"}]) == []


def test_what_became_of_pairs_and_of_other_frames_is_told():
    one = CHUNK | {"dropped": {SURPLUS: 2}}
    other = CHUNK | {"dropped": {LEFT: 2, "came late": 1}, "never_came": -1}
    pairs, others = chunk_sentences([{"kind": "step"}, one, other])
    assert pairs == "20 pairs were fired in 2 chunks: 16 are kept, 2 more than were wanted, 2 are lost"
    assert others == "other frames that are in no pair: 1 came late, 2 left when the chunk ended, 1 never came"


def test_a_run_in_which_nothing_was_lost_is_one_sentence():
    clean = CHUNK | {"pairs": 10, "surplus": 0, "lost": 0, "never_came": 0, "dropped": {}}
    assert chunk_sentences([clean]) == ["10 pairs were fired in one chunk: 10 are kept, 0 are lost"]
