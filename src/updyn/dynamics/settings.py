"""Numbers that decide how responses, modes and reduced models are computed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AffineSettings:
    """Storage and rank of the matrices of a compiled model; only time and memory depend on them."""

    #: [DOFs] Largest group whose matrix is stored dense, if more than a tenth of it is filled.
    #: Effort: a sparse product saves time only for large, mostly empty matrices.
    dense_group_dofs: int = 400
    #: [entries] Matrix entries times lines that are added in one step. Effort: they fit into the
    #: processor's cache.
    cached_entries: int = 8192
    #: [entries] Largest number of entries of all terms that are stored by columns, too. Effort:
    #: sums then take a third of the time, for 12 bytes an entry.
    combined_entries: int = 2**21
    #: [entries] Largest number of entries whose places are found by sorted numbers. Effort: for so
    #: few, sparse arrays take longer.
    sorted_entries: int = 2**14
    #: [1] Share of the largest eigenvalue of a term below which one is zero. Rounding: eps times
    #: several hundred DOFs is below 1e-12.
    zero_share: float = 1e-12


@dataclass(frozen=True)
class BasisSettings:
    """Independence of basis vectors."""

    #: [1] Share of the largest squared size from which a direction is independent; smaller ones are
    #: omitted. Why: a Gram matrix has squared sizes, whose rounding is some 1e3 times eps.
    independent_share: float = 1e-10
    #: [1] Squared norm outside the basis, below which a missing direction of unit norm consists of
    #: rounding errors. Rounding: without these it is 1.
    outside_share: float = 0.5
    #: [1] Norm of an orthogonalised unit column from which it is a new direction, and permitted
    #: error of the solutions that span a basis. Why: a larger error of a solution would appear as a
    #: direction.
    new_norm: float = 1e-9
    #: [rows] Rows of a basis that are multiplied in one step. Effort: a copy of all rows would take
    #: too much memory.
    rows_per_step: int = 2**16


@dataclass(frozen=True)
class CertificateSettings:
    """Factors of the stated error of a reduced model."""

    #: [1] Factor on the difference to the larger basis; larger values state larger errors. Why: a
    #: rule of thumb; with it, no stated error in benchmarks/error.py is below the true one.
    difference_factor: float = 2.0
    #: [1] Factor on the error of the larger basis by its residuals. Why: it has to cover other
    #: lines and natural frequencies, where Z is not close to P; a rule of thumb, checked like the
    #: factor on the difference.
    residual_factor: float = 16.0
    #: [eps] Factor on the errors by rounding of the matrix entries. Rounding: about the two
    #: roundings of an entry, of its computation and of the sum.
    entry_rounding: float = 2.0
    #: [eps] Factor on the errors by rounding in dense factorisations. Rounding: a rounding is half
    #: a unit in the last place.
    factor_rounding: float = 0.5
    #: [lines] Lines at which the error of the larger basis is computed: the worst of as many parts
    #: of the band. Effort: each costs a solution of the full model for each reference.
    residual_lines: int = 4


@dataclass(frozen=True)
class EigenSettings:
    """Eigensolvers."""

    #: [DOFs] Largest model for dense eigensolvers; half as many with viscous damping, which doubles
    #: the matrices. Effort: for large models, sparse solvers take less time; a rule of thumb.
    dense_dofs: int = 800
    #: [1] Shift of the second dense pass, as a share of the highest wanted eigenvalue. Rounding:
    #: rounding errors of the lowest eigenvalues grow with the shift, those of the highest become
    #: smaller; a rule of thumb between both.
    dense_shift: float = 0.01
    #: [1] Shift of Lanczos processes, as a share of the highest wanted eigenvalue. Rounding: a
    #: larger one needs more iterations, a smaller one makes K + s M of a free model nearly
    #: singular; a rule of thumb between both.
    sparse_shift: float = 0.1
    #: [1] First shift, as a share of the largest diagonal ratio K/M. Rounding: K + s M is then
    #: well-conditioned.
    first_shift: float = 1e-6
    #: [modes] Modes that are computed in addition to the wanted ones. Effort: they show the gap
    #: after the last wanted mode.
    additional_modes: int = 2
    #: [1] Share of the largest eigenvalue below which one is zero. Rounding: rounding; eps times
    #: several hundred DOFs is below 1e-12.
    zero_share: float = 1e-12
    #: [1] Relative difference up to which eigenvalues are equal. Rounding: above the error of
    #: single eigenvalues, below the distance of modes that a test could tell apart.
    equal_values: float = 1e-6


@dataclass(frozen=True)
class LanczosSettings:
    """Block Lanczos for large models."""

    #: [vectors] Size of a block. Effort: on a solid of 10,000 DOFs a solve with 8 columns takes
    #: twice the time of one, and smaller blocks need fewer vectors in all.
    block: int = 8
    #: [1] Residual of a converged mode relative to 1 / (lambda + s). Rounding: eigenvalues have its
    #: square as an error, and vectors are improved by one more step.
    tolerance: float = 1e-9
    #: [1] Residual of the modes that determine the shift. Effort: the shift needs no digits.
    crude_tolerance: float = 1e-2
    #: [1] Directions of a block below this share of their squared norm, and modes below this share
    #: of the largest 1 / (lambda + s), vanish. Rounding: rounding times some hundred vectors.
    vanishing: float = 1e-13
    #: [1] Least first shift, relative to the best one, that is kept. Rounding: for smaller ones,
    #: K + s M of a free model is nearly singular.
    least_shift: float = 1e-3
    #: [1] Largest first shift, relative to the best one, that is kept. Effort: larger ones converge
    #: slowly.
    most_shift: float = 3.0
    #: [vectors] Least size of a basis that is restarted. Effort: memory; smaller ones need more
    #: solves.
    most_vectors: int = 300
    #: [vectors] Vectors for each wanted mode in a basis that is restarted. Effort: as above.
    vectors_per_mode: int = 6


@dataclass(frozen=True)
class LineSolverSettings:
    """Choice between dense and sparse solution of the full model."""

    #: [DOFs] Largest model that is solved dense. Effort: many lines in one call save the overhead
    #: of sparse factorisations, which matters for small models only; a rule of thumb.
    dense_dofs: int = 150
    #: [1] Fill of the matrix from which larger models are solved dense, too. Effort: a sparse
    #: factorisation then saves little (PARDISO) or takes longer (SuperLU).
    dense_fill: float = 0.3
    #: [DOFs] Largest filled model that is solved dense. Effort: memory of a dense matrix, and time
    #: that grows with the third power.
    filled_dofs: int = 2000
    #: [bytes] Memory of a block of lines; larger blocks are distributed less evenly. Effort: chosen
    #: to be small compared with the memory of a worker.
    block_bytes: int = 64 * 2**20


@dataclass(frozen=True)
class StaticCondensationSettings:
    """Static condensation."""

    #: [1] Largest permitted backward error of the static solution. Rounding: far above rounding
    #: (1e-16) and far below that of a singular matrix (about 1).
    backward_error: float = 1e-6


@dataclass(frozen=True)
class PencilSettings:
    """Eigendecomposition of a state in place of factorisations at each line."""

    #: [lines] Smallest number of lines of the full model for an eigendecomposition. Effort: it
    #: saves time from 40 lines for 100 equations; for fewer lines, accuracy has priority.
    least_lines: int = 64
    #: [lines] Smallest number of lines of a reduced model for an eigendecomposition. Effort: it
    #: saves time from 40 lines for 100 equations.
    least_reduced_lines: int = 40
    #: [lines] Smallest number of lines if the decomposition is real. Effort: it takes as long as 4
    #: to 8 factorisations.
    least_real_lines: int = 16
    #: [1] Reciprocal condition of the eigenvectors below which they count as dependent. Rounding:
    #: half the digits of double precision are lost.
    least_condition: float = 1e-8
    #: [1] Largest rank of what depends on the line, as a share of the equations. Effort: with a
    #: larger one, a correction at each line takes as long as a factorisation.
    most_rank_share: float = 0.25
    #: [1] Frequency of viscous damping in the decomposition, as a share of the highest line.
    #: Rounding: the correction at each line is exact for any; half the highest makes it small.
    reference_share: float = 0.5
    #: [1] Largest accepted backward error of a line. Rounding: rounding of some thousand
    #: operations.
    backward_error: float = 1e-12
    #: [1] Growth of the probe load, as a share of the limit of singularity, above which a line is
    #: factorised. Rounding: the factorisation identifies the singularity; the margin of 1e4 keeps
    #: the decision away from rounding.
    doubtful_growth: float = 1e-4


@dataclass(frozen=True)
class ReductionSettings:
    """Construction, enrichment and size of reduced models."""

    #: [1] Default permitted error of a receptance, relative to the largest of its line. Default:
    #: far below the errors of measurements, 1e-3 at best.
    accuracy: float = 1e-5
    #: [1] Factor on errors by residuals during enrichment. Effort: Z differs from P near natural
    #: frequencies; the certificate checks the result.
    error_factor: float = 4.0
    #: [1] Share of the largest missing direction from which one is added to the larger basis.
    #: Rounding: smaller ones change an error estimate by 0.1 % or less.
    compared_share: float = 1e-3
    #: [shifts] Shifts of a new basis. Effort: both ends and the middle of the band.
    first_shifts: int = 3
    #: [shifts] Largest number of shifts, if modes are missed between them. Effort: a rule of thumb.
    most_shifts: int = 32
    #: [vectors] Basis vectors of a shift that needs no more moments. Effort: chosen; few loads need
    #: moments to find the modes of the band.
    vectors_per_shift: int = 32
    #: [moments] Largest number of moments at a shift. Effort: further ones converge to the same
    #: modes.
    most_moments: int = 8
    #: [1] Shift of a basis around the start, in squares of the highest frequency. Effort: it is
    #: 0.55 of the highest frequency, near the middle of a band; a rule of thumb.
    search_shift: float = 0.3
    #: [1] Shifts of further states in turn, in squares of the highest frequency. Effort: they are
    #: 0.45, 0.71 and 0.89 of the highest frequency, spread over a band; a rule of thumb.
    further_shifts: tuple[float, ...] = (0.2, 0.5, 0.8)
    #: [loads] Largest number of loads at the references at a state; more are combined. Effort: a
    #: rule of thumb (Gallivan, Vandendorpe & Van Dooren, 2004).
    most_references: int = 4
    #: [loads] Random combinations of the sensors at a state. Effort: each state has others, so few
    #: suffice (Gallivan, Vandendorpe & Van Dooren, 2004).
    sensor_combinations: int = 2
    #: [lines] Largest number of lines of a state whose fields are used for compression. Effort:
    #: other states use other lines.
    lines_per_state: int = 12
    #: [lines] Largest number of such lines of all states. Effort: a rule of thumb.
    lines_of_states: int = 250
    #: [1] Share of the permitted error below which a direction is not added. Effort: twenty such
    #: directions together reach the permitted error, and the certificate states the error.
    negligible_share: float = 0.05
    #: [lines] Lines that are checked in a pass. Effort: each costs a solution of the full model.
    lines_per_pass: int = 12
    #: [lines] Largest number of lines that are checked together. Effort: directions that several
    #: lines miss are added once; more lines need more memory.
    lines_together: int = 4
    #: [bytes] Largest size of the residuals of lines checked together. Effort: a limit of memory.
    together_bytes: int = 2**28
    #: [parts] Parts of the band with a line each in a pass with the factors of another state.
    #: Effort: such a pass is cheap and is repeated at other lines.
    nearby_parts: int = 4
    #: [1] Share of the permitted error to which a basis is enriched. Effort: lines without a
    #: residual may be worse than lines with one.
    enriched_share: float = 0.2
    #: [passes] Largest number of passes of an enrichment. Effort: the certificate states the error
    #: that is reached.
    most_passes: int = 24
    #: [bytes] Memory of a block of lines of a reduced model. Effort: enough lines for matrix
    #: products.
    block_bytes: int = 192 * 2**20
    #: [lines] Largest number of lines in such a block. Effort: few enough to distribute them and to
    #: stop between blocks.
    block_lines: int = 32
    #: [bytes] Largest basis that is kept after an update. Effort: 150,000 DOFs and 334 vectors take
    #: 0.4e9.
    kept_bytes: int = 2**30


@dataclass(frozen=True)
class ResonanceLineSettings:
    """Lines that resolve resonances."""

    #: [lines] Lines for each resonance, an even number, so that none is the natural frequency
    #: itself. Why: the nearest two reach 0.995 of the peak.
    lines_per_resonance: int = 16
    #: [lines] Smallest number of lines for a resonance; the highest modes are omitted before. Why:
    #: fewer do not show its shape.
    least_lines: int = 4
    #: [1] Loss factor of an undamped resonance, for the width of its lines. Why: below the damping
    #: of real structures.
    least_loss: float = 1e-4
    #: [modes] Modes of the first computation, doubled until they cover the band. Effort: chosen;
    #: only the time depends on it.
    first_modes: int = 20


@dataclass(frozen=True)
class ShiftedSettings:
    """Factorisations of K - s M."""

    #: [1] Largest relative difference of masses and stiffnesses of two states that share factors.
    #: Why: P of one is then at most 1.1 times that of the other.
    close_share: float = 0.1
    #: [1] Permitted error, in single precision, of solutions that measure errors. Rounding: an
    #: error needs few digits.
    measuring_error: float = 1e-5
    #: [DOFs] Largest model that is factorised in double precision. Effort: beyond it, memory may be
    #: too small; refinement takes as long as single precision saves.
    double_dofs: int = 400_000
    #: [1] Moves of a shift that is a natural frequency, in squares of the highest frequency.
    #: Rounding: each is ten times as large, to reach a regular matrix.
    moves: tuple[float, ...] = (0.0, 1e-4, 1e-3)
    #: [1] The same in single precision. Rounding: it is less accurate near a natural frequency.
    moves_in_single: tuple[float, ...] = (0.0, 3e-3, 1e-2)


@dataclass(frozen=True)
class RandomSettings:
    """Statistical linearisation of a model under a random force."""

    #: [intervals] Intervals of the band in integrals over the frequency. Effort: a rule of thumb;
    #: they are halved at resonances.
    intervals: int = 32
    #: [1] Largest relative change of standard deviations at which iterations end. Rounding: far
    #: above that of the integrals, far below the error of the linearisation.
    change: float = 1e-9
    #: [iterations] Iterations from one start. Effort: most cases take 5 to 10, those of sliders
    #: that stick 20.
    most_iterations: int = 60
    #: [1] Largest change of the logarithm of a standard deviation in a Newton step. Effort: the
    #: equations are nearly linear in the logarithms over a factor of about ten.
    largest_step: float = 2.0
    #: [1] Error of an integral of a fit over the integral. Rounding: far below the noise of data,
    #: a measured spectrum with 800 lines takes a third of the time of 1e-8.
    error: float = 1e-6
    #: [1] Change of a measured standard deviation by the omission of every other line up to which
    #: the lines resolve its resonances. Why: the start of a fit permits an error of some ten
    #: percent, which a start of the unknowns off by 30 % also causes.
    resolved: float = 0.1
    #: [lines] Lines over the band of the force at which a reduced model is accurate. Effort: the
    #: basis also has the modes between them.
    reduced_lines: int = 128
    #: [points] Points of an integral whose derivatives are computed together. Effort: memory.
    block_points: int = 1024
    #: [1] Share of the first step that is taken. Effort: a hardening spring without another one in
    #: parallel needs a half.
    first_step: float = 0.5
    #: [1] Growth of that share while the change falls; it is halved otherwise. Effort: a rule of
    #: thumb.
    growth: float = 1.1
    #: [1] Motion of an element at rest, over that without elements. Rounding: far above the
    #: rounding of the linear model.
    rest: float = 1e-9


AFFINE = AffineSettings()
BASIS = BasisSettings()
CERTIFICATE = CertificateSettings()
EIGEN = EigenSettings()
LANCZOS = LanczosSettings()
LINE_SOLVER = LineSolverSettings()
STATIC_CONDENSATION = StaticCondensationSettings()
PENCIL = PencilSettings()
RANDOM = RandomSettings()
REDUCTION = ReductionSettings()
RESONANCE_LINES = ResonanceLineSettings()
SHIFTED = ShiftedSettings()
