"""Identify the device on a port: questions of every grammar at usual rates, until one is answered.

    found = probe("/dev/ttyUSB0")       # Found(box, identity, baud, facts, unknown, lines), and the dialogue

**Nothing moves and nothing fires.** What is sent are questions alone; the list `QUESTIONS` and what each follows
up with is all there is, and a test holds that no emulated box changes by any of it.  Opening a port is not nothing
for some boards: a Grbl board may restart when the system raises DTR, and has to be homed then.

Every byte is kept with its time and rate (`dialogue`), as a text that a lab can send
(`stages.dialogue`).
"""

import re
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field

from daq.timing.protocols import pivlab_synchroniser as pivlab
from daq.timing.protocols import quantum_composers as qc
from stages.clock import SYSTEM_CLOCK, Clock
from stages.dialogue import Dialogue
from stages.errors import NoReply, ProtocolViolation
from stages.port import Port
from stages.protocols import apt_words, grbl, isel_dnc, pi_gcs2, thorlabs_apt, zaber_ascii
from stages.who_answers import OLD_GRBL, describe_reply, kind_of_box

RATES = (115_200, 38_400, 19_200, 9600, 57_600)
QUIET_S, LONGEST_S = 0.25, 1.5  # silence that ends an answer; how long one may last
WAKES_S = 2.5  # how long a board that was restarted by the opening may be deaf
CHAIN = range(2, 17)  # addresses of further PI controllers
ZABER_BINARY_ID = bytes((0, 50, 0, 0, 0, 0))  # "return device ID", to all; Binary manual, command 50


@dataclass(frozen=True)
class Found:
    """Device that answers on a port.

    Parameters
    ----------
    box : str
        Its kind, in words.
    identity : str
        What it says of itself.
    baud : int
        Rate at which it does.
    facts : tuple of str
        What else it has said: firmware, dialect, outputs, what runs now.
    unknown : tuple of str
        What it does not report, and a person has to know.
    lines : str
        Of a bench file.
    """

    box: str
    identity: str
    baud: int
    facts: tuple[str, ...]
    unknown: tuple[str, ...]
    lines: str


@dataclass
class Probe:
    """One port that is being asked; see `probe`."""

    url: str
    clock: Clock = SYSTEM_CLOCK
    dialogue: list[str] = field(default_factory=list)
    heard: bytes = b""  # everything, for the description of an unknown box
    port: Port | None = None

    def __post_init__(self) -> None:
        self._said = Dialogue(self.dialogue.append, self.clock)

    def look(self) -> Found | None:
        """Ask at every rate; None if nothing answers as it should."""
        deaf_s = WAKES_S
        for baud in RATES:
            self.port = Port(self.url, baud, clock=self.clock, hold_dtr=True)
            self._said.record_opening(baud)
            with closing(self.port):
                self._listen(deaf_s)
                deaf_s = 0.0
                for question in QUESTIONS:
                    if baud in question.bauds and (found := question.ask(self, baud)) is not None:
                        return found
        return None

    def ask(self, data: bytes, limit_s: float = LONGEST_S) -> bytes:
        """Send a question; return all that comes until it is quiet."""
        assert self.port is not None
        self._said.record_sent(data)
        self.port.write(data)
        return self._listen(QUIET_S, limit_s)

    def _listen(self, first_s: float, limit_s: float = LONGEST_S) -> bytes:
        assert self.port is not None
        said, end_s = b"", self.clock.now_s() + max(first_s, limit_s)
        patience_s = max(first_s, QUIET_S)
        with suppress(NoReply):
            while self.clock.now_s() < end_s:
                came = self.port.read(self.clock.now_s() + patience_s)
                self._said.came(came)
                said, patience_s = said + came, QUIET_S
        self.heard += said
        return said


@dataclass(frozen=True)
class Question:
    """Search for one kind of device: its baud rates, and the function that makes a `Found` of its answer."""

    bauds: Sequence[int]
    ask: Callable[[Probe, int], Found | None]


def probe(url: str, clock: Clock = SYSTEM_CLOCK) -> tuple[Found | None, Probe]:
    """Identify the device on a port; nothing moves, nothing fires, nothing is set.

    Parameters
    ----------
    url : str
        The port.
    clock : Clock
        Clock of every wait.

    Returns
    -------
    Found or None, Probe
        What answers; all that was said, in `dialogue`.

    Raises
    ------
    PortUnavailable, DeviceLost
        The port cannot be opened, or goes away meanwhile.
    """
    asked = Probe(url, clock)
    return asked.look(), asked


