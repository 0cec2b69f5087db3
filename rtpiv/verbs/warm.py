"""`rtpiv setup warm`: compile all kernels now, for an image or a cluster."""

from ground.terminal import console, progress
from rtpiv.command_line.first_use import calls_of, compile_call


def warm() -> int:
    """Compile, or find compiled, what the verbs call for scenes of balls; on all cores.

    It is compiled for this very processor, also where code for its kind came with the wheel, which is a little
    slower.  The folder is that of all compiled code: RTPIV_CACHE, else the user's cache folder.  Commands that
    find it there need not be able to write to it.

    Returns
    -------
    int
        Kernels that are now ready.
    """
    import ground.jit.compiler as compiler  # and numba with it

    compiler.use_shipped = False
    calls = calls_of("warm")
    for call in progress(calls, len(calls), "compiling"):
        compile_call(call)
    console().print(f"{len(calls)} kernels are ready")
    return len(calls)
