"""The simulated camera as a GigE Vision device on one address of this machine.

Three things happen: requests are answered (control thread), frames are sent (the camera's own thread, as the sink
of the device model), and a controlling client that falls silent for longer than the heartbeat timeout loses
control, and its stream stops.

Loopback only: the device binds to 127.x.y.z, answers every client and sends streams nowhere else.

It does not flood a plain UDP socket.  A real camera is slowed by its cable; a simulated one on the loopback is
not, and the kernel's default receive buffer (212 kB) is smaller than a frame.  On Linux the fill of the
receiver's queue can be read, so the camera waits while it is full.  A client that reads through a packet socket
never empties the queue of its UDP socket; if the queue does not shrink for a while, pacing gives up for this
stream.
"""

import ipaddress
import random
import select
import socket
import struct
import threading
import time
from collections import deque
from pathlib import Path

from sim.camera.config import CameraConfig
from sim.camera.device import MODEL, VENDOR, CameraGone, SimCamera, SimFrame
from sim.camera.features import XML_BASE
from sim.camera.gige import wire
from sim.camera.gige.wire import Command, Request, Status
from sim.camera.registers import BadAddress, BadValue, WriteProtected

TABLE = Path("/proc/net/udp")
FULL_BYTES = 50_000
QUEUE_PATIENCE_S = 0.05
NAP_S = 0.0002


class Pacer:
    """Waits for one receiver.

    Parameters
    ----------
    port : int
        UDP port of the receiver on this machine.
    """

    def __init__(self, port: int) -> None:
        self._mark = f":{port:04X} "
        self.is_useful = TABLE.exists()

    def wait(self) -> None:
        """Return when the receiver's queue has room, or when waiting turned out to be in vain."""
        if not self.is_useful:
            return
        deadline = time.monotonic() + QUEUE_PATIENCE_S
        lowest = self._read_queue_bytes()
        while lowest is not None and (now := self._read_queue_bytes()) is not None and now > FULL_BYTES:
            if now < lowest:
                lowest, deadline = now, time.monotonic() + QUEUE_PATIENCE_S
            if time.monotonic() > deadline:
                self.is_useful = False
                return
            time.sleep(NAP_S)

    def _read_queue_bytes(self) -> int | None:
        try:
            lines = TABLE.read_text().splitlines()
        except OSError:
            return None
        for line in lines[1:]:
            fields = line.split()
            if len(fields) > 4 and (fields[1] + " ").endswith(self._mark):
                return int(fields[4].split(":")[1], 16)
        return None


CCP, HEARTBEAT_MS, TIMESTAMP_CONTROL = 0x0A00, 0x0938, 0x0944
STREAM_PORT, STREAM_SIZE, STREAM_ADDRESS, STREAM_SOURCE_PORT = 0x0D00, 0x0D04, 0x0D18, 0x0D1C
WRITABLE = {CCP, HEARTBEAT_MS, TIMESTAMP_CONTROL, STREAM_PORT, STREAM_ADDRESS, 0x0954}
CAPABILITIES = 0xC0000000 | 0x00000006  # user name, serial number; packet resend, write memory
RESEND_BLOCKS = 16
BURST_PACKETS = 6
MAX_RESEND_PACKETS = 4096
REFUSALS: dict[type[Exception], Status] = {
    BadAddress: Status.INVALID_ADDRESS, WriteProtected: Status.WRITE_PROTECT, BadValue: Status.INVALID_PARAMETER,
}  # fmt: skip
Address = tuple[str, int]


