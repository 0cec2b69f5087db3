"""Bandwidth of a camera's link, from the camera's settings or the bench file.

    DeviceLinkThroughputLimit   [byte/s], unless DeviceLinkThroughputLimitMode is Off
    DeviceLinkSpeed             [byte/s]
    GevLinkSpeed                [Mbit/s] of GigE Vision cameras
    GevSCPSPacketSize           [byte] of a packet, with 36 of headers (IP, UDP, stream)

On an Ethernet cable every packet takes 38 bytes more: preamble, frame header, checksum and the gap behind it.  So
one gigabit carries 119 MB/s of pixels in packets of 1500 bytes and 124 MB/s in packets of 9000.  A link that is
slower than `SLOWEST_BYTES_S` is taken for another unit: some cameras report megabits under these names.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Literal

from daq.cameras.camera import Setting

LinkName = Literal["1GigE", "2.5GigE", "5GigE", "10GigE", "USB3"]
MBITS: dict[str, float] = {"1GigE": 1000.0, "2.5GigE": 2500.0, "5GigE": 5000.0, "10GigE": 10_000.0}
USB3_BYTES_S = 400e6  # of 5 Gbit/s, after its 8b/10b code and the protocol
SLOWEST_BYTES_S = 1e6
USABLE = 0.95  # the rest is for packets that are sent again, and for everything that is no picture
HEADERS_BYTES, CABLE_BYTES, USUAL_PACKET_BYTES = 36, 38, 1500
PACKET_SIZE = "GevSCPSPacketSize"


def link_capacity_bytes_s(settings: Mapping[str, Setting], link: LinkName | None = None) -> float:
    """Pixels that fit through the link in a second [byte/s]; 0 if not known.

    Parameters
    ----------
    settings : mapping
        What the camera read back, or what it is to be set to.
    link : str, optional
        What the bench file says of the cable.
    """
    mbits = [each for each in (MBITS.get(link or "", 0.0), first_of(settings, ("GevLinkSpeed",))) if each]
    packets = _share_of_packets(settings)
    speed_bytes_s = first_of(settings, ("DeviceLinkSpeed",))
    limits = [min(mbits, default=0.0) * 1e6 / 8 * packets * USABLE]
    limits.append(USB3_BYTES_S * USABLE if link == "USB3" else 0.0)
    limits.append(speed_bytes_s * (packets if PACKET_SIZE in settings else 1.0) * USABLE)
    limits.append(limit_bytes_s(settings))
    return min((each for each in limits if each >= SLOWEST_BYTES_S), default=0.0)


def link_speed_bytes_s(settings: Mapping[str, Setting]) -> float:
    """The link's speed as the camera tells it, without any loss; 0 if it does not tell."""
    rate = limit_bytes_s(settings) or first_of(settings, ("DeviceLinkSpeed",))
    if rate < SLOWEST_BYTES_S:
        rate = first_of(settings, ("GevLinkSpeed",)) * 1e6 / 8
    return rate if rate >= SLOWEST_BYTES_S else 0.0


def limit_bytes_s(settings: Mapping[str, Setting]) -> float:
    """Throughput limit that is set in the camera; 0 if none."""
    if settings.get("DeviceLinkThroughputLimitMode", "On") != "On":
        return 0.0
    return first_of(settings, ("DeviceLinkThroughputLimit",))


def first_of(settings: Mapping[str, Setting], names: Iterable[str]) -> float:
    """First of some settings that is a positive number; 0 if none is."""
    for name in names:
        value = settings.get(name)
        if isinstance(value, int | float) and math.isfinite(value) and value > 0:
            return float(value)
    return 0.0


def _share_of_packets(settings: Mapping[str, Setting]) -> float:
    """Pixels' share of what goes over an Ethernet cable."""
    packet_bytes = first_of(settings, (PACKET_SIZE,)) or USUAL_PACKET_BYTES
    return max(0.0, packet_bytes - HEADERS_BYTES) / (packet_bytes + CABLE_BYTES)
