"""When the frames of a run were exposed, in seconds since the first of them.

The camera's own clock stamps every exposure to a microsecond or better, and drifts against the computer's by some
millionths.  It begins anew when the camera restarts, and two sessions of a run may have a reboot of the computer
between them.  So differences are the camera's as long as its clock went on, and the computer's across a break: by
the arrival of the frames within one session, and by the time of day between sessions.
"""

from collections.abc import Iterable, Sequence
from datetime import datetime

from daq.runs.journal_lines import Entry
from daq.runs.run_folder import frame_entries

JITTER_NS, DRIFT = 10_000_000_000, 1e-3  # by which arrivals may differ from a clock that went on: frames queue up


def exposure_times_s(entries: Sequence[Entry], numbers: Iterable[int]) -> dict[int, float | None]:
    """Return the time of each frame since the first one.

    Parameters
    ----------
    entries : sequence of dict
        Lines of the journal.
    numbers : iterable of int
        Frames, all of which are in the journal.

    Returns
    -------
    dict of int to float or None
        By number [s]; None for all if the camera has no clock.
    """
    frames, sessions, session_of = frame_entries(entries), [], {}
    for entry in entries:
        if entry["kind"] == "session":
            sessions.append(entry)
        elif entry["kind"] == "frame":
            session_of[entry["frame"]] = len(sessions) - 1
    wanted = sorted(numbers)
    if any(frames[number]["timestamp_ns"] == 0 for number in wanted):
        return dict.fromkeys(wanted)
    times: dict[int, float | None] = {}
    elapsed_ns, before = 0, None
    for number in wanted:
        if before is not None:
            places = [session_of[before], session_of[number]]
            arrived_ns = [frames[n]["received_ns"] for n in (before, number)]
            if places[0] != places[1]:
                elapsed_ns += _across(sessions, places, arrived_ns)
            else:
                by_camera = frames[number]["timestamp_ns"] - frames[before]["timestamp_ns"]
                by_computer = arrived_ns[1] - arrived_ns[0]
                off_ns = abs(by_camera - by_computer)
                went_on = by_camera > 0 and off_ns <= JITTER_NS + DRIFT * abs(by_computer)
                elapsed_ns += by_camera if went_on else by_computer
        times[number], before = elapsed_ns * 1e-9, number
    return times


def _across(sessions: Sequence[Entry], places: Sequence[int], arrived_ns: Sequence[int]) -> int:
    """Time between the arrivals of two frames of different sessions [ns]."""
    lines = [sessions[place] for place in places]
    if not all("monotonic_ns" in line for line in lines):  # an older run: the computer was not started in between
        return max(0, arrived_ns[1] - arrived_ns[0])
    day_ns = [round(1e9 * datetime.fromisoformat(line["utc"]).timestamp()) for line in lines]
    since_ns = [arrived - line["monotonic_ns"] for arrived, line in zip(arrived_ns, lines, strict=True)]
    return int(day_ns[1] + since_ns[1] - day_ns[0] - since_ns[0])
