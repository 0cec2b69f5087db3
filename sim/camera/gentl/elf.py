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
Reference: System V ABI, "Object files" and "Program loading"; its x86-64 and AArch64 supplements.
"""

import platform
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

TABLE = "rtpiv_table"
IMPORTS = ("PyGILState_Ensure", "PyRun_SimpleString", "PyGILState_Release")
PAGE = 0x10000
GC_ERR_ERROR = -1001


@dataclass(frozen=True, slots=True)
class Machine:
    """Code and constants of one type of processor."""

    elf_machine: int
    relative: int  # relocation types
    glob_dat: int
    stub_bytes: int
    lazy_bytes: int
    stub: Callable[[int, int], bytes]  # (address of the stub, address of its pointer)
    lazy: Callable[[int, int, int], bytes]  # (address, index, address of boot)
    boot: Callable[[int, tuple[int, int, int], int, int], bytes]  # (address, imports, script, table)


def _x86_stub(at: int, pointer: int) -> bytes:
    return b"\xff\x25" + struct.pack("<i", pointer - (at + 6)) + b"\x90\x90"


def _x86_lazy(at: int, index: int, boot: int) -> bytes:
    return b"\x68" + struct.pack("<I", index) + b"\xe9" + struct.pack("<i", boot - (at + 10))


def _x86_boot(at: int, imports: tuple[int, int, int], script: int, table: int) -> bytes:
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


def _adrp(register: int, at: int, target: int) -> int:
    pages = (target >> 12) - (at >> 12)
    return 0x90000000 | ((pages & 3) << 29) | (((pages >> 2) & 0x7FFFF) << 5) | register


def _load(register: int, base: int, target: int) -> int:  # ldr Xregister, [Xbase, low 12 bits of target]
    return 0xF9400000 | (((target & 0xFFF) >> 3) << 10) | (base << 5) | register


def _add_low(register: int, target: int) -> int:  # add Xregister, Xregister, low 12 bits of target
    return 0x91000000 | ((target & 0xFFF) << 10) | (register << 5) | register


def _words(*words: int) -> bytes:
    return struct.pack(f"<{len(words)}I", *words)


def _arm_stub(at: int, pointer: int) -> bytes:
    return _words(_adrp(16, at, pointer), _load(17, 16, pointer), 0xD61F0220, 0xD503201F)  # br x17; nop


def _arm_lazy(at: int, index: int, boot: int) -> bytes:
    return _words(0x52800010 | (index << 5), 0x14000000 | (((boot - (at + 4)) >> 2) & 0x3FFFFFF))  # mov w16; b


def _arm_boot(at: int, imports: tuple[int, int, int], script: int, table: int) -> bytes:
    code: list[int] = []

    def call(pointer: int) -> None:
        code.append(_adrp(16, at + 4 * len(code), pointer))
        code.extend((_load(16, 16, pointer), 0xD63F0200))  # blr x16

    code += [0xA9B97BFD, 0x910003FD]  # stp x29, x30, [sp, #-112]!; mov x29, sp
    code += [0xA90107E0, 0xA9020FE2, 0xA90317E4, 0xA9041FE6]  # stp x0..x7, [sp, #16..]
    code += [0xF9002BF0]  # str x16, [sp, #80]
    call(imports[0])
    code += [0xB9005BE0]  # str w0, [sp, #88]
    code.append(_adrp(0, at + 4 * len(code), script))
    code.append(_add_low(0, script))
    call(imports[1])
    code += [0xB9005FE0, 0xB9405BE0]  # str w0, [sp, #92]; ldr w0, [sp, #88]
    call(imports[2])
    code += [0xB9405FF1, 0xF9402BF0]  # ldr w17, [sp, #92]; ldr x16, [sp, #80]
    # ldp x0..x7; ldp x29, x30, [sp], #112
    code += [0xA94107E0, 0xA9420FE2, 0xA94317E4, 0xA9441FE6, 0xA8C77BFD]
    code += [0x35000000 | (5 << 5) | 17]  # cbnz w17, failed
    code.append(_adrp(17, at + 4 * len(code), table))
    code += [_add_low(17, table), 0xF8707A31, 0xD61F0220]  # ldr x17, [x17, x16, lsl #3]; br x17
    code += [0x12807D00, 0xD65F03C0]  # failed: mov w0, #GC_ERR_ERROR; ret
    return _words(*code)


MACHINES = {
    "x86_64": Machine(62, 8, 6, 8, 10, _x86_stub, _x86_lazy, _x86_boot),
    "aarch64": Machine(183, 1027, 1025, 16, 8, _arm_stub, _arm_lazy, _arm_boot),
}


def build(functions: Sequence[str], script: str, machine: str | None = None) -> bytes:
    """Return the bytes of the library.

    Parameters
    ----------
    functions : sequence of str
        Names to export; their position is their index in the table.
    script : str
        Python source that fills the exported pointer table `TABLE`.
    machine : str, optional
        "x86_64" or "aarch64"; default is the machine this runs on.

    Raises
    ------
    ValueError
        If this processor is not covered.
    """
    name = machine or platform.machine()
    if name not in MACHINES:
        raise ValueError(f"no jump table for the processor {name!r}; use one of {', '.join(MACHINES)}")
    cpu = MACHINES[name]
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
    stubs = [text + cpu.stub_bytes * index for index in range(count)]
    lazies = [text + cpu.stub_bytes * count + cpu.lazy_bytes * index for index in range(count)]
    boot = _align(text + (cpu.stub_bytes + cpu.lazy_bytes) * count, 16)
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

    place(0, _headers(cpu, code_end, data_file, len(image), dynamic))
    place(dynsym, b"".join(_symbols(name_at, stubs, table, count)))
    place(hashes, struct.pack("<III", 1, len(names), 1))
    place(hashes + 12, struct.pack(f"<{len(names)}I", 0, *range(2, len(names)), 0))
    relocations = [
        struct.pack("<QQq", pointer, cpu.relative, lazy) for pointer, lazy in zip(pointers, lazies, strict=True)
    ]
    first_import = count + 2
    relocations += [
        struct.pack("<QQq", slot, ((first_import + index) << 32) | cpu.glob_dat, 0)
        for index, slot in enumerate(import_slots)
    ]
    place(rela, b"".join(relocations))
    place(dynstr, bytes(strings))
    for index in range(count):
        place(stubs[index], cpu.stub(stubs[index], pointers[index]))
        place(lazies[index], cpu.lazy(lazies[index], index, boot))
    place(boot, cpu.boot(boot, import_slots, script_at, table))
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


def _headers(cpu: Machine, code_end: int, data_file: int, file_end: int, dynamic: int) -> bytes:
    identity = b"\x7fELF\x02\x01\x01" + bytes(9)
    head = identity + struct.pack("<HHIQQQIHHHHHH", 3, cpu.elf_machine, 1, 0, 64, 0, 0, 64, 56, 4, 64, 0, 0)
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
