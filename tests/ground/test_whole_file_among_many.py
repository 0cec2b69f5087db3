"""Two who write one file at the same time: it is whole at any moment, and the last one's in the end."""

import pytest

from ground.whole_file import whole_file


def test_whoever_is_ready_last_gives_the_file_its_contents(tmp_path):
    path = tmp_path / "file"
    with whole_file(path, among_many=True) as slow:
        slow.write(b"slow begins, ")
        with whole_file(path, among_many=True) as fast:
            fast.write(b"fast")
        assert path.read_bytes() == b"fast"
        slow.write(b"and ends")
    assert path.read_bytes() == b"slow begins, and ends"
    with pytest.raises(ZeroDivisionError), whole_file(path, among_many=True) as torn:
        torn.write(bytes(1 // 0))
    assert [file.name for file in tmp_path.iterdir()] == ["file"]
