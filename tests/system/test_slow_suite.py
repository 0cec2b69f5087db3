"""Shards of the slow suite: every file in one, none moved by a new file; what each has said last is kept."""

import datetime as dt
import json
import subprocess
import sys
import textwrap

import pytest

from tests.slow_suite import ROOT, SHARDS, balance, commit, main, shard_of, write

NOW = dt.datetime(2026, 11, 24, 12, 0, tzinfo=dt.UTC)
TAKES_S = {
    f"tests/test_{n}.py": float(s) for n, s in enumerate((900, 20, 30, 400, 300, 200, 10, 5, 500, 60, 70, 80))
}
TESTS = """
    import pytest

    @pytest.mark.slow
    @pytest.mark.parametrize("right", [True, False])
    def test_one(right):
        assert right

    @pytest.fixture
    def broken():
        yield
        raise RuntimeError("after the test")

    @pytest.mark.slow
    def test_two(broken):
        assert False

    @pytest.mark.slow
    def test_three():
        pytest.skip("no such thing here")

    def test_fast():
        assert False
"""


def result(commit, days_ago, *red):
    date = (NOW - dt.timedelta(days=days_ago)).isoformat(timespec="minutes")
    return {"commit": commit, "date": date, "passed": 3, "skipped": 0, "red": list(red), "took_s": {}}


def test_known_files_are_dealt_out_evenly_and_a_new_one_moves_no_other():
    of = {file: shard_of(file, TAKES_S, 4) for file in TAKES_S}
    load = [sum(s for file, s in TAKES_S.items() if of[file] == shard) for shard in range(1, 5)]
    assert set(of.values()) == {1, 2, 3, 4}
    assert max(load) == 900.0  # the longest file alone
    assert min(load) > 500.0
    assert shard_of("tests/test_new.py", TAKES_S, 4) in range(1, 5)
    assert {file: shard_of(file, TAKES_S, 4) for file in TAKES_S} == of
    spread = {shard_of(f"tests/test_new_{n}.py", TAKES_S, SHARDS) for n in range(200)}
    assert spread == set(range(1, SHARDS + 1))


def test_a_shard_counts_its_own_tests_and_keeps_what_they_say(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"test_{name}.py").write_text(textwrap.dedent(TESTS))
    kept = tmp_path / "kept.json"
    write(kept, {"takes_s": {"test_a.py": 9.0, "test_b.py": 1.0}, "last": {"2": result("abc1234", 1)}})
    code = f"""if True:
        import sys, pytest
        sys.path.insert(0, {str(ROOT)!r})
        from pathlib import Path
        from tests.slow_suite import Shard
        words = ["-m", "slow", "-q", "-c", "none.ini", "--rootdir", ".", "-p", "no:cacheprovider"]
        sys.exit(pytest.main(words, plugins=[Shard(1, {SHARDS}, Path("kept.json"))]))
    """
    (tmp_path / "none.ini").write_text("[pytest]\nmarkers = slow\n")
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 1, ran.stdout + ran.stderr
    assert "test_b" not in ran.stdout
    last = json.loads(kept.read_text("utf-8"))["last"]
    assert last["2"]["commit"] == "abc1234"  # of other shards nothing is lost
    assert last["1"]["red"] == ["test_a.py::test_one[False]", "test_a.py::test_two"]
    assert (last["1"]["passed"], last["1"]["skipped"]) == (1, 1)
    assert last["1"]["commit"] == commit()
    assert set(last["1"]["took_s"]) == {"test_a.py"}


def test_dealing_out_anew_takes_what_was_measured_and_forgets_what_is_gone():
    here = "tests/system/test_slow_suite.py"
    measured = result("abc1234", 0) | {"took_s": {here: 7, "tests/test_gone.py": 3}}
    kept = balance({"takes_s": {here: 900, "tests/conftest.py": 5}, "last": {"4": measured}})
    assert kept == {"takes_s": {here: 7, "tests/conftest.py": 5}, "last": {}}


@pytest.mark.parametrize("word", ["0/16", "17/16", "3", "three", "3/"])
def test_a_shard_that_is_none_is_refused_in_one_sentence(word):
    with pytest.raises(SystemExit, match="name one of all, as in SHARD=3/16"):
        main([word])
