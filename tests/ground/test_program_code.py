"""What is kept is believed by the code that made it alone."""

import pytest

import ground.program_code as program_code
from ground.program_code import code_digest


@pytest.fixture
def program(tmp_path, monkeypatch):
    """A program of two packages; digests are taken anew each time."""
    monkeypatch.setattr(program_code, "ROOT", tmp_path)
    for name in ("rays/trace.py", "rays/kernels/sphere.py", "pages/colours.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"n = 1.5\nr = 2\n")
    yield tmp_path
    code_digest.cache_clear()


def digest(*parts):
    code_digest.cache_clear()
    return code_digest(*parts)


@pytest.mark.parametrize("name", ["rays/trace.py", "rays/kernels/sphere.py"])
def test_an_edit_anywhere_below_is_another_code(program, name):
    before, of_pages = digest("rays"), digest("pages")
    (program / name).write_bytes(b"n = 1.6\nr = 2\n")
    assert digest("rays") != before
    assert digest("pages") == of_pages
    assert digest("rays", "pages") not in (digest("rays"), of_pages)


def test_a_file_that_comes_goes_or_moves_is_another_code(program):
    seen = [digest("rays")]
    (program / "rays" / "window.py").touch()
    seen.append(digest("rays"))
    (program / "rays" / "window.py").rename(program / "rays" / "tube.py")
    seen.append(digest("rays"))
    (program / "rays" / "trace.py").unlink()
    seen.append(digest("rays"))
    assert len(set(seen)) == 4


def test_ends_of_lines_are_not_code(program):
    before = digest("rays")
    (program / "rays" / "trace.py").write_bytes(b"n = 1.5\r\nr = 2\r\n")
    assert digest("rays") == before


def test_a_process_has_one_code(program):
    before = digest("rays")
    (program / "rays" / "trace.py").write_bytes(b"n = 1.6\n")
    assert code_digest("rays") == before  # it computes with what it has imported
