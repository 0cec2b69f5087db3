"""Write a shared library whose functions are Python, without a compiler.

A GenTL producer is an ELF library with the extension .cti and some sixty C functions.  Here each of them is one
instruction, a jump through a table of pointers in the library's data:

    GCInitLib:  jmp *table[3]        table[3] -> lazy 3:  remember "3", go to boot

At first every pointer leads to ``boot``, which saves the arguments, takes Python's lock, runs a line of Python
that is stored in the library, gives the lock back and jumps through the table again.  That line of Python loads
the producer and replaces all pointers by ctypes callbacks, so ``boot`` runs once and later calls cost one jump.
Booting at the first call, and not while the library is loaded, keeps the dynamic linker's lock out of it.

The library imports PyGILState_Ensure, PyRun_SimpleString and PyGILState_Release: it can be opened in any
process that runs CPython, and in no other.  If the line of Python fails, every function returns GC_ERR_ERROR.

Layout: one read-execute segment (headers, symbols, SysV hash, relocations, code, script) and one read-write
segment (dynamic section, imports, table) whose addresses lie one 64 KiB page further on.
Why this and not C: docs/adr/0008-gentl-producer-without-a-compiler.md.
Reference: System V ABI, "Object files" and "Program loading"; its x86-64 supplement.
"""

import platform
import struct
from collections.abc import Sequence

TABLE = "rtpiv_table"
IMPORTS = ("PyGILState_Ensure", "PyRun_SimpleString", "PyGILState_Release")
PAGE = 0x10000
GC_ERR_ERROR = -1001
MACHINE = "x86_64"  # the processor that the code is for
STUB_BYTES, LAZY_BYTES = 8, 10
RELATIVE, GLOB_DAT = 8, 6  # relocation types


def _stub(at: int, pointer: int) -> bytes:
    return b"\xff\x25" + struct.pack("<i", pointer - (at + 6)) + b"\x90\x90"


def _lazy(at: int, index: int, boot: int) -> bytes:
    return b"\x68" + struct.pack("<I", index) + b"\xe9" + struct.pack("<i", boot - (at + 10))


def _boot(at: int, imports: tuple[int, int, int], script: int, table: int) -> bytes:
    code = bytearray()

    def relative(opcode: bytes, target: int) -> None:
        code.extend(opcode + struct.pack("<i", target - (at + len(code) + len(opcode) + 4)))

    code += bytes.fromhex("57 56 52 51 4150 4151 53 4883ec08")  # push rdi rsi rdx rcx r8 r9 rbx; sub rsp, 8
    relative(b"\xff\x15", imports[0])  # call [PyGILState_Ensure]
    code += bytes.fromhex("89c3")  # mov ebx, eax
    relative(b"\x48\x8d\x3d", script)  # lea rdi, [script]
    relative(b"\xff\x15", imports[1])  # call [PyRun_SimpleString]
    code += bytes.fromhex("48890424 89df")  # mov [rsp], rax; mov edi, ebx
    relative(b"\xff\x15", imports[2])  # call [PyGILState_Release]
    code += bytes.fromhex("415b 5b 4159 4158 59 5a 5e 5f 58")  # pop r11 rbx r9 r8 rcx rdx rsi rdi rax(index)
    code += bytes.fromhex("4585db 750b")  # test r11d, r11d; jnz failed
    relative(b"\x4c\x8d\x15", table)  # lea r10, [table]
    code += bytes.fromhex("41ff24c2")  # jmp [r10 + 8 rax]
    code += b"\xb8" + struct.pack("<i", GC_ERR_ERROR) + b"\xc3"  # failed: mov eax, GC_ERR_ERROR; ret
    return bytes(code)


