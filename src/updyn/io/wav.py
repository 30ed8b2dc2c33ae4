"""Time records of WAV files: one record, with the channels of the file.

Integer samples are fractions of the full scale, -1 to 1; floating-point samples are unchanged.
``channels=`` and ``units=`` define names and units, which a file lacks, and ``factors=`` the full
scale, or 1, in the unit.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.errors import FormatError, OptionError
from updyn.io.items import locate_errors, report_library_errors, require_file, unreadable_error
from updyn.signals.records import Records

__all__ = ["read_records"]

_ORDER = {b"RIFF": "<", b"RIFX": ">"}
#: Format tags: integers, floating point, and either of them with its tag in the extension.
_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE


def read_records(path: str | Path, *, channels: Sequence[str] | None = None) -> Records:
    """Read one time record, without units; channels are by default "1", "2", ..."""
    from scipy.io import wavfile

    _check_chunks(require_file(path))
    with report_library_errors(path, "WAV file"), warnings.catch_warnings():
        warnings.simplefilter("error", wavfile.WavFileWarning)
        try:
            rate, samples = wavfile.read(path)
        except wavfile.WavFileWarning as error:
            raise FormatError(f"not a readable WAV file ({error})", path) from error
    values = _scale_samples(np.asarray(samples))
    values = values.reshape(len(values), -1).T
    names = [str(number) for number in range(1, len(values) + 1)]
    if channels is not None:
        names = list(channels)
        if len(names) != len(values):
            raise OptionError(
                f"{len(names)} names for {len(values)} channels of {path}", key=("channels",)
            )
    if rate <= 0:
        raise FormatError(f"{rate} samples per second; expected a positive number", path)
    with locate_errors(path):
        return Records.of(values[None], 1.0 / rate, names, [""] * len(names), Path(path).name)


def _scale_samples(samples: NumberArray) -> RealArray:
    """Return integers as fractions of the full scale."""
    if samples.dtype.kind == "f":
        return samples.astype(np.float64)
    if samples.dtype == np.uint8:  # silence is 128
        return (samples.astype(np.float64) - 128.0) / 128.0
    # scipy returns samples of other sizes in the high bits of the next larger type.
    return samples.astype(np.float64) / -float(np.iinfo(samples.dtype).min)


def _check_chunks(path: Path) -> None:
    """Refuse a file whose chunks do not fill it, because the library would return a part."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise unreadable_error(path, error) from error
    order = _ORDER.get(raw[:4])
    if order is None or raw[8:12] != b"WAVE" or len(raw) < 12:
        raise FormatError("not a WAV file: it does not start with RIFF or RIFX of kind WAVE", path)
    size = struct.unpack(f"{order}I", raw[4:8])[0] + 8
    if size != len(raw):
        what = "truncated or damaged" if size > len(raw) else "followed by other data"
        raise FormatError(f"{what}: it declares {size} bytes, found {len(raw)}", path)
    found: dict[bytes, bytes] = {}
    at = 12
    while at < len(raw):
        if at + 8 > len(raw):
            raise FormatError(f"damaged: no complete chunk at byte {at}", path)
        name, length = raw[at : at + 4], struct.unpack(f"{order}I", raw[at + 4 : at + 8])[0]
        if at + 8 + length > len(raw):
            raise FormatError(
                f"truncated or damaged: chunk {name!r} at byte {at} declares {length} bytes,"
                f" {len(raw) - at - 8} remain",
                path,
            )
        if name in found and name in (b"fmt ", b"data"):
            raise FormatError(f"chunk {name!r} occurs twice", path)
        found[name] = raw[at + 8 : at + 8 + length]
        at += 8 + length + length % 2
    for name in (b"fmt ", b"data"):
        if name not in found:
            raise FormatError(f"no chunk {name!r}: not a WAV file with samples", path)
    _check_samples(found[b"fmt "], len(found[b"data"]), order, path)


def _check_samples(head: bytes, size: int, order: str, path: Path) -> None:
    """Refuse compressed samples, and data with an incomplete sample."""
    if len(head) < 16:
        raise FormatError(f"chunk 'fmt ' of {len(head)} bytes; expected 16 at least", path)
    tag, channels, _, _, block, bits = struct.unpack(f"{order}HHIIHH", head[:16])
    if tag == _EXTENSIBLE and len(head) >= 26:
        tag = struct.unpack(f"{order}H", head[24:26])[0]
    if tag not in (_PCM, _FLOAT):
        raise FormatError(
            f"samples of format {tag:#x}; expected integers (1) or floating point (3),"
            " uncompressed",
            path,
        )
    if min(channels, bits) < 1 or block != channels * ((bits + 7) // 8):
        raise FormatError(
            f"{channels} channels of {bits} bits in blocks of {block} bytes contradict", path
        )
    if size == 0 or size % block:
        raise FormatError(f"{size} bytes of data; expected a multiple of {block}", path)