class GigeDevice:
    """A GigE Vision camera.

    Parameters
    ----------
    config : CameraConfig
        The simulated camera.
    address : str
        Loopback address to live on; one device an address, for the port is fixed by the standard.
    is_discoverable : bool
        Answer discovery broadcasts of this machine too; for private network namespaces.
    """

    def __init__(self, config: CameraConfig, address: str = "127.0.0.1", is_discoverable: bool = False) -> None:
        if not ipaddress.IPv4Address(address).is_loopback:
            raise ValueError(f"{address} is not a loopback address; simulated cameras live on 127.0.0.0/8 only")
        self.address = address
        self.camera = SimCamera(config)
        self.resent_packets = 0
        self._loss = config.faults.packet_loss
        self._random = random.Random(config.faults.seed)
        self._owner: Address | None = None
        self._heard_s = 0.0
        self._last_write: tuple[Address, int, bytes] | None = None
        self._blocks: deque[wire.Block] = deque(maxlen=RESEND_BLOCKS)
        self._pacer: Pacer | None = None
        self._is_off = False
        self._write_bootstrap()
        self._control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._control.bind((address, wire.PORT))
            self._stream.bind((address, 0))
        except OSError:
            self._control.close()
            self._stream.close()
            self.camera.power_off()
            raise
        self._discovery = _broadcast_socket() if is_discoverable else None
        self._put(STREAM_SOURCE_PORT, self._stream.getsockname()[1])
        self.camera.sink = self._send_frame
        self.camera.on_lost = self._forget_client
        self._thread = threading.Thread(target=self._serve, name=f"gige {address}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Switch the camera off."""
        self._is_off = True
        self._thread.join(5.0)
        self.camera.power_off()
        self._control.close()
        self._stream.close()
        if self._discovery is not None:
            self._discovery.close()

    def __enter__(self) -> "GigeDevice":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # ---- bootstrap registers -------------------------------------------------------------------------------
    def _write_bootstrap(self) -> None:
        memory = self.camera.registers.bootstrap
        packed_ip = int(ipaddress.IPv4Address(self.address))
        numbers = {
            0x0000: 0x00010002,  # GigE Vision 1.2
            0x0004: 0x80000001,  # big-endian, UTF-8
            0x0008: 0x0200,  # a locally administered MAC address made from the IP address
            0x000C: packed_ip,
            0x0010: 0x00000005,
            0x0014: 0x00000005,
            0x0024: packed_ip,
            0x0034: 0xFF000000,
            0x0600: 1,
            0x0904: 1,
            0x0934: CAPABILITIES,
            HEARTBEAT_MS: 3000,
            0x093C: 0,
            0x0940: 1_000_000_000,  # time stamps tick in nanoseconds
        }
        for at, value in numbers.items():
            self._put(at, value)
        serial = self.camera.config.serial
        url = f"Local:rtpiv_camera.xml;{XML_BASE:X};{len(self.camera.registers.xml):X}"
        for at, text, length in (
            (0x0048, VENDOR, 32),
            (0x0068, MODEL, 32),
            (0x0088, "1.0", 32),
            (0x00D8, serial, 16),
            (0x0200, url, 512),
        ):
            memory[at : at + length] = text.encode()[: length - 1].ljust(length, b"\0")

    def _put(self, address: int, value: int) -> None:
        self.camera.registers.bootstrap[address : address + 4] = struct.pack(">I", value)

    def _get(self, address: int) -> int:
        return int(struct.unpack_from(">I", self.camera.registers.bootstrap, address)[0])

    # ---- control -------------------------------------------------------------------------------------------
    def _serve(self) -> None:
        while not self._is_off:
            datagram, sender = self._receive()
            is_silent = time.monotonic() - self._heard_s > self._get(HEARTBEAT_MS) / 1e3
            if self._owner is not None and is_silent and sender != self._owner:
                self._forget_client()
            request = wire.parse(datagram)
            if request is None or self.camera.is_lost:
                continue
            answer = self._answer(request, sender)
            if answer is not None and request.wants_answer:
                try:
                    self._control.sendto(answer, sender)
                except OSError:
                    continue

    def _receive(self) -> tuple[bytes, Address]:
        sockets = [self._control] if self._discovery is None else [self._control, self._discovery]
        ready, _, _ = select.select(sockets, [], [], 0.1)
        try:
            datagram, sender = ready[0].recvfrom(2048) if ready else (b"", ("", 0))
        except OSError:  # a client's socket is gone (ICMP); the next datagram is as good as any
            return b"", ("", 0)
        if ready and ready[0] is self._discovery and not sender[0].startswith("127."):
            return b"", ("", 0)
        return datagram, sender

    def _answer(self, request: Request, sender: Address) -> bytes | None:
        if sender == self._owner:
            self._heard_s = time.monotonic()
        if request.command == Command.RESEND:
            self._resend(request.payload, sender)
            return None
        is_write = request.command in (Command.WRITE_REGISTER, Command.WRITE_MEMORY)
        if is_write and self._last_write is not None and self._last_write[:2] == (sender, request.number):
            return self._last_write[2]  # our answer got lost; do not do it twice
        try:
            status, payload = self._execute(request, sender)
        except tuple(REFUSALS) as error:
            status, payload = REFUSALS[type(error)], b""
        except CameraGone:
            return None
        answer = wire.acknowledge(request, status, payload)
        if is_write:
            self._last_write = (sender, request.number, answer)
        return answer

    def _execute(self, request: Request, sender: Address) -> tuple[Status, bytes]:
        bad = (Status.INVALID_PARAMETER, b"")
        if request.command == Command.DISCOVERY:
            return Status.SUCCESS, bytes(self.camera.registers.bootstrap[:0xF8])
        if request.command == Command.READ_REGISTER:
            addresses = wire.read_addresses(request.payload)
            if addresses is None:
                return bad
            return Status.SUCCESS, b"".join(self.camera.read(address, 4) for address in addresses)
        if request.command == Command.READ_MEMORY:
            block = wire.read_block(request.payload)
            if block is None:
                return bad
            if block[0] % 4 or block[1] % 4:
                return Status.BAD_ALIGNMENT, b""
            return Status.SUCCESS, request.payload[:4] + self.camera.read(*block)
        if request.command == Command.WRITE_REGISTER:
            return self._write_all(wire.write_pairs(request.payload), sender)
        if request.command == Command.WRITE_MEMORY:
            written = wire.write_block(request.payload)
            return self._write_all(None if written is None else (written,), sender)
        return Status.NOT_IMPLEMENTED, b""

    def _write_all(self, writes: tuple[tuple[int, bytes], ...] | None, sender: Address) -> tuple[Status, bytes]:
        if writes is None:
            return Status.INVALID_PARAMETER, b""
        for address, data in writes:
            if address % 4:
                return Status.BAD_ALIGNMENT, b""
            if self._owner not in (None, sender) or (self._owner is None and address != CCP):
                return Status.ACCESS_DENIED, b""
            self._write(address, data, sender)
        return Status.SUCCESS, struct.pack(">HH", 0, len(writes))

    def _write(self, address: int, data: bytes, sender: Address) -> None:
        if address not in WRITABLE:
            self.camera.write(address, data)
            if address == STREAM_SIZE and len(data) == 4 and data[0] & 0x80:
                self._send_test_packet()
            return
        if len(data) != 4:
            raise BadAddress(f"{len(data)} bytes at {address:#x}")
        value = int.from_bytes(data, "big")
        if address == STREAM_ADDRESS and value and not ipaddress.IPv4Address(value).is_loopback:
            raise BadValue("streams go to loopback addresses only")
        if address == HEARTBEAT_MS and value < 500:
            value = 500
        self._put(address, value)
        if address == CCP:
            self._owner = sender if value & 3 else None
            self._heard_s = time.monotonic()
            if self._owner is None:
                self._forget_client()
        if address == STREAM_PORT:
            self._pacer = Pacer(value & 0xFFFF) if value & 0xFFFF else None
        if address == TIMESTAMP_CONTROL and value & 2:
            now_ns = self.camera.now_ns()
            self._put(0x0948, now_ns >> 32)
            self._put(0x094C, now_ns & 0xFFFFFFFF)

    def _forget_client(self) -> None:
        self._owner = None
        for address in (CCP, STREAM_PORT, STREAM_ADDRESS):
            self._put(address, 0)
        self.camera.stop()

    # ---- stream --------------------------------------------------------------------------------------------
    def _target(self) -> Address | None:
        port, host = self._get(STREAM_PORT) & 0xFFFF, self._get(STREAM_ADDRESS)
        return (str(ipaddress.IPv4Address(host)), port) if port and host else None

    def _send_test_packet(self) -> None:
        target = self._target()
        if target is not None:
            size = self.camera.registers.integer("GevSCPSPacketSize")
            self._try_send([wire.test_packet(size)], target)

    def _send_frame(self, frame: SimFrame) -> None:
        target = self._target()
        if target is None:
            return
        size = self.camera.registers.integer("GevSCPSPacketSize")
        block = wire.Block(frame, size - wire.OVERHEAD_BYTES)
        self._blocks.append(block)
        pacer = self._pacer
        for number in range(block.last_packet + 1):
            if pacer is not None and number % BURST_PACKETS == 0:
                pacer.wait()
            if block.is_unsent(number) or (self._loss and self._random.random() < self._loss):
                continue
            self._try_send(list(block.packet(number)), target)

    def _resend(self, payload: bytes, sender: Address) -> None:
        target = self._target()
        wanted = wire.resend_request(payload)
        if wanted is None or target is None or self._owner is None or sender[0] != self._owner[0]:
            return  # clients ask from their stream's socket, so only the host can be compared
        block = next((entry for entry in self._blocks if entry.id == wanted.block_id), None)
        for number in range(wanted.first, min(wanted.last, wanted.first + MAX_RESEND_PACKETS) + 1):
            if block is None or number > block.last_packet or block.is_unsent(number):
                self._try_send([wire.unavailable(wanted.block_id, number)], target)
                return
            self.resent_packets += 1
            self._try_send(list(block.packet(number)), target)

    def _try_send(self, parts: list[bytes | memoryview], target: Address) -> None:
        try:
            self._stream.sendmsg(parts, [], 0, target)
        except OSError:
            return  # no receiver: the packet is lost, as on a cable


def _broadcast_socket() -> socket.socket:
    """Receive what is sent to 255.255.255.255; the port may be shared with other devices of this machine."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    receiver.bind(("255.255.255.255", wire.PORT))
    return receiver
