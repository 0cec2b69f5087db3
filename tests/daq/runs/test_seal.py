"""Seals: whatever byte is changed, the record is refused."""

import json
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.runs.seal import SealBroken, add_seal, check_seal

RECORD = {"kind": "step", "step": 3, "measured_mm": {"a": 0.5001, "b": -2.0}, "tag": "x"}


@pytest.mark.parametrize("indent", [None, 1])
def test_a_sealed_record_is_json_with_one_key_more(indent):
    record = add_seal(json.dumps(RECORD, indent=indent).encode())
    tree = json.loads(record)
    seal = tree.pop("seal")
    assert tree == RECORD
    assert list(json.loads(record)) == [*RECORD, "seal"]
    before = record[: record.index(b'"seal"')].rstrip().removesuffix(b",")
    assert seal == f"{zlib.crc32(before):08x}"
    assert json.loads(check_seal(record + b"\n", required=True)) == RECORD


@given(st.data())
def test_any_change_is_refused_or_changes_nothing(data):
    record = add_seal(json.dumps(RECORD, separators=(",", ":")).encode())
    place = data.draw(st.integers(0, len(record) - 1))
    kind = data.draw(st.sampled_from(["replace", "insert", "delete"]))
    more = data.draw(st.binary(min_size=1, max_size=3)) if kind != "delete" else b""
    keep = place if kind == "insert" else place + 1
    damaged = record[:place] + more + record[keep:]
    try:
        read = check_seal(damaged, required=True)
    except SealBroken:
        return
    assert read == check_seal(record, required=True)


def test_a_record_without_seal_passes_only_where_none_is_required():
    record = json.dumps(RECORD).encode()
    assert check_seal(record, required=False) == record
    with pytest.raises(SealBroken, match="has no seal"):
        check_seal(record, required=True)
    with pytest.raises(SealBroken, match="does not agree"):
        check_seal(add_seal(record).replace(b"0.5001", b"0.5002"), required=False)
