"""What a link carries, counted packet by packet with plain integers."""

import pytest

from daq.cameras.link import USABLE, link_capacity_bytes_s, link_speed_bytes_s
from tests.loops import loop_over


def pixels_in_a_second(mbits, packet_bytes):
    """Whole packets that fit through a cable, and their pixels."""
    on_the_cable = 8 + 14 + packet_bytes + 4 + 12  # preamble, frame header, IP packet, checksum, gap
    packets = mbits * 1_000_000 // 8 // on_the_cable
    return packets * (packet_bytes - 20 - 8 - 8)


@loop_over("packet_bytes", [576, 1500, 8000, 9000])
@loop_over("link, mbits", [("1GigE", 1000), ("2.5GigE", 2500), ("10GigE", 10000)])
def test_packets_on_an_ethernet_cable(link, mbits, packet_bytes):
    expected = USABLE * pixels_in_a_second(mbits, packet_bytes)
    settings = {"GevSCPSPacketSize": packet_bytes}
    assert link_capacity_bytes_s(settings, link) == pytest.approx(expected, rel=1e-4)
    assert link_capacity_bytes_s(settings | {"GevLinkSpeed": mbits}) == pytest.approx(expected, rel=1e-4)
    assert link_capacity_bytes_s(settings | {"DeviceLinkSpeed": mbits * 125_000}) == pytest.approx(
        expected, rel=1e-4
    )


def test_the_slowest_of_what_is_told_counts():
    settings = {"GevSCPSPacketSize": 9000, "GevLinkSpeed": 1000}
    slow = link_capacity_bytes_s(settings)
    assert link_capacity_bytes_s(settings, "10GigE") == slow  # negotiated lower than the cable could
    assert link_capacity_bytes_s(settings | {"DeviceLinkThroughputLimit": 50_000_000}) == 50_000_000
    off = {"DeviceLinkThroughputLimit": 50_000_000, "DeviceLinkThroughputLimitMode": "Off"}
    assert link_capacity_bytes_s(settings | off) == slow
    assert 350e6 < link_capacity_bytes_s({}, "USB3") < 400e6


@pytest.mark.parametrize("settings", [{}, {"DeviceLinkSpeed": 1000}, {"GevLinkSpeed": 0}, {"GevLinkSpeed": "fast"},
                                      {"DeviceLinkSpeed": float("nan")}])  # fmt: skip
def test_who_tells_nothing_of_use_is_not_judged(settings):
    assert link_capacity_bytes_s(settings) == 0.0
    assert link_speed_bytes_s(settings) == 0.0
