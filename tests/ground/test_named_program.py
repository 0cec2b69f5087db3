"""A name in a file: what rtpiv ships, a program of others, or neither; whose fault it is stays visible."""

import pytest

from ground.errors import UntrustedProgram
from ground.named_program import VARIABLE, UnknownName, program_of

SHIPPED = {"join": "posixpath:join"}


def test_a_name_is_ours_or_of_others_or_unknown(monkeypatch):
    monkeypatch.setenv(VARIABLE, "posixpath:split")
    assert program_of("join", SHIPPED).__name__ == "join"
    assert program_of("posixpath:split", SHIPPED).__name__ == "split"
    with pytest.raises(UnknownName):
        program_of("joined", SHIPPED)
    with pytest.raises(UntrustedProgram):
        program_of("posixpath:dirname", SHIPPED)


def test_a_driver_of_others_that_fails_while_it_loads_is_not_called_unknown(monkeypatch, tmp_path):
    (tmp_path / "their_driver.py").write_text("{}['PORT']\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(VARIABLE, "their_driver:Box")
    with pytest.raises(KeyError, match="PORT"):
        program_of("their_driver:Box", SHIPPED)
