"""The library written without a compiler: through this machine's dynamic linker, and by its bytes."""

import ctypes
import platform
import struct
import subprocess
import sys

import pytest

from sim.camera.gentl.elf import MACHINE, TABLE, build

FILL = """
import ctypes
lib = ctypes.CDLL({path!r})
kind = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * 8)
calls = [kind(lambda *a, k=k: 1000 * k + sum(n * v for n, v in enumerate(a, 1))) for k in range(3)]
table = (ctypes.c_void_p * 3).in_dll(lib, {table!r})
for k in range(3):
    table[k] = ctypes.cast(calls[k], ctypes.c_void_p).value
import sys
sys.modules["rtpiv_elf_test_calls"] = (lib, calls)
"""

here = pytest.mark.skipif(platform.machine() != MACHINE, reason="no jump table for this processor")


@here
def test_first_call_boots_and_all_arguments_arrive(tmp_path):
    path = tmp_path / "three.cti"
    path.write_bytes(build(("first", "second", "third"), FILL.format(path=str(path), table=TABLE)))
    library = ctypes.CDLL(str(path))
    arguments = [ctypes.c_int64(value) for value in (1, 20, 300, 4000, 50000, 6, 7, 8)]
    total = 1 + 40 + 900 + 16000 + 250000 + 36 + 49 + 64
    assert [getattr(library, name)(*arguments) for name in ("third", "first", "second")] == [
        2000 + total, total, 1000 + total
    ]  # fmt: skip


@here
def test_a_failing_boot_is_an_error_code_and_not_a_crash(tmp_path):
    path = tmp_path / "broken.cti"
    path.write_bytes(build(("first",), "raise SystemError('no producer here')"))
    code = f"import ctypes; library = ctypes.CDLL({str(path)!r}); print(library.first(1), library.first(2))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["-1001", "-1001"]
    assert "no producer here" in done.stderr


@here
def test_headers_symbols_and_relocations_agree():
    names = [f"function_{index}" for index in range(60)]
    data = build(names, "pass")
    kind, cpu = struct.unpack_from("<HH", data, 16)
    assert (kind, cpu) == (3, 62)
    segments = [struct.unpack_from("<IIQQQQQQ", data, 64 + 56 * index) for index in range(4)]
    assert [segment[0] for segment in segments[:2]] == [1, 1]
    for _, flags, offset, address, _, size, _, align in segments[:2]:
        assert address % align == offset % align
        assert offset + size <= len(data)
        assert flags != 7  # nothing is writeable and executable
    dynamic = dict(struct.iter_unpack("<QQ", data[segments[2][2] : segments[2][2] + segments[2][5]]))
    assert dynamic[8] == 24 * (len(names) + 3)
    strings = data[dynamic[5] : dynamic[5] + dynamic[10]]
    symbols = [struct.unpack_from("<IBBHQQ", data, dynamic[6] + 24 * index) for index in range(len(names) + 5)]
    assert [strings[s[0] :].split(b"\0")[0].decode() for s in symbols[1 : 1 + len(names)]] == names
    table = symbols[1 + len(names)][4]
    relative = [struct.unpack_from("<QQq", data, dynamic[7] + 24 * index) for index in range(len(names))]
    assert [where for where, _, _ in relative] == [table + 8 * index for index in range(len(names))]


def test_unknown_processor_is_named(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(ValueError, match="riscv64"):
        build(("first",), "pass")
