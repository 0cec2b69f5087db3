"""Open a stream of libaravis that has heard nobody but its own camera.

Where it may (capability CAP_NET_RAW), libaravis reads packets from a raw socket with a ring of 32 MB, which loses
far less than a plain one.  It binds that socket first and attaches the filter for its camera's address after, so
whatever crosses the interface in between is taken for the camera's: the foreign packet's block id becomes the
last id seen, and the camera's own frames are dropped as late ones, for as long as the stream lives and without
an error (libaravis 0.8.26 to 0.8.36, `_ring_buffer_loop` and `_find_frame_data` of arvgvstream.c).

Before the acquisition starts our camera sends nothing, so a stream that has received a packet by then is spoilt
and is opened anew.  The ring hands a packet on within 5 ms (`tp_retire_blk_tov`); after SETTLE_S it was counted.
Where an interface is so busy that it goes wrong again and again, a plain socket, which the kernel filters from
its first packet on, takes its place.
"""

import time

from daq.cameras.libaravis import call

SETTLE_S = 0.015
RAW_ATTEMPTS = 4
NO_OPTION, PLAIN_SOCKET = 0, 1  # ArvGvStreamOption


def open_stream(device: int) -> int:
    """Address of a new ArvStream of this ArvGvDevice; no buffer is in it, and no packet was."""
    for _ in range(RAW_ATTEMPTS):
        stream = int(call("arv_device_create_stream", device, None, None))
        time.sleep(SETTLE_S)
        if not call("arv_stream_get_info_uint64_by_name", stream, b"n_received_packets"):
            return stream
        call("g_object_unref", stream)
    call("arv_gv_device_set_stream_options", device, PLAIN_SOCKET)
    try:
        return int(call("arv_device_create_stream", device, None, None))
    finally:
        call("arv_gv_device_set_stream_options", device, NO_OPTION)


def open_plain_stream(device: int) -> int:
    """Address of a new ArvStream of a device that sends no packets over a network."""
    return int(call("arv_device_create_stream", device, None, None))
