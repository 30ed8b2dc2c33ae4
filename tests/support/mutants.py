"""Mutants of files: texts and bytes with one to four faults, by a seed.

Faults of a text know what a text consists of: numbers, words, lines, columns. Faults of bytes know
about words of 4 and 8 bytes, which are counts and addresses in most formats.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

Random = np.random.Generator

_NUMBER = re.compile(rb"(?<![A-Za-z_\d.])[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
_WORD = re.compile(rb"[^\s,;=\"]+")
NUMBERS = (
    b"", b"0", b"-1", b"1e999", b"-1e-999", b"nan", b"inf", b"2.0D+05", b"1,5", b"7.12x45", b"7e-",
    b"1_0", b"0x10", b"1.0+5", b"3.5e", b"--1", b"1 2", b"2147483648", b"9223372036854775808",
    b"9" * 30, b"9" * 400, b"9" * 5000, b"\xd9\xa3", b"1.5.2", b"true", b"1e5", b"-0.0",
)  # fmt: skip
WORDS = (
    b"", b"*", b"#", b"%", b"$", b"-1", b"\x00", b"\xff\xfe", b"\x1b[31m", b"[" * 2000, b"{" * 300,
    b'"', b"'", b"../../etc/passwd", b"n" * 300, b"n" * 9000, b"None", b"inf", b"\xe2\x80\xa8", b"=",
)  # fmt: skip
#: Bytes of a mutant: a part many times, four times over, would make 1 GB of a small file.
LARGEST = 2**24
SIZES = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)


def text_mutant(raw: bytes, random: Random) -> bytes:
    """Return a text with faults."""
    for _ in range(int(random.integers(1, 4))):
        raw = _choice(_TEXT_FAULTS, random)(raw, random)
    return raw


def bytes_mutant(raw: bytes, random: Random) -> bytes:
    """Return bytes with faults."""
    for _ in range(int(random.integers(1, 5))):
        raw = _choice(_BYTE_FAULTS, random)(raw, random)
    return raw


# -- faults of texts ------------------------------------------------------------------------------
def _other_number(raw: bytes, random: Random) -> bytes:
    return _replaced(raw, _NUMBER, _choice(NUMBERS, random), random)


def _other_word(raw: bytes, random: Random) -> bytes:
    return _replaced(raw, _WORD, _choice(WORDS, random), random)


def _other_digit(raw: bytes, random: Random) -> bytes:
    digits = [i for i, c in enumerate(raw) if 48 <= c <= 57]
    return _with(raw, digits, b"%d" % random.integers(10), random)


def _other_character(raw: bytes, random: Random) -> bytes:
    return _with(raw, range(len(raw)), bytes([int(random.integers(256))]), random)


def _number_by_one(raw: bytes, random: Random) -> bytes:
    found = [m for m in _NUMBER.finditer(raw) if m[0].isdigit() and len(m[0]) < 10]
    if not found:
        return raw
    m = _choice(found, random)
    changed = b"%d" % max(int(m[0]) + int(random.choice([-1, 1])), 0)
    return raw[: m.start()] + changed.rjust(len(m[0])) + raw[m.end() :]


def _word_gone(raw: bytes, random: Random) -> bytes:
    return _replaced(raw, _WORD, b"", random)


def _word_twice(raw: bytes, random: Random) -> bytes:
    found = list(_WORD.finditer(raw))
    if not found:
        return raw
    m = _choice(found, random)
    return raw[: m.end()] + b" " + m[0] + raw[m.end() :]


def _two_words_swapped(raw: bytes, random: Random) -> bytes:
    found = list(_WORD.finditer(raw))
    if len(found) < 2:
        return raw
    a, b = sorted(random.choice(len(found), 2, replace=False))
    first, second = found[a], found[b]
    between = raw[first.end() : second.start()]
    return raw[: first.start()] + second[0] + between + first[0] + raw[second.end() :]


def _line_gone(raw: bytes, random: Random) -> bytes:
    lines = raw.splitlines(keepends=True)
    at = int(random.integers(len(lines) or 1))
    return b"".join(lines[:at] + lines[at + 1 :])


def _line_twice(raw: bytes, random: Random) -> bytes:
    lines = raw.splitlines(keepends=True)
    at = int(random.integers(len(lines) or 1))
    return b"".join(lines[: at + 1] + lines[at:])


def _two_lines_swapped(raw: bytes, random: Random) -> bytes:
    lines = raw.splitlines(keepends=True)
    if len(lines) > 1:
        a, b = random.choice(len(lines), 2, replace=False)
        lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def _columns_shifted(raw: bytes, random: Random) -> bytes:
    lines = raw.splitlines(keepends=True)
    if not lines:
        return raw
    at = int(random.integers(len(lines)))
    shift = int(random.integers(-3, 4))
    lines[at] = b" " * shift + lines[at] if shift > 0 else lines[at][-shift:]
    return b"".join(lines)


def _other_line_ends(raw: bytes, random: Random) -> bytes:
    return raw.replace(b"\n", _choice((b"\r\n", b"\r", b"\n\n", b"", b"\x0b"), random))


def _cut(raw: bytes, random: Random) -> bytes:
    return raw[: int(random.integers(len(raw) + 1))]


def _part_many_times(raw: bytes, random: Random) -> bytes:
    a, b = sorted(random.integers(0, len(raw) + 1, 2))
    most = max(LARGEST - len(raw), 0) // max(b - a, 1)
    return raw[:b] + raw[a:b] * min(int(random.integers(1, 40)), most) + raw[b:]


_Fault = Callable[[bytes, Random], bytes]
_TEXT_FAULTS: tuple[_Fault, ...] = (
    _other_number, _other_number, _other_number, _other_word, _other_digit, _other_digit,
    _other_character, _number_by_one, _word_gone, _word_twice, _two_words_swapped, _line_gone,
    _line_twice, _two_lines_swapped, _columns_shifted, _other_line_ends, _cut, _part_many_times,
)  # fmt: skip


# -- faults of bytes ------------------------------------------------------------------------------
def _bit(raw: bytes, random: Random) -> bytes:
    if not raw:
        return raw
    at = int(random.integers(len(raw)))
    return _put(raw, at, bytes([raw[at] ^ (1 << int(random.integers(8)))]))


def _size(raw: bytes, random: Random) -> bytes:
    width = int(random.choice([2, 4, 8]))
    value = _choice(SIZES, random) % 256**width
    order = _choice(("little", "big"), random)
    step = width if random.integers(2) else 1
    at = int(random.integers(max(len(raw) // step, 1))) * step
    return _put(raw, at, value.to_bytes(width, order))


def _zeros(raw: bytes, random: Random) -> bytes:
    return _put(raw, int(random.integers(len(raw) + 1)), bytes(int(random.integers(1, 64))))


def _bytes_gone(raw: bytes, random: Random) -> bytes:
    at = int(random.integers(len(raw) + 1))
    return raw[:at] + raw[at + int(random.integers(1, 32)) :]


def _bytes_more(raw: bytes, random: Random) -> bytes:
    at = int(random.integers(len(raw) + 1))
    return raw[:at] + random.bytes(int(random.integers(1, 32))) + raw[at:]


def _parts_swapped(raw: bytes, random: Random) -> bytes:
    a, b, c = sorted(random.integers(0, len(raw) + 1, 3))
    return raw[:a] + raw[b:c] + raw[a:b] + raw[c:]


_BYTE_FAULTS: tuple[_Fault, ...] = (
    _bit, _bit, _other_character, _size, _size, _zeros, _bytes_gone, _bytes_more, _parts_swapped,
    _cut, _part_many_times,
)  # fmt: skip


# -- helpers --------------------------------------------------------------------------------------
def _choice(items, random: Random):
    return items[int(random.integers(len(items)))]


def _replaced(raw: bytes, pattern: re.Pattern[bytes], new: bytes, random: Random) -> bytes:
    found = list(pattern.finditer(raw))
    if not found:
        return raw
    m = _choice(found, random)
    return raw[: m.start()] + new + raw[m.end() :]


def _with(raw: bytes, places, new: bytes, random: Random) -> bytes:
    return _put(raw, _choice(places, random), new) if len(places) else raw


def _put(raw: bytes, at: int, new: bytes) -> bytes:
    return raw[:at] + new + raw[at + len(new) :]
