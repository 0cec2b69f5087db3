"""Files of frames: a folder, a pattern of their names, or a pattern for each of first and second frames.

A pattern has one ``%05d`` or ``%d`` for a number, or ``*`` for any text.  Which frames are pairs, their names say
(`daq.frames.name_schemes`), or the pattern of the second frames does; else they are a sequence, whose neighbours
are pairs (`daq.frames.pairing`).  Numbers may have gaps: one that is missing does not swap the rest.

What a folder holds besides is set aside: hidden files, which macOS writes beside each (``._im0001.tif``), and a
few of another name, such as frames of the target.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

from daq.frames.name_schemes import (
    FEW_STRAYS,
    Scheme,
    differ_by_camera,
    hexadecimal_sequence,
    natural,
    number_from_1,
    pattern_of,
    schemes_of,
    sequences_of,
    skeleton,
)
from daq.frames.pairing import NEIGHBOURS, FramePlaces, PairedFrames, Pairing
from daq.frames.tiff_pages import page_count
from piv.errors import PairError
from piv.files.frame_file import FRAME_ENDINGS, page_of

_WILD = re.compile(r"%0?(\d*)d|\*")
WITH = "@@"  # between the patterns of first and second frames
MOST_NAMED = 4  # patterns in a message
MOST_NUMBER = 10**9  # of a pair; larger ones are times
MOST_LONE = 4  # frames of a name of their own that are set aside, such as a mask and a dark frame
LISTED = 3  # pairs that are named before anything is computed


class FoundFiles(PairedFrames):
    """Frames that were found, and which of them are pairs."""

    is_sequence = False  # whose pairs no name tells
    set_aside: Sequence[str] = ()  # frames of another name
    missing = 0  # frames of a sequence, by its numbers
    gaps: Sequence[tuple[str, str]] = ()  # names before and behind them

    def _keep(self, folder: Path, pairs: Sequence[tuple[str, str]], count: int) -> None:
        """Keep pairs in their order; their numbers are those of the files where one counts them."""
        numbers = _numbers_of([first for first, _ in pairs])
        self._pairs = [
            (number, folder / first, folder / second)
            for number, (first, second) in zip(numbers, pairs, strict=True)
        ]
        self._unpaired = count - len({name for pair in pairs for name in pair})

    def _keep_sequence(self, folder: Path, frames: dict[Fraction, str], pairing: Pairing) -> None:
        """Keep the pairs of a sequence, or of each file that holds both frames as pages."""
        order = [frames[value] for value in sorted(frames)]
        if pairing is NEIGHBOURS and (pages := page_count(folder / order[0])) > 1:
            if pages > 2:
                raise PairError(
                    f"{folder / order[0]}: holds {pages} pages, and so may the others; give one of these files"
                )
            self._keep(folder, [(f"{name}@1", f"{name}@2") for name in order], 2 * len(order))
            return
        self.is_sequence = pairing is NEIGHBOURS
        numbered = {number: folder / name for number, name in number_from_1(frames).items()}
        steps = [(a, b) for a, b in pairwise(sorted(numbered)) if b > a + 1]
        self.missing = sum(b - a - 1 for a, b in steps)
        self.gaps = [(numbered[a].name, numbered[b].name) for a, b in steps]
        self._pairs, self._unpaired = pairing.pairs(numbered)

    def file_of(self, place: Path) -> Path:
        """The frame's own, or the file that holds it as a page."""
        return page_of(place)[0]