def no_reply_reason(asked: Probe) -> str:
    """Say, as a sentence, what came from a port on which nothing answers as it should."""
    rates = ", ".join(str(baud) for baud in RATES)
    kind = None if re.search(OLD_GRBL, asked.heard) else kind_of_box(asked.heard)
    what = f"sounds like {kind}, and gives no whole answer" if kind else describe_reply(asked.heard)
    return f"{asked.url} was asked by every grammar at {rates} baud and {what}"


# ---- the kinds ---------------------------------------------------------------------------------------

Lines = Sequence[str]


def _stage_lines(driver: str, url: str, baud: int, usual: int, identity: str, channels: Lines) -> str:
    rate = "" if baud == usual else f", baud: {baud}"
    tied = f', identity: "{identity}"' if identity else ""
    named = ", ".join(f'"{name}"' for name in channels)
    return (
        "stages:\n  controllers:\n"
        f"    box: {{driver: {driver}, port: {url}{rate}{tied}}}\n"
        f"  # axes.<name>: {{controller: box, channel: one of {named}, ...}}"
    )


MOTION = "what each motor carries, its scale, direction and limits"


def _zaber(asked: Probe, baud: int) -> Found | None:
    def replies(data: bytes) -> list[zaber_ascii.Reply]:
        return [
            each
            for each in zaber_ascii.AnswerStream().feed(asked.ask(data))
            if isinstance(each, zaber_ascii.Reply)
        ]

    devices = sorted({reply.device for reply in replies(zaber_ascii.Command("", checked=False).to_bytes())})
    if not devices:
        return None
    facts, channels, serials = [], [], []
    for device in devices:
        said = {}
        for name in ("deviceid", "system.serial", "version", "system.axiscount"):
            answer = replies(zaber_ascii.Command(f"get {name}", device, 0, checked=False).to_bytes())
            said[name] = answer[0].data if answer else "?"
        count = int(said["system.axiscount"]) if said["system.axiscount"].isdecimal() else 1
        channels += [f"{device}/{axis}" for axis in range(1, min(count, 9) + 1)]
        serials.append(said["system.serial"])
        facts.append(
            f"device {device}: id {said['deviceid']}, serial {said['system.serial']}, firmware {said['version']}, "
            f"{count} axes"
        )
    text = f"Zaber, ASCII protocol, {len(devices)} devices"
    lines = _stage_lines("zaber_ascii", asked.url, baud, 115_200, f"serial {serials[0]}", channels)
    return Found("Zaber devices", text, baud, tuple(facts), (MOTION,), lines)


def _zaber_binary(asked: Probe, baud: int) -> Found | None:
    said = asked.ask(ZABER_BINARY_ID)
    if not said or len(said) % 6 or any(said[at + 1] != 50 for at in range(0, len(said), 6)):
        return None
    devices = [(said[at], int.from_bytes(said[at + 2 : at + 6], "little")) for at in range(0, len(said), 6)]
    facts = tuple(f"device {number}: id {identity}" for number, identity in devices)
    cure = "# Binary is not spoken here: set the devices to ASCII at 115200 with Zaber's program, then probe again"
    return Found("Zaber devices in Binary", "Zaber, Binary protocol", baud, facts, (MOTION,), cure)


