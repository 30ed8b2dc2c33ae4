"""Numbers that decide which files are accepted: tolerances, and limits of size."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MatrixFileSettings:
    """Comparison of matrices that other programs write."""

    #: [1] Difference of the sum of the groups from the matrices of the whole model, relative to the
    #: largest entries of row and column. Rounding: programs print 14 digits or more, and sums of
    #: many terms lose a few.
    sum_tolerance: float = 1e-10
    #: [1] Difference of two runs, relative to the largest entries of row and column, that is
    #: rounding of equal entries. Rounding: 14 printed digits.
    entry_rounding: float = 1e-13
    #: [1] Deviation of structural damping from a multiple of the stiffness, relative to the largest
    #: entry. Why: far above the rounding of 15 printed digits, far below a second loss factor.
    damping_tolerance: float = 1e-8
    #: [1] Relative difference of mirrored entries of a matrix that is declared symmetric. Why: a
    #: unit of the sixth digit; a punch file in small fields has six digits or more.
    mirror_tolerance: float = 1e-6
    #: [rows] Rows by which the number of columns of a file is found. Effort: a few damaged lines do
    #: not hide it.
    sampled_rows: int = 100
    #: [elements] Elements by which the order of packed triangles is found. Effort: one element with
    #: stiffness suffices; the others confirm it.
    sampled_elements: int = 200
    #: [rows] Largest matrix of a file. Effort: above any model; a damaged header would request all
    #: memory.
    most_rows: int = 10**8
    #: [equations] Largest model of OpenSees. Effort: it prints full matrices, 128 MB each.
    most_opensees_equations: int = 4000
    #: [entries] Smallest array that is compressed. Effort: chunks cost more than compression saves
    #: for shorter ones.
    compressed_entries: int = 2048


@dataclass(frozen=True)
class DeckSettings:
    """Limits of decks, in which a few characters may ask for any amount of memory."""

    #: [files] Largest depth of nested inclusions. Effort: the lines of each level are in memory.
    inclusion_depth: int = 20
    #: [files] Largest number of repeated inclusions. Effort: a deck may include a file for each of
    #: many parts, but its size may not grow exponentially.
    repeated_inclusions: int = 100
    #: [lines] Largest number of lines of repeated inclusions. Effort: some 100 MB.
    repeated_lines: int = 1_000_000
    #: [members] Largest number of members by GENERATE and by names of sets. Effort: 80 MB.
    set_members: int = 10_000_000
    #: [points] Largest number of scalar points. Effort: a card such as SPOINT,1,THRU,999999999
    #: would fill the memory.
    scalar_points: int = 1_000_000
    #: [cards] Largest number of copies by replication. Effort: a line such as =(999999999) would
    #: fill the memory.
    copies: int = 100_000
    #: [numbers] Largest number of constants of a set and of values over temperature in a deck of
    #: Ansys. Effort: above any real deck.
    property_values: int = 1000
    #: [1] Principal stiffness of a grid, relative to the largest one, below which a degree of
    #: freedom is fixed. Why: the default of EPZERO (MSC Nastran Quick Reference Guide, PARAM).
    singular_stiffness: float = 1e-8
    #: [1] Difference of E / (2 (1 + NU) G) from 1 up to which a MAT1 is isotropic. Why: Nastran
    #: warns from this difference on (MSC Nastran Quick Reference Guide, MAT1).
    shear_tolerance: float = 0.01
    #: [1] Relative difference of the section at both ends of a beam up to which it is constant.
    #: Why: half a unit of the fourth digit; a field of eight columns has four digits or more.
    section_tolerance: float = 5e-4
    #: [elements] Number of solids that are computed together. Effort: some 300 MB of temporary
    #: arrays.
    solids_per_batch: int = 4096
    #: [degrees of freedom] Largest number of labels in a message. Drawing: the message stays short.
    named_dofs: int = 3
    #: [levels] Largest depth of nested tables and arrays in TOML. Effort: above any real file; each
    #: level of a value takes a level of recursion.
    toml_depth: int = 50


@dataclass(frozen=True)
class MaterialRangeSettings:
    """Ranges of the materials of solids, by which units are checked."""

    #: [Pa] Smallest Young's modulus. Why: a margin below foams and gels.
    least_modulus: float = 1e4
    #: [Pa] Largest Young's modulus. Why: a margin above diamond.
    most_modulus: float = 2e12
    #: [kg/m3] Smallest density. Why: aerogel.
    least_density: float = 1.0
    #: [kg/m3] Largest density. Why: a margin above osmium.
    most_density: float = 3e4
    #: [m/s] Smallest wave speed sqrt(E / rho). Why: a margin below gels.
    least_speed: float = 10.0
    #: [m/s] Largest wave speed. Why: a margin above beryllium and diamond.
    most_speed: float = 3e4


@dataclass(frozen=True)
class MeasuredFileSettings:
    """Checks of files with measured data, and of modes."""

    #: [1] Relative difference of equal unit factors. Why: those of dataset 164 have at least four
    #: digits.
    factor_tolerance: float = 1e-3
    #: [1] Difference between time axes, relative to the last time. Rounding: rounding of sums of
    #: many steps.
    time_tolerance: float = 1e-9
    #: [1] Largest difference of a component between a unit vector and an axis that counts as
    #: parallel. Why: a unit of the sixth digit; axes are written with six digits or more.
    parallel_tolerance: float = 1e-6
    #: [1] Relative difference of numbers of a mode in one dataset. Rounding: numbers with six
    #: digits.
    mode_tolerance: float = 1e-4
    #: [1] Relative difference between a mode and the numbers in its identification lines, and
    #: between its modal A and B. Why: such lines have few digits.
    stated_tolerance: float = 2e-3
    #: [1] Relative difference between the frequency of a dataset 2414 and its eigenvalue; twice as
    #: much for their squares and for damping ratios. Why: above rounding to three digits, below a
    #: wrong unit (a factor of 2 pi).
    frequency_tolerance: float = 0.01
    #: [1] Absolute difference of damping ratios that is accepted in addition. Why: small ratios
    #: have few digits.
    damping_tolerance: float = 1e-3
    #: [1] Positive real part of an eigenvalue, relative to its size, up to which the mode is
    #: undamped. Rounding: rounding.
    undamped_share: float = 1e-6
    #: [1] Negative eigenvalue, as a frequency relative to the largest one, up to which it is
    #: rounding of a rigid-body mode. Why: an eigenvalue in single precision has an error of 1e-7 of
    #: the largest one, which is 3e-4 in frequency.
    rigid_share: float = 1e-3
    #: [1] Relative difference of the eigenvalues of one mode in two tables. Why: both are in single
    #: precision.
    eigenvalue_tolerance: float = 1e-5
    #: [1] Smallest usual magnitude of a measured number other than 0. Why: below any measured
    #: value, in any unit.
    least_magnitude: float = 1e-30
    #: [1] Largest usual magnitude. Why: above any measured value, in any unit.
    most_magnitude: float = 1e30
    #: [1] Share of unusual numbers from which the byte order is checked. Why: in the wrong byte
    #: order, bits of the mantissa become the exponent: 0.2 (single precision) or 0.9 (double
    #: precision) of normally distributed numbers are then unusual.
    unusual_share: float = 0.1
    #: [steps] Largest rounding error of a time, as a share of the step. Why: a larger one would be
    #: a missing sample.
    time_rounding: float = 0.5
    #: [steps] Largest rounding error of Delta_X and of start times, as a share of the step. Why:
    #: more would be another sampling rate.
    step_rounding: float = 1e-3
    #: [bytes] Bytes in which a closing delimiter is searched. Effort: above its length with
    #: padding.
    delimiter_window: int = 2**12


@dataclass(frozen=True)
class FileTextSettings:
    """Names and texts of files in messages."""

    #: [1] Similarity (difflib) from which a name counts as misspelt. Why: one wrong letter of eight
    #: or one missing letter of five; a higher value would miss misspellings of short names.
    misspelt_similarity: float = 0.86
    #: [characters] Largest part of a line that a message quotes. Drawing: the message stays in one
    #: line.
    quoted_characters: int = 60
    #: [columns] Largest number of columns of a table, or arrays of a file, that a message lists.
    #: Drawing: tables of many channels repeat the same few names.
    listed_columns: int = 12
    #: [values] First values of a column or an array that a form shows. Drawing: enough to tell a
    #: frequency from a magnitude; they fit a line.
    first_values: int = 3
    #: [lines] First lines of a text that a form shows. Drawing: the preambles of most exports.
    first_lines: int = 15
    #: [characters] Part of each of these lines. Drawing: lines of many channels have thousands.
    first_line_characters: int = 200
    #: [bytes] Largest HDF5 file of which a message lists the arrays. Effort: for the list it is
    #: read a second time.
    listed_bytes: int = 2**26
    #: [messages] Largest number of messages of another program that are reported. Drawing: later
    #: ones usually follow from the first.
    reported_messages: int = 3
    #: [characters] Largest part of a file name in the name of its temporary file. Drawing: names
    #: have 255 bytes at most.
    temporary_stem: int = 40


MATRIX_FILE = MatrixFileSettings()
DECK = DeckSettings()
MATERIAL_RANGE = MaterialRangeSettings()
MEASURED_FILE = MeasuredFileSettings()
FILE_TEXT = FileTextSettings()