class NumberedFiles(FoundFiles):
    """Files whose names follow a pattern.

    Parameters
    ----------
    path : Path
        Pattern with one ``%05d``, ``%d``, ``*`` or the like in the name of the file.

    Raises
    ------
    PairError
        No file has such a name, or they are second frames; or names say which frames are pairs, and a pairing says
        it too.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        folder, found = path.parent, matches(path)
        if not found:
            raise PairError(f"{path}: no file has such a name")
        names = set(found.values())
        is_letter = False
        for scheme in schemes_of(frames_in(folder)):
            if (
                names <= scheme.names
                and skeleton(scheme.pairs[0][1]) == skeleton(next(iter(names)))
                and not (names & {first for first, _ in scheme.pairs})
            ):
                raise PairError(
                    f"{path}: these are second frames; give the first ones, {_quote(folder / scheme.first)}"
                )
            pairs = [pair for pair in scheme.pairs if pair[0] in names]
            if names <= scheme.names and pairs:
                is_letter = skeleton(pairs[0][0]) != skeleton(pairs[0][1])
                if pairing is NEIGHBOURS:
                    partners = {second for _, second in pairs}
                    self._keep(folder, pairs, len(names | partners))
                    return
        if is_letter:
            raise PairError(f"{path}: the letters define the pairs; remove the numbers after @")
        if "*" in path.name:
            self._keep_sequence(folder, _one_sequence(folder, sequences_of(names)), pairing)
        else:
            self._keep_sequence(folder, {Fraction(int(text)): name for text, name in found.items()}, pairing)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether the name has one place for a number, the ending of a frame, and is no file's own."""
        return (
            len(list(_WILD.finditer(path.name))) == 1
            and path.suffix.lower() in FRAME_ENDINGS
            and not path.exists()
        )


class PatternPair(FoundFiles):
    """Files in pairs by a pattern for each of both: what stands for ``*`` or ``%05d`` is the same in both names.

    Numbers of second frames may also be larger or smaller by one amount, without gaps: A0001 with B1001.

    Parameters
    ----------
    path : Path
        Both patterns with ``@@`` between them; the second one without a folder lies where the first does.

    Raises
    ------
    PairError
        No pair of files has such names.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        first, second = (Path(text) for text in str(path).split(WITH))
        second = second if len(second.parts) > 1 else first.with_name(second.name)
        if pairing is not NEIGHBOURS:
            raise PairError(f"{path}: the patterns define the pairs; remove the numbers after @")
        for pattern in (first, second):
            if not NumberedFiles.takes(pattern):
                raise PairError(f"{pattern}: a pattern has one %d, %05d or * in the name of a frame, in quotes")
        firsts, seconds = matches(first), matches(second)
        both = [(text, text) for text in sorted(firsts.keys() & seconds.keys(), key=natural)]
        if not both and are_offset(firsts, seconds):
            both = list(zip(sorted(firsts, key=natural), sorted(seconds, key=natural), strict=True))
        if not both:
            raise PairError(
                f"{first}: {len(firsts)} files have such a name, and {len(seconds)} that of {second}; no two have"
                " the same text in place of the number, and numbers do not differ by the same amount"
            )
        numbers = _numbers_of([firsts[text] for text, _ in both])
        self._pairs = [
            (number, first.parent / firsts[one], second.parent / seconds[other])
            for number, (one, other) in zip(numbers, both, strict=True)
        ]
        self._unpaired = len(firsts) + len(seconds) - 2 * len(both)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether there are two patterns."""
        return str(path).count(WITH) == 1


class FrameFolder(FoundFiles):
    """Frames of a folder, in pairs as their names say.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    PairError
        Its frames are of several series, or names can be read in several ways; the message has commands.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        names = frames_in(path)
        few = FEW_STRAYS * len(names)
        if hexadecimal := hexadecimal_sequence(names):
            self._keep_sequence(path, hexadecimal, pairing)
            return
        longest = max(sequences_of(names), key=len, default={})
        # 0, 1 are numbers beside -1
        is_signed = min(longest, default=0) < 0 and len(names) - len(longest) <= few
        schemes = [] if is_signed else schemes_of(names)
        covering = [scheme for scheme in schemes if len(_others_of(scheme, names)) <= few]
        in_others = {name for scheme in schemes if scheme not in covering for name in scheme.names}
        is_unique = len(covering) == 1 and len(names - in_others) > few
        firsts = [first for first, _ in covering[0].pairs] if is_unique else []
        if len(firsts) == 1 or len(sequences_of(firsts)) == 1:
            (scheme,) = covering
            if pairing is not NEIGHBOURS:
                raise PairError(f"{path}: the names define the pairs; remove the numbers after @")
            self._keep(path, scheme.pairs, len(scheme.names))
            self.set_aside = sorted(names - scheme.names)
            return
        if schemes:
            raise PairError(_several(path, names, schemes))
        sequence = _one_sequence(path, sequences_of(names), few)
        _require_one_order(path, sequence)
        self._keep_sequence(path, sequence, pairing)
        self.set_aside = sorted(names - set(sequence.values()))

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether it is a folder with numbered frames, or with one pair whose names say so."""
        names = frames_in(path) if path.is_dir() else set()
        return any(re.search(r"\d", Path(name).with_suffix("").as_posix()) for name in names) or bool(
            schemes_of(names)
        )


