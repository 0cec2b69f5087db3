"""Pairs of the frames of a folder, by their names alone.

First and second frames differ by one mark in their names: ``a``/``b`` (B00001_a, 0001A, a0001, LA),
``0``/``1`` or ``1``/``2`` (A001_1, img0001_frame0), I/II, or words: first and second, before and after.  A mark
counts only where the other name is there as well, and where it is no number of a camera, run, plane or repetition.
Names without a mark are a sequence, in order of their number or of their time.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import gcd
from statistics import median

MARKS = {"a": "b", "A": "B", "I": "II"}
WORD_MARKS = {
    "first": "second",
    "before": "after",
    "start": "end",
    "begin": "end",
    "one": "two",
    "ref": "def",
}
for _one, _other in WORD_MARKS.items():
    MARKS |= {_one: _other, _one.capitalize(): _other.capitalize(), _one.upper(): _other.upper()}
FRAME_WORD = re.compile(r"(?:f|fr|frame|frm|im|img|image|pic|l|las|laser|p|pulse|e|exp|expo|exposure|t|shot)?")
OTHER_WORD = re.compile(
    r"c|cam|camera|r|rep|repeat|run|set|case|test|[xyz]|pos|position|plane|phase|view|ch|channel|day|probe"
)
SIDE_WORD = re.compile(r"l|r|left|right|top|bottom|front|rear|back")
LEAST_PAIRED = 0.5  # of the frames of a scheme: others have lost their partner
FEW_STRAYS = 0.2  # of all frames of a folder at most, such as frames of the target
MARK_DIGITS = 2  # of a number that tells first from second frame at most; a longer one counts
JITTER = 0.2  # of the usual time between frames, in names that are times
# Times as long between pairs as within them, at least, where the gaps between numbers say it
APART = 3
MIN_WRAPPED = 3  # gaps of a counter that may have begun anew, and times that the widest is longer than the next
# With a decimal point, comma or p, and an exponent; + or - is a sign in front, and behind _ or = (t_-0012)
_NUMBER = re.compile(r"(?:(?<![^_=])[+-])?\d+(?:[.,p]\d+(?![\d.,p]))?(?:[eE][+-]\d\d?(?!\d))?")
_DECIMAL = re.compile(r"([+-]?\d+)[.,p](\d+)(.*)")
_SIGN = re.compile(r"(?<![^_=])[+-]$")
_TIME = re.compile(r"\d+([.,p])\d+(s|ms|us|µs|ns)?(?![^\W_])")
_SIGNED = re.compile(r"[+-]#")
_NO_SIGN = re.compile(r"-0+")  # zero has none
_HEXADECIMAL = re.compile(r"[0-9a-f]*[c-f][0-9a-f]*|[0-9A-F]*[C-F][0-9A-F]*")
LEAST_COUNTED = 0.8  # of the numbers of a counter behind a point, others lost their frames
MOST_LACKING = 0.2  # of the numbers of a hexadecimal counter
_DIGITS = re.compile(r"\d+")
_LETTERS = re.compile(r"[^\W\d_]+")

Pair = tuple[str, str]


@dataclass(frozen=True)
class Scheme:
    """Frames whose names tell first and second frames apart.

    Parameters
    ----------
    first, second : str
        Patterns of their names, ``A%03d_1.tif``, or ``run%*_1.tif`` where several numbers vary.
    pairs : tuple of (str, str)
        In order.
    names : frozenset of str
        All frames that follow it, those without a partner as well.
    """

    first: str
    second: str
    pairs: tuple[Pair, ...]
    names: frozenset[str]

    @property
    def mark_at(self) -> int:
        """Distance of the mark from the end of a name: the last one is the most likely."""
        first, second = self.pairs[0]
        alike = next(k for k, (a, b) in enumerate(zip(first, second, strict=False)) if a != b)
        return len(first) - alike


def schemes_of(names: Collection[str]) -> list[Scheme]:
    """Return all ways in which marks in the names make pairs, each with most of its frames in pairs."""
    found: dict[tuple[str, str], list[Pair]] = defaultdict(list)
    there = {_with_small_ending(name): name for name in sorted(names)}
    groups: dict[str, set[str]] = defaultdict(set)
    for name in there.values():
        groups[skeleton(name)].add(name)
    for name in sorted(there.values(), key=natural):
        for start, end, mark in _marks_in(name, groups[skeleton(name)]):
            partner = there.get(_with_small_ending(f"{name[:start]}{mark}{name[end:]}"))
            if partner is not None:
                side = f"{skeleton(name[:start])}\0{name[start:end]}>{mark}\0{skeleton(name[end:])}"
                found[side, skeleton(partner)].append((name, partner))
    schemes = []
    for pairs in found.values():
        first, second = pairs[0]
        of_both = frozenset(groups[skeleton(first)] | groups[skeleton(second)])
        in_pairs = len({name for pair in pairs for name in pair})
        if in_pairs == 2 * len(pairs) >= LEAST_PAIRED * len(of_both):
            schemes.append(Scheme(*patterns_of(pairs), tuple(pairs), of_both))
    return schemes


def _marks_in(name: str, group: Collection[str]) -> Iterator[tuple[int, int, str]]:
    """Places of what may be the mark of a first frame, and the mark of the second one."""
    stem = name.rpartition(".")[0]
    for word in _LETTERS.finditer(stem):
        text = word[0]
        before = text[:-1].lower() if len(text) > 1 else _word_before(stem, word.start())
        is_own = len(text) == 1 or FRAME_WORD.fullmatch(before) or text[-2].isupper() != text[-1].isupper()
        if text in MARKS and len(text) > 1:
            yield word.start(), word.end(), MARKS[text]
        elif text[-1] in MARKS and is_own and not OTHER_WORD.fullmatch(before):
            yield word.end() - 1, word.end(), MARKS[text[-1]]
    numbers = list(_DIGITS.finditer(stem))
    for place in reversed(range(len(numbers))):
        number = numbers[place]
        if len(number[0]) > MARK_DIGITS or int(number[0]) > 1 or len(numbers) < 2:
            continue
        values = {int(_DIGITS.findall(each)[place]) for each in group}
        if _SIGN.search(stem, 0, number.start()) or _is_time(stem[number.start() :], group):
            continue
        before, is_last = _word_before(stem, number.start()), place == len(numbers) - 1
        fits = FRAME_WORD.fullmatch(before) or (is_last and not OTHER_WORD.fullmatch(before))
        if fits and values in ({0, 1}, {1, 2}) and min(values) == int(number[0]):
            yield number.start(), number.end(), f"{int(number[0]) + 1:0{len(number[0])}d}"
            return  # of two such numbers the last one is the mark


def _is_time(rest: str, group: Collection[str]) -> bool:
    """Return whether a number goes on behind a decimal point, 0,5 or 1.25s; of 1.0001 the first may be a mark."""
    found = _TIME.match(rest)
    if found is None:
        return False
    return found[1] != "." or found[2] is not None or len({len(name) for name in group}) > 1


def _word_before(stem: str, place: int) -> str:
    """Letters right before a place, or before a separator there."""
    before = re.search(r"([^\W\d_]*)[\s_.\-=]*$", stem[:place])
    return before[1].lower() if before is not None else ""


def skeleton(name: str) -> str:
    """Return a name with # in place of each number, its ending in small letters."""
    return _DIGITS.sub("#", _with_small_ending(name))


