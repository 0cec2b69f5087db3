"""The table of features: names and meaning of the GenICam Standard Features Naming Convention (SFNC 2.x).

Both the register map and the XML description are made from this table, so they cannot disagree.  Registers are
big-endian.  Feature registers start at FEATURE_BASE, 16 bytes apart (strings take 64); the bootstrap registers
below 0x1000 are those of GigE Vision.
"""

from dataclasses import dataclass

from sim.camera.packing import FORMATS

FEATURE_BASE = 0x10000
XML_BASE = 0x100000


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature and its register.

    Parameters
    ----------
    name, category : str
        SFNC name and category.
    kind : str
        "int", "float", "enum", "bool", "string" or "command"; "chunk" for a number that comes with frames.
    default : int, float or str
        Value after power-up; an enumeration's value is an entry's number.
    low, high : float or str
        Limits; a name stands for the feature that holds the limit.
    access : str
        "RW" or "RO".
    entries : mapping of str to int
        Entries of an enumeration.
    locked : bool
        Cannot be written while the stream is running.
    unit : str
        Unit shown to the user.
    selects : tuple of str
        Features that this one selects.
    address : int
        Fixed address (a bootstrap register); 0 takes the next free one.
    length : int
        Bytes of the register.
    shown : str
        Its name in the description of the camera; "" for `name`, None for a register without a feature.
    exists_while, writable_while : tuple of (str, tuple)
        Features with the entries (or numbers) that they must have for this one to be available, or not locked.
    is_per_entry : bool
        Whether it has a value of its own under each entry of its selector.
    """

    name: str
    category: str
    kind: str
    default: int | float | str = 0
    low: float | str = 0
    high: float | str = 0x7FFFFFFF
    access: str = "RW"
    entries: tuple[tuple[str, int], ...] = ()
    locked: bool = False
    unit: str = ""
    selects: tuple[str, ...] = ()
    address: int = 0
    length: int = 4
    shown: str | None = ""
    exists_while: "Conditions" = ()
    writable_while: "Conditions" = ()
    is_per_entry: bool = False


Conditions = tuple[tuple[str, tuple[str | int, ...]], ...]


def _enum(name: str, category: str, *entries: str, locked: bool = False, selects: tuple[str, ...] = ()) -> Feature:
    numbered = tuple((entry, number) for number, entry in enumerate(entries))
    return Feature(name, category, "enum", 0, entries=numbered, locked=locked, selects=selects)


def _text(name: str, access: str = "RO") -> Feature:
    return Feature(name, "DeviceControl", "string", "", access=access, length=64)


def _read_only(name: str, category: str, length: int = 4) -> Feature:
    return Feature(
        name, category, "int", 0, access="RO", high=2**63 - 1 if length == 8 else 2**31 - 1, length=length
    )


def _number(name: str, category: str, default: float, low: float, high: float, unit: str) -> Feature:
    return Feature(name, category, "float", default, low, high, unit=unit, length=8)


def _command(name: str, category: str) -> Feature:
    return Feature(name, category, "command")


CHUNKS = (  # their ids are CHUNK_ID_BASE and up
    "LineStatusAll", "CounterValue", "FramesPerTriggerCounter", "Timestamp", "ExposureTime",
)  # fmt: skip
FLOAT_CHUNKS = ("ExposureTime",)
CHUNK_ID_BASE, CHUNK_BYTES = 0xC001, 8
IMAGE_CHUNK_ID = 0xC000
CHUNK_FEATURES = (
    Feature("ChunkModeActive", "ChunkDataControl", "bool", 0, 0, 1, locked=True),
    _enum("ChunkSelector", "ChunkDataControl", *CHUNKS, selects=("ChunkEnable",)),
    Feature("ChunkEnable", "ChunkDataControl", "bool", 0, 0, 1, locked=True),
    *(Feature(f"Chunk{name}", "ChunkDataControl", "chunk", high=2**63 - 1, access="RO") for name in CHUNKS),
)
_FORMAT_ENTRIES = tuple((name, code) for name, (code, _, _) in FORMATS.items())

FEATURES: tuple[Feature, ...] = (
    _text("DeviceVendorName"),
    _text("DeviceModelName"),
    _text("DeviceVersion"),
    _text("DeviceSerialNumber"),
    _text("DeviceUserID", access="RW"),
    _command("DeviceReset", "DeviceControl"),
    _command("TimestampLatch", "DeviceControl"),
    _read_only("TimestampLatchValue", "DeviceControl", 8),
    Feature("DeviceTemperature", "DeviceControl", "float", 0.0, -100.0, 200.0, access="RO", unit="C", length=8),
    _read_only("SensorWidth", "ImageFormatControl"),
    _read_only("SensorHeight", "ImageFormatControl"),
    _read_only("WidthMax", "ImageFormatControl"),
    _read_only("HeightMax", "ImageFormatControl"),
    _read_only("OffsetXMax", "ImageFormatControl"),
    _read_only("OffsetYMax", "ImageFormatControl"),
    Feature("ReverseX", "ImageFormatControl", "bool", 0, 0, 1, locked=True),
    Feature("ReverseY", "ImageFormatControl", "bool", 0, 0, 1, locked=True),
    *(
        Feature(f"{name}{axis}", "ImageFormatControl", "int", 1, 1, 4, locked=True)
        for name in ("Binning", "Decimation")
        for axis in ("Horizontal", "Vertical")
    ),
    Feature("Width", "ImageFormatControl", "int", low=8, high="WidthMax", locked=True),
    Feature("Height", "ImageFormatControl", "int", low=1, high="HeightMax", locked=True),
    Feature("OffsetX", "ImageFormatControl", "int", low=0, high="OffsetXMax", locked=True),
    Feature("OffsetY", "ImageFormatControl", "int", low=0, high="OffsetYMax", locked=True),
    Feature(
        "PixelFormat", "ImageFormatControl", "enum", FORMATS["Mono12"][0], entries=_FORMAT_ENTRIES, locked=True
    ),
    _enum("AcquisitionMode", "AcquisitionControl", "Continuous", "SingleFrame", "MultiFrame"),
    Feature("AcquisitionFrameCount", "AcquisitionControl", "int", 1, 1, 65535),
    _command("AcquisitionStart", "AcquisitionControl"),
    _command("AcquisitionStop", "AcquisitionControl"),
    Feature("AcquisitionFrameRateEnable", "AcquisitionControl", "bool", 1, 0, 1),
    _number("AcquisitionFrameRate", "AcquisitionControl", 10.0, 0.01, 1000.0, "Hz"),
    _enum("ExposureMode", "AcquisitionControl", "Timed"),
    _number("ExposureTime", "AcquisitionControl", 1000.0, 1.0, 1e7, "us"),
    _enum(
        "TriggerSelector",
        "AcquisitionControl",
        "FrameStart",
        "FrameBurstStart",
        selects=("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerSoftware"),
    ),
    Feature("AcquisitionBurstFrameCount", "AcquisitionControl", "int", 2, 1, 255),
    _enum("TriggerMode", "AcquisitionControl", "Off", "On"),
    _enum("TriggerSource", "AcquisitionControl", "Software", "Line1"),
    _enum("TriggerActivation", "AcquisitionControl", "RisingEdge", "FallingEdge"),
    _command("TriggerSoftware", "AcquisitionControl"),
    Feature("DoubleFrameEnable", "AcquisitionControl", "bool", 0, 0, 1, locked=True),
    _enum("DoubleFrameLayout", "AcquisitionControl", "TwoBlocks", "OneBuffer", locked=True),
    _number("DoubleFrameInterval", "AcquisitionControl", 25.0, 1.0, 1e6, "us"),
    _enum("GainSelector", "AnalogControl", "All", selects=("Gain",)),
    _number("Gain", "AnalogControl", 0.0, 0.0, 24.0, "dB"),
    _enum("CounterSelector", "CounterAndTimerControl", "Counter0", selects=("CounterEventSource", "CounterValue")),
    _enum("CounterEventSource", "CounterAndTimerControl", "Off", "FrameTriggerMissed"),
    _read_only("CounterValue", "CounterAndTimerControl"),
    _command("CounterReset", "CounterAndTimerControl"),
    *CHUNK_FEATURES,
    _read_only("PayloadSize", "TransportLayerControl"),
    Feature("GevSCPSPacketSize", "TransportLayerControl", "int", 1400, 576, 9000, address=0x0D04),
    Feature("GevSCPD", "TransportLayerControl", "int", 0, 0, 0x7FFFFFFF, address=0x0D08),
)