def frames_in(folder: Path) -> set[str]:
    """Return the names of frames in a folder; of its subfolders, with their names, if it has none itself.

    Raises
    ------
    PairError
        It cannot be looked into.
    """
    try:
        found = {file.name for file in folder.iterdir() if is_frame(file)}
        if not found:
            inside = (file for each in folder.iterdir() if each.is_dir() for file in each.iterdir())
            found = {f"{file.parent.name}/{file.name}" for file in inside if is_frame(file)}
    except OSError as error:
        raise PairError(f"{folder}: cannot be looked into ({error.strerror})") from None
    return found


def is_frame(file: Path) -> bool:
    """Return whether a name is that of a frame, and no hidden file's."""
    return file.suffix.lower() in FRAME_ENDINGS and not file.name.startswith(".")


def matches(pattern: Path) -> dict[str, str]:
    """Return the names of files that follow a pattern, by the text in place of its number."""
    wild = _WILD.search(pattern.name)
    assert wild is not None
    digits = ".*" if wild[0] == "*" else f"\\d{{{int(wild[1])},}}" if wild[1] else r"\d+"
    before, after = pattern.name[: wild.start()], pattern.name[wild.end() :]
    name = re.compile(f"{re.escape(before)}({digits}){re.escape(after)}")
    try:
        there = sorted(file.name for file in pattern.parent.iterdir() if is_frame(file))
    except OSError as error:
        raise PairError(f"{pattern.parent}: cannot be looked into ({error.strerror})") from None
    return {match[1]: file for file in there if (match := name.fullmatch(file))}


def first_pairs(pairs: Sequence[FramePlaces]) -> str:
    """Return the names of the first pairs, for a person to check before anything is computed."""
    named = [f"{first.name} + {second.name}" for _, first, second in pairs[:LISTED]]
    return f"pairs: {', '.join(named)}{', ...' if len(pairs) > LISTED else ''} ({len(pairs)} in all)"


def _numbers_of(firsts: Sequence[str]) -> Sequence[int]:
    """Numbers of pairs: the one number that differs in the names of their first frames, or their order."""
    texts = [re.findall(r"\d+", Path(name).stem) for name in firsts]
    for each in reversed(list(zip(*texts, strict=False))):
        numbers = [int(text) for text in each]
        if len(set(numbers)) == len(numbers) and sorted(numbers) == numbers and numbers[-1] < MOST_NUMBER:
            return numbers
    return range(len(firsts))


def _one_sequence(folder: Path, found: list[dict[Fraction, str]], few: float = 0.0) -> dict[Fraction, str]:
    """Return the sequence that nearly all frames are of; PairError with patterns if there are several."""
    if not found:
        raise PairError(f"{folder}: holds no numbered frames")
    longest = max(found, key=len)
    lone = [each for each in found if len(each) == 1 < len(longest)]
    if len(lone) <= MOST_LONE:
        found = [each for each in found if each not in lone]
    if sum(map(len, found)) - len(longest) > few:
        series = sorted((pattern_of(list(each.values())) for each in found if each not in lone), key=natural)
        some = ", ".join(dict.fromkeys(_quote(folder / each) for each in series[:MOST_NAMED]))
        pairs = [_with_second(folder, *series)] if are_first_and_second(found, series) else []
        more = "".join(f"; or, for first and second frames of pairs: {each}" for each in pairs)
        raise PairError(f"{folder}: its frames are of several series; name one of them, in quotes: {some}{more}")
    return longest