def _with_small_ending(name: str) -> str:
    stem, dot, ending = name.rpartition(".")
    return f"{stem}{dot}{ending.lower()}"


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts names by their numbers."""
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in re.split(r"(\d+)", name)]


def patterns_of(pairs: Sequence[Pair]) -> Pair:
    """Return the patterns of first and second frames, with ``%03d`` in place of the number that counts pairs.

    Where several numbers count, ``*`` stands for all of the name between the first of them and the last one.
    """
    firsts, seconds = zip(*pairs, strict=True)
    return pattern_of(firsts), pattern_of(seconds)


def pattern_of(names: Sequence[str]) -> str:
    """Return the pattern of names that differ by numbers alone; the last number counts where none differs."""
    runs = [list(_DIGITS.finditer(name)) for name in names]
    if not runs[0]:
        return names[0]
    varying = [place for place in range(len(runs[0])) if len({each[place][0] for each in runs}) > 1]
    low, high = (varying[0], varying[-1]) if varying else (_counting(runs[0]),) * 2
    start, end = runs[0][low].start(), runs[0][high].end()
    widths = {len(each[low][0]) for each in runs}
    number = "*" if low != high else f"%0{min(widths)}d" if len(widths) == 1 else "%d"
    return f"{names[0][:start]}{number}{names[0][end:]}"


def _counting(runs: Sequence[re.Match[str]]) -> int:
    """Place of the number that counts in a single name: the longest, the last of several."""
    return max(range(len(runs)), key=lambda place: (len(runs[place][0]), place))


def sequences_of(names: Collection[str]) -> list[dict[Fraction, str]]:
    """Sort names without marks into sequences, by the number or time in them; one for each camera or run."""
    found: list[dict[Fraction, str]] = []
    for group, number in _groups_of(names):
        texts = [number.findall(name.rpartition(".")[0]) for name in group]
        if not texts[0]:
            continue
        varying = [k for k in range(len(texts[0])) if len({each[k] for each in texts}) > 1]
        counts = {k: len({each[k] for each in texts}) for k in varying}
        if len(varying) > 1 and max(counts.values()) < len(group):  # each camera has every number
            counting = max(varying, key=lambda k: (counts[k], k))
            parts: dict[tuple[str, ...], dict[Fraction, str]] = defaultdict(dict)
            for name, each in zip(group, texts, strict=True):
                parts[(*each[:counting], *each[counting + 1 :])][_value_of(each[counting])] = name
            found += parts.values()
        elif len(varying) > 1:  # a date and a time: their order counts
            found.append({Fraction(k): name for k, name in enumerate(group, 1)})
        else:
            last = varying[0] if varying else len(texts[0]) - 1
            found.append({_value_of(each[last]): name for name, each in zip(group, texts, strict=True)})
    return found


def _are_counters(decimals: Collection[tuple[str, str]]) -> bool:
    """Return whether counters stand behind the points of names, run3.9 and run3.10; 0.9 and 0.15 are decimals."""
    behind: dict[str, set[str]] = defaultdict(set)
    for whole, fraction in decimals:
        behind[whole].add(fraction)
    widths = {len(fraction) for _, fraction in decimals}
    numbers = sorted({int(fraction) for _, fraction in decimals})
    step = gcd(*(after - before for before, after in pairwise(numbers))) or 1
    is_regular = len(numbers) > 2 and len(numbers) > LEAST_COUNTED * ((numbers[-1] - numbers[0]) // step + 1)
    if len(widths) > 1:
        return is_regular or any(text[1:].endswith("0") for _, text in decimals)
    # Times go on beyond a whole number by the same step; marks 1.001, 2.001 have the same counter each.
    is_repeated = len(behind) > 1 and len({frozenset(each) for each in behind.values()}) == 1
    return is_repeated and numbers[-1] + step != numbers[0] + 10 ** min(widths)


def _groups_of(names: Collection[str]) -> Iterator[tuple[list[str], re.Pattern[str]]]:
    """Names that differ by numbers alone, in natural order, with the pattern of their numbers."""
    groups: dict[str, list[str]] = defaultdict(list)
    for name in sorted(names, key=natural):
        stem, _, ending = name.rpartition(".")
        groups[f"{_NUMBER.sub('#', stem)}.{ending.lower()}"].append(name)
    # frames before a trigger have a minus, those behind it none
    alike: dict[str, list[str]] = defaultdict(list)
    for key in groups:
        alike[_SIGNED.sub("#", key)].append(key)
    for keys in alike.values():
        if len(keys) > 1 and any("-#" in key for key in keys):
            both = [name for key in keys for name in groups.pop(key)]
            yield both, re.compile(f"[+-]?{_NUMBER.pattern}")
    for group in groups.values():
        texts = [text for name in group for text in _NUMBER.findall(name.rpartition(".")[0])]
        decimals = [(found[1], found[2]) for text in texts if (found := _DECIMAL.match(text))]
        counts = _are_counters(decimals) or any(_NO_SIGN.fullmatch(text) for text in texts)
        yield group, _DIGITS if counts else _NUMBER


def hexadecimal_sequence(names: Collection[str]) -> dict[Fraction, str]:
    """Return frames by number if a counter in hexadecimal, f_0009, f_000a, is all that differs; else none."""
    stems = {name.rpartition(".")[0]: name for name in names}
    before, behind = _count_alike(stems), _count_alike([stem[::-1] for stem in stems])
    texts = {stem[before : len(stem) - behind]: name for stem, name in stems.items()}
    digits = "".join(texts)
    is_one = len(texts) == len(names) and len({*map(len, texts)}) == 1
    if not (is_one and _HEXADECIMAL.fullmatch(digits) and re.search(r"\d", digits)):
        return {}
    found = {Fraction(int(text, 16)): name for text, name in texts.items()}
    lacking = max(found) - min(found) + 1 - len(found)
    return found if lacking <= MOST_LACKING * len(found) else {}


def _count_alike(texts: Collection[str]) -> int:
    """Letters at the beginning that all texts have in common."""
    both = zip(min(texts, default=""), max(texts, default=""), strict=False)
    return next((place for place, (one, other) in enumerate(both) if one != other), 0)


def _value_of(text: str) -> Fraction:
    return Fraction(_DECIMAL.sub(r"\1.\2\3", text))


def differ_by_camera(one: str, other: str) -> bool:
    """Return whether two patterns differ by a camera, run, plane or side, not by first and second frame."""
    place = next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), 0)
    words = [match for match in _LETTERS.finditer(one) if match.start() <= place < match.end()]
    start = words[0].start() if words else place
    is_other = any(OTHER_WORD.fullmatch(_word_before(one, at)) for at in (start, place))
    return is_other or bool(words and SIDE_WORD.fullmatch(words[0][0].lower()))


def number_from_1(frames: Mapping[Fraction, str]) -> dict[int, str]:
    """Number the frames of a sequence from 1, with gaps where some were lost.

    Numbers in steps of 10 count by tens; times count by the usual time between them.  Where the frames of a pair
    stand much closer together than pairs follow each other, those of pair n are 2 n - 1 and 2 n.
    """
    frames = _unwrap_counter(frames)
    values = sorted(frames)
    low, gaps = values[0], [b - a for a, b in pairwise(values)]
    if not gaps:
        return {1: frames[low]}
    least, usual = min(gaps), Fraction(median(gaps))
    short = [gap <= (1 + Fraction(JITTER)) * least for gap in gaps]
    apart = all(gap >= APART * least for gap, near in zip(gaps, short, strict=True) if not near)
    if apart and not all(short) and not any(a and b for a, b in pairwise(short)):
        numbers, number = [1], 1
        for near in short:  # a frame without a partner is a first one, and leaves the number of its partner free
            number = number + 1 if near else number + 2 - (number + 1) % 2
            numbers.append(number)
        return {number: frames[value] for number, value in zip(numbers, values, strict=True)}
    step = Fraction(gcd(*(int(gap) for gap in gaps))) if all(gap.denominator == 1 for gap in gaps) else usual
    if len(gaps) > 1 and step < usual and all(abs(gap / usual - round(gap / usual)) <= JITTER for gap in gaps):
        step = usual if usual > 2 else step  # frames by the millisecond: 0, 33, 67, 100
    numbers = [1]
    for gap in gaps:
        numbers.append(numbers[-1] + max(1, round(gap / step)))
    return {number: frames[value] for number, value in zip(numbers, values, strict=True)}


def _unwrap_counter(frames: Mapping[Fraction, str]) -> Mapping[Fraction, str]:
    """Order the frames of a counter that began anew behind its largest number: 998, 999, 000, 001."""
    values = sorted(frames)
    low, high = values[0], values[-1]
    gaps = sorted((b - a, b) for a, b in pairwise(values))
    is_binary = high.denominator == 1 and high > 1 and not int(high) & (int(high) + 1)
    is_full = len(frames[low]) == len(frames[high]) and set(str(high)) == {"9"}
    if low not in (0, 1) or not (is_binary or is_full) or len(gaps) < MIN_WRAPPED:
        return frames
    (usual, _), (widest, first) = gaps[-2:]
    if widest <= (high - low) / 2 or widest < MIN_WRAPPED * usual:
        return frames
    return {value if value >= first else value + high - low + 1: name for value, name in frames.items()}