def _pi(asked: Probe, baud: int) -> Found | None:
    def text(data: bytes, limit_s: float = LONGEST_S) -> str:
        answers = [
            a for a in pi_gcs2.AnswerStream().feed(asked.ask(data, limit_s)) if isinstance(a, pi_gcs2.Answer)
        ]
        return " ".join(answers[0].lines) if len(answers) == 1 else ""

    asked.ask(pi_gcs2.Command("*IDN?").to_bytes(), QUIET_S)  # ends what was read at another rate
    identity = text(pi_gcs2.Command("*IDN?").to_bytes())
    if not re.search(r"(?i)physik instrumente|\bPI\b", identity) or identity.count(",") < 3:
        return None
    version = text(pi_gcs2.Command("CSV?").to_bytes()) or "?"
    axes = text(pi_gcs2.Command("SAI?").to_bytes()).split()
    facts = [f"command set {version}", f"axes {', '.join(axes) or '?'}"]
    channels, serial = list(axes), identity.split(",")[2].strip()
    for address in CHAIN:
        if other := text(pi_gcs2.Command("*IDN?", address=address).to_bytes(), QUIET_S):
            names = text(pi_gcs2.Command("SAI?", address=address).to_bytes()).split()
            facts.append(f"address {address}: {other}, axes {', '.join(names)}")
            channels = [name if "/" in name else f"1/{name}" for name in channels]
            channels += [f"{address}/{name}" for name in names]
    unknown = [MOTION, "whether a stage has a reference switch (asked when it is homed)"]
    lines = _stage_lines("pi_gcs2", asked.url, baud, 115_200, serial, channels)
    if re.fullmatch(r"\d\.\d+", version) and float(version) > 2.0:
        lines = "# GCS 3 is not spoken here, and is refused: put a controller of GCS 2 there (docs/devices.md)"
    return Found("PI controller", identity, baud, tuple(facts), tuple(unknown), lines)


def _grbl(asked: Probe, baud: int) -> Found | None:
    said = grbl.AnswerStream().feed(asked.ask(b"\n" + grbl.Line("$I").to_bytes()))
    status = grbl.AnswerStream().feed(asked.ask(grbl.RealTime(grbl.STATUS).to_bytes()))
    feedback = {each.kind: each.text for each in said if isinstance(each, grbl.Feedback)}
    state = next((each for each in status if isinstance(each, grbl.Status)), None)
    if "VER" not in feedback and state is None:
        return None
    facts = [f"{kind} {text}" for kind, text in feedback.items()]
    if state is not None:
        where = "" if state.machine else "; it reports work positions: set $10=1"
        facts.append(f"state {state.state}{where}")
        if state.state in ("Hold", "Door"):
            facts.append("it is held at the board and ignores all commands; release it there")
    family = next((name for name in ("GrblHAL", "FluidNC") if name.lower() in repr(facts).lower()), "Grbl")
    unknown = (MOTION, "whether it restarted when the port was opened: home it")
    name = feedback.get("VER", "").rpartition(":")[2]
    lines = _stage_lines("grbl", asked.url, baud, 115_200, name, ("X", "Y", "Z"))
    return Found(
        f"{family} board", f"Grbl {feedback.get('VER', 'without a version')}", baud, tuple(facts), unknown, lines
    )


def _isel(asked: Probe, baud: int) -> Found | None:
    asked.ask(isel_dnc.Identify().to_bytes(), QUIET_S)  # ends what was read at another rate
    said = asked.ask(isel_dnc.Identify().to_bytes())
    place = asked.ask(isel_dnc.AskPosition().to_bytes())
    try:
        text = isel_dnc.parse_identity(said).text
    except ProtocolViolation:
        text = ""
    is_old = said in (b"5", b"05") and re.fullmatch(rb"4|0([0-9A-Fa-f]{6}){1,3}", place)
    if not text and not is_old:
        return None
    facts = (f"position answer {place.decode('latin-1')!r}" + ("; not initialised" if place == b"4" else ""),)
    unknown = (MOTION, "which of two equal boxes it is: name its port by /dev/serial/by-id", "its largest speed")
    lines = _stage_lines("isel_dnc", asked.url, baud, 19_200, "", ("X", "Y", "Z"))
    return Found(
        "isel controller", text or "interface card C142 (it knows no version)", baud, facts, unknown, lines
    )


def _apt(asked: Probe, baud: int) -> Found | None:
    for to in (apt_words.UNIT, apt_words.RACK):
        order = thorlabs_apt.Order(apt_words.Kind.HW_REQ_INFO, to=to)
        for each in thorlabs_apt.IdentityStream(to).feed(asked.ask(order.to_bytes())):
            if isinstance(each, thorlabs_apt.Info):
                minor, interim, major = each.firmware
                model, is_rack = each.model.strip(), to == apt_words.RACK
                facts = (f"firmware {major}.{interim}.{minor}", f"{each.channels} channels")
                channels = [f"{'bay' if is_rack else ''}{n}" for n in range(1, max(1, each.channels) + 1)]
                lines = _stage_lines("thorlabs_apt", asked.url, baud, 115_200, f"serial {each.serial}", channels)
                identity = f"Thorlabs {model} serial {each.serial}"
                return Found("Thorlabs box", identity, baud, facts, (MOTION,), lines)
    return None