def build(functions: Sequence[str], script: str) -> bytes:
    """Return the bytes of the library.

    Parameters
    ----------
    functions : sequence of str
        Names to export; their position is their index in the table.
    script : str
        Python source that fills the exported pointer table `TABLE`.

    Raises
    ------
    ValueError
        If this processor is not covered.
    """
    if platform.machine() != MACHINE:
        raise ValueError(f"no jump table for the processor {platform.machine()!r}, only for {MACHINE}")
    names = ["", *functions, TABLE, *IMPORTS]
    strings = bytearray()
    name_at = [_append(strings, text.encode() + b"\0") for text in names]
    soname_at = _append(strings, b"rtpiv.cti\0")
    count = len(functions)

    at = 64 + 56 * 4
    dynsym, at = at, at + 24 * len(names)
    hashes, at = at, at + 4 * (2 + 1 + len(names))
    rela, at = _align(at, 8), _align(at, 8) + 24 * (count + len(IMPORTS))
    dynstr, at = at, at + len(strings)
    text = _align(at, 16)
    stubs = [text + STUB_BYTES * index for index in range(count)]
    lazies = [text + STUB_BYTES * count + LAZY_BYTES * index for index in range(count)]
    boot = _align(text + (STUB_BYTES + LAZY_BYTES) * count, 16)
    script_at = boot + 256
    script_bytes = script.encode() + b"\0"
    code_end = script_at + len(script_bytes)
    data_file = _align(code_end, 64)
    dynamic = data_file + PAGE
    imports_at = dynamic + 16 * 10
    table = imports_at + 8 * len(IMPORTS)
    pointers = [table + 8 * index for index in range(count)]
    import_slots = (imports_at, imports_at + 8, imports_at + 16)

    image = bytearray(data_file + 16 * 10 + 8 * (len(IMPORTS) + count))

    def place(where: int, data: bytes) -> None:
        image[where : where + len(data)] = data

    place(0, _headers(code_end, data_file, len(image), dynamic))
    place(dynsym, b"".join(_symbols(name_at, stubs, table, count)))
    place(hashes, struct.pack("<III", 1, len(names), 1))
    place(hashes + 12, struct.pack(f"<{len(names)}I", 0, *range(2, len(names)), 0))
    relocations = [
        struct.pack("<QQq", pointer, RELATIVE, lazy) for pointer, lazy in zip(pointers, lazies, strict=True)
    ]
    first_import = count + 2
    relocations += [
        struct.pack("<QQq", slot, ((first_import + index) << 32) | GLOB_DAT, 0)
        for index, slot in enumerate(import_slots)
    ]
    place(rela, b"".join(relocations))
    place(dynstr, bytes(strings))
    for index in range(count):
        place(stubs[index], _stub(stubs[index], pointers[index]))
        place(lazies[index], _lazy(lazies[index], index, boot))
    place(boot, _boot(boot, import_slots, script_at, table))
    place(script_at, script_bytes)
    entries = [(4, hashes), (5, dynstr), (6, dynsym), (7, rela), (8, 24 * len(relocations)), (9, 24)]
    entries += [(10, len(strings)), (11, 24), (14, soname_at), (0, 0)]
    place(data_file, b"".join(struct.pack("<QQ", tag, value) for tag, value in entries))
    return bytes(image)


def _symbols(name_at: list[int], stubs: list[int], table: int, count: int) -> list[bytes]:
    """Null, exported functions, the table, imports."""
    symbols = [bytes(24)]
    for index in range(count):
        symbols.append(struct.pack("<IBBHQQ", name_at[1 + index], 0x12, 0, 1, stubs[index], 8))
    symbols.append(struct.pack("<IBBHQQ", name_at[1 + count], 0x11, 0, 1, table, 8 * count))
    symbols += [
        struct.pack("<IBBHQQ", name_at[2 + count + index], 0x10, 0, 0, 0, 0) for index in range(len(IMPORTS))
    ]
    return symbols


def _headers(code_end: int, data_file: int, file_end: int, dynamic: int) -> bytes:
    identity = b"\x7fELF\x02\x01\x01" + bytes(9)
    head = identity + struct.pack("<HHIQQQIHHHHHH", 3, 62, 1, 0, 64, 0, 0, 64, 56, 4, 64, 0, 0)
    size = file_end - data_file
    segments = (
        (1, 5, 0, 0, code_end, PAGE),  # read, execute
        (1, 6, data_file, dynamic, size, PAGE),  # read, write
        (2, 6, data_file, dynamic, 16 * 10, 8),  # dynamic section
        (0x6474E551, 6, 0, 0, 0, 16),  # no executable stack
    )
    return head + b"".join(
        struct.pack("<IIQQQQQQ", kind, flags, offset, address, address, length, length, align)
        for kind, flags, offset, address, length, align in segments
    )


def _append(data: bytearray, more: bytes) -> int:
    at = len(data)
    data += more
    return at


def _align(value: int, step: int) -> int:
    return -(-value // step) * step
