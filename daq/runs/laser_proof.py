"""Record of the trials of a laser's timing unit, kept beside the bench file with the identity of the unit.

    bench.yaml  ->  bench.laser.proof.json     box, wiring, who, when, and what each trial has shown; sealed

The seal finds damage, not a person who edits it.  A proof of another box, of other wiring, or of a simulated box
proves nothing here; the operator is warned (`proof_sentence`).
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from daq.atomic_write import disk_errors, sync_folder
from daq.runs.seal import SealBroken, check_seal, write_record
from ground.plain_file import read_plain

LONGEST_BYTES = 100_000
COMMAND = "rtpiv laser prove"
ADDED = "camera_b"  # the box gives its pulses at the output of the camera


@dataclass(frozen=True, slots=True)
class Trial:
    """One thing that was tried: whether it is right (None: not observed), and what there is to say."""

    what: str
    is_right: bool | None
    said: str


@dataclass(frozen=True)
class Proof:
    """All trials of one box.

    Parameters
    ----------
    identity : str
        What the box says of itself.
    channels : mapping
        Output by role, as the bench file has it.
    simulated : bool
        Whether the box was one.
    who, utc : str
        Who has done it, and when.
    trials : tuple of Trial
        What was tried.
    counted : tuple of str
        Outputs whose pulses were counted.
    """

    identity: str
    channels: Mapping[str, str]
    simulated: bool
    who: str
    utc: str
    trials: tuple[Trial, ...]
    counted: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """True if every output was counted, and everything that was tried is right."""
        return bool(self.trials) and not self.failures

    @property
    def failures(self) -> list[str]:
        """Descriptions of trials that failed or were not observed."""
        outputs = {output for role, output in self.channels.items() if role != ADDED}
        wrong = [f"{trial.what}: {trial.said}" for trial in self.trials if not trial.is_right]
        return wrong + [f"output {output} was not counted" for output in sorted(outputs - set(self.counted))]


def proof_path(bench: Path, laser: str) -> Path:
    """File of the proof of a laser of a bench."""
    return bench.with_name(f"{bench.stem}.{laser}.proof.json")


def write_proof(path: Path, proof: Proof) -> None:
    """Keep a proof, with its seal; OSError if it cannot be written."""
    write_record(path, asdict(proof))


def withdraw_proof(path: Path) -> None:
    """Take a proof away, name included, before another one is begun: what ends halfway proves nothing.

    Raises
    ------
    DiskError
        It cannot be taken away.
    """
    with disk_errors(path, "the old proof is still there, so nothing was tried"):
        path.unlink(missing_ok=True)
        sync_folder(path.parent)


def read_proof(path: Path) -> Proof | None:
    """Return the proof that is kept there; None without one.

    Raises
    ------
    SealBroken
        It is damaged, or no proof.
    """
    try:
        raw = read_plain(path, LONGEST_BYTES)
    except OSError:
        return None
    try:
        tree = json.loads(check_seal(raw, required=True))
        trials = tuple(Trial(**trial) for trial in tree.pop("trials"))
        return Proof(**tree | {"counted": tuple(tree.get("counted", ()))}, trials=trials)
    except SealBroken:
        raise
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise SealBroken(f"is not a proof ({error})") from error


def proof_sentence(bench: Path, laser: str, identity: str, channels: Mapping[str, str], simulated: bool) -> str:
    """Say what is proven of the box that is open now, for the person who is asked for the code."""
    try:
        proof = read_proof(proof_path(bench, laser))
    except SealBroken as broken:
        return f"its proof {broken}; {COMMAND} makes another"
    if proof is None:
        return f"it was never proven on this bench ({COMMAND})"
    if proof.identity != identity or dict(proof.channels) != dict(channels):
        return f"what was proven is another box, or other wiring ({COMMAND})"
    if proof.simulated and not simulated:
        return f"only a simulation of it was proven ({COMMAND})"
    when = f"{proof.utc[:10]} by {proof.who}"
    if not proof.holds:
        return f"its proof of {when} has NOT held: {proof.failures[0]}"
    return f"proven {when}: {len(proof.trials)} trials, each of the outputs {', '.join(proof.counted)} counted"