def _pulse_generator(asked: Probe, baud: int) -> Found | None:
    def text(keyword: str) -> str:
        answers = qc.AnswerStream().feed(asked.ask(qc.Command(keyword, asks=True).to_bytes()))
        return next((each.text for each in answers if isinstance(each, qc.Value)), "")

    identity = text("*IDN") or text("*IDN")  # the first ends what was read at another rate
    if ",DG645," in identity:
        lines = (
            f"devices:\n  laser:\n    {{kind: timing, box: srs_dg645, port: {asked.url}, baud: {baud},\n"
            "     channels: {q_switch_1: AB, q_switch_2: CD, camera: EF}, head: {max_rate_hz: ..}}"
        )
        return Found("delay generator", identity, baud, (), ("the device on each output",), lines)
    match = re.match(r"(?i)(QC|QUANTUM|BNC|BERKELEY)\w*,\s*(\d{3,4})", identity)
    if match is None:
        return None
    model = match[2]
    outputs = [word.strip()[-1] for word in text(":INST:CAT").split(",") if word.strip().upper().startswith("CH")]
    mode, word = text(":PULSE0:ICL:MOD"), text(":PULSE0:ICL")
    dialect = (
        "its clock has a mode (9530)" if mode else "its clock is one word (575, 952x)" if word else "no clock word"
    )
    running = [f"{name}" for n, name in enumerate(["T0", *outputs]) if text(f":PULSE{n}:STAT") == "1"]
    facts = (
        f"outputs {', '.join(outputs) or '?'}",
        f"{dialect}: {mode or word or '?'}",
        f"on now: {', '.join(running) or 'nothing'}",
        f"runs by itself at power-up: {text(':SYST:AUT') or 'it does not say'}",
    )
    names = {"951": "qc9510", "952": "qc9520", "953": "qc9530", "575": "bnc575", "577": "bnc577"}
    box = names.get(model[:3], "qc9520")
    rate = "" if baud == 38_400 else f", baud: {baud}"
    lines = (
        "devices:\n  laser:\n"
        f'    {{kind: timing, box: {box}, port: {asked.url}{rate}, identity: "{identity}",\n'
        "     channels: {q_switch_1: .., camera: ..}, head: {max_rate_hz: ..}}  # docs/laser.md"
    )
    unknown = ("the device on each output", "what arms a burst: rtpiv laser prove shows it")
    return Found("pulse generator", identity, baud, facts, unknown, lines)


def _synchroniser(asked: Probe, baud: int) -> Found | None:
    asked.ask(pivlab.Question("WhoAreYou?").to_bytes(), QUIET_S)  # ends what was read at another rate
    said = pivlab.AnswerStream().feed(asked.ask(pivlab.Question("WhoAreYou?").to_bytes()))
    names = [each.text for each in said if isinstance(each, pivlab.Identity)]
    if not names or not re.search(r"(?i)sync", names[0]):
        return None
    firmware = asked.ask(pivlab.Question("WhichFirmWare?").to_bytes()).decode("latin-1").strip()
    box = "pivlab_oltsync" if "oltSync:" in names[0] else "pivlab_xmsync"
    lines = (
        "devices:\n  laser:\n"
        f'    {{kind: timing, box: {box}, port: {asked.url}, identity: "{names[0]}", uncounted: true,\n'
        '     channels: {camera: "1", q_switch_1: "2"}, head: {max_rate_hz: ..}}  # docs/laser.md'
    )
    unknown = ("how many pulses have left: it does not count", "what it was loaded with: it cannot be read")
    return Found("PIVlab synchroniser", names[0], baud, (f"firmware {firmware or '?'}",), unknown, lines)


QUESTIONS = (
    Question((115_200,), _zaber),
    Question((115_200, 38_400, 19_200, 9600, 57_600), _pulse_generator),
    Question((115_200, 38_400, 19_200, 9600), _pi),
    Question((115_200, 57_600), _grbl),
    Question((115_200,), _apt),
    Question((19_200, 9600), _isel),
    Question((9600,), _synchroniser),
    Question((9600,), _zaber_binary),
)