def _require_one_order(folder: Path, sequence: Mapping[Fraction, str]) -> None:
    """Raise PairError with both patterns if every number has a minus that may be a sign or a dash (t_-0012)."""
    pattern = pattern_of(list(sequence.values()))
    place = _WILD.search(pattern)
    if max(sequence) >= 0 or place is None or place[0] == "*" or "=-" in pattern:
        return
    signed = f"{pattern[: place.start() - 1]}*{pattern[place.end() :]}"
    raise PairError(
        f"{folder}: the minus in {sequence[max(sequence)]} may be a sign or a dash; in place of the folder give,"
        f" with its quotes, {_quote(folder / pattern)} if numbers grow with time, or {_quote(folder / signed)} if"
        " they are negative and fall"
    )


def _others_of(scheme: Scheme, names: set[str]) -> set[str]:
    """Return the frames of other series; a few lone ones, such as a mask, are none unless named like exposures."""
    others = names - scheme.names
    kinds = Counter(map(skeleton, others))
    exposures = [name for pair in scheme.pairs for name in pair]
    lone = {
        name
        for name in others
        if kinds[skeleton(name)] == 1
        and not any(
            len(name) == len(each) and sum(map(str.__ne__, name, each)) == 1  # frame_c beside frame_a, frame_b
            for each in exposures
        )
    }
    return others - lone if len(lone) <= MOST_LONE else others


def are_first_and_second(found: Sequence[Mapping[Fraction, str]], patterns: Sequence[str]) -> bool:
    """Return whether two series may be the first and the second frames of pairs."""
    return (
        len(found) == 2
        and are_offset(*({str(number): name for number, name in each.items()} for each in found))
        and Path(patterns[0]).suffix == Path(patterns[1]).suffix
        and not differ_by_camera(patterns[0], patterns[1])
    )


def are_offset(firsts: Mapping[str, str], seconds: Mapping[str, str]) -> bool:
    """Return whether two series have equally many numbers, which differ by one amount; 0 included."""
    if len(firsts) != len(seconds) or not all(text.isdecimal() for text in (*firsts, *seconds)):
        return False
    numbers = [sorted(map(int, texts)) for texts in (firsts, seconds)]
    return len({b - a for a, b in zip(*numbers, strict=True)}) == 1


def _several(folder: Path, names: set[str], schemes: Sequence[Scheme]) -> str:
    """Say which series there are, each by the words that choose it."""
    ways = []
    for scheme in sorted(schemes, key=lambda scheme: (scheme.mark_at, scheme.first)):
        firsts = [first for first, _ in scheme.pairs]
        for part in sequences_of(firsts) or [{Fraction(0): firsts[0]}]:
            pairs = [pair for pair in scheme.pairs if pair[0] in set(part.values())]
            ways.append(_with_second(folder, *(pattern_of(each) for each in zip(*pairs, strict=True))))
    rest = sequences_of(names - frozenset().union(*(scheme.names for scheme in schemes)))
    ways += [_quote(folder / pattern_of(list(each.values()))) for each in rest if len(each) > 1]
    more = "  ..." if len(ways) > MOST_NAMED else ""
    return (
        f"{folder}: its frames are of several series, or can be paired in several ways; in place of the folder"
        f" give one of these, with its quotes: {'  or  '.join(ways[:MOST_NAMED])}{more}"
    )


def _with_second(folder: Path, first: str, second: str) -> str:
    """Return the words that choose pairs by a pattern of each frame, or by both names if these have no number."""
    where = folder / second if "/" in second else Path(second)
    if not _WILD.search(first):
        return f"{_quote(folder / first)} {_quote(folder / second)}"
    return f"{_quote(folder / first)} --second {_quote(where)}"


def _quote(path: Path) -> str:
    return f'"{path}"'
