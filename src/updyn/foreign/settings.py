"""Limits for reading files of other programs, which may be damaged or hostile."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReadingSettings:
    """Limits of time, memory and depth."""

    #: [s] Time limit of reading a file, to which a part by its size is added. Effort: the libraries
    #: read small files in well below a second, also on a busy machine.
    seconds: float = 6.0
    #: [bytes] Size of a file for which the time limit grows by a second. Effort: a rule of thumb;
    #: libraries read far faster.
    bytes_per_second: int = 10**6
    #: [bytes] Largest unpacked content of any file, to which a part by its size is added. Effort: a
    #: small file may hold zeros, which are packed to almost nothing.
    unpacked_bytes: int = 256 * 10**6
    #: [1] Largest ratio of the unpacked content to the size of the file. Effort: measured data are
    #: packed by a factor of ten at most.
    packing_ratio: int = 100
    #: [bytes] Memory of the reader in addition to twice the unpacked content. Effort: copies in the
    #: library, and its own memory.
    working_bytes: int = 512 * 10**6
    #: [bytes] Content that is unpacked, hashed, or received from another process, at a time.
    #: Effort: a limit is checked between blocks.
    block_bytes: int = 2**20
    #: [groups] Largest depth of nested groups of an HDF5 file. Effort: deeper than any known
    #: format; a link to a group above would be endless.
    group_depth: int = 16
    #: [structs] Largest depth of nested structs of a MATLAB file. Effort: deeper than any known
    #: format; a deeper file refers to itself.
    struct_depth: int = 8
    #: [s] Time for a process to start and to finish its imports. Effort: seconds, but much longer
    #: on a busy machine.
    start_seconds: float = 120.0
    #: [s] Time without a request after which the fork server ends. Effort: further files of a job
    #: come within seconds.
    idle_seconds: float = 60.0


READING = ReadingSettings()
